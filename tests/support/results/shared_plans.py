"""Plans that several test files need, made once per run for all of its processes."""

from __future__ import annotations

import fcntl
import os
import pickle
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from service import PlanRequest, load_request, plan, write_result
from service.request.file import request_hash
from service.result import output
from service.result.folder import GLB_NAME, OPENRAVE_NAME, VIEWER_NAME
from service.result.result import PlanResult, Verdict

REQUESTS = Path(__file__).resolve().parents[3] / "examples" / "requests"


def plan_once(request: PlanRequest) -> PlanResult:
    """Return a copy of the plan of a request, which is certified.

    Raises:
        RuntimeError: it is not.
    """
    with _kept(request, ".pickle") as (path, is_new):
        if is_new:
            result = plan(request)
            if result.verdict is not Verdict.CERTIFIED:
                raise RuntimeError(f"{result.verdict.value}: {result.explanation}")
            _write_whole(path, lambda there: there.write_bytes(pickle.dumps(result)))
    copied = pickle.loads(path.read_bytes())
    assert isinstance(copied, PlanResult)
    return copied


def write_once(request: PlanRequest) -> Path:
    """Return the result folder of a request's plan, without drawings; a test that changes files copies it first."""
    result = plan_once(request)
    with _kept(request, "") as (path, is_new):
        if is_new:
            _write_whole(path, lambda there: write_undrawn(result, there))
    return path


def plan_example(name: str) -> PlanResult:
    """Return a copy of the plan of an example request."""
    return plan_once(load_request(REQUESTS / f"{name}.yaml"))


def write_example(name: str) -> Path:
    """Return the result folder of an example request."""
    return write_once(load_request(REQUESTS / f"{name}.yaml"))


def copy_undrawn(folder: Path, target: Path) -> Path:
    """Copy a result folder without its drawings, which each verification would draw again, and return the copy."""
    return Path(shutil.copytree(folder, target, ignore=shutil.ignore_patterns(VIEWER_NAME, GLB_NAME, OPENRAVE_NAME)))


def write_undrawn(result: PlanResult, folder: Path) -> Path:
    """Write a result folder without drawings, which take longer than all the rest, and return it."""
    with mock.patch.object(output, "draw_views"):
        return write_result(result, folder).folder


@contextmanager
def _kept(request: PlanRequest, ending: str) -> Iterator[tuple[Path, bool]]:
    """Yield where something of a request is kept, and whether it is to be made; no other process makes it meanwhile."""
    folder = Path(os.environ["SCOPT_TEST_RUN"]) / "plans"
    folder.mkdir(exist_ok=True)
    path = folder / f"{request_hash(request).partition(':')[2]}{ending}"
    with (folder / f"{path.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield path, not path.exists()


def _write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file or folder that is never seen in part."""
    part = path.with_name(f"{path.name}.part")
    write(part)
    part.rename(path)
