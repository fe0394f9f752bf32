"""Results of the example requests that change contacts, planned once per session."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

from service import load_request, plan, write_result

REQUESTS = Path(__file__).resolve().parents[3] / "examples" / "requests"


@cache
def plan_example(name: str) -> Path:
    """Return the result folder of an example request, which is certified.

    Raises:
        RuntimeError: it is not.
    """
    folder = Path(tempfile.mkdtemp(prefix="contact-plans-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    result = plan(load_request(REQUESTS / f"{name}.yaml"))
    if result.verdict.value != "CERTIFIED":
        raise RuntimeError(f"{name} is {result.verdict.value}: {result.explanation}")
    write_result(result, folder / "result")
    return folder / "result"
