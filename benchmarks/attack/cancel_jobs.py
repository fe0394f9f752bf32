"""What workers run when they are cancelled: the service's own functions, with ``faulthandler`` writing to a file."""

from __future__ import annotations

import faulthandler
import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from service.cloud_asked import CloudAsked
from service.executor import Control
from service.request import PlanRequest
from service.work import look
from service.work.plan import PlanTask, run_plan

_OPEN: list[TextIO] = []  # of this process: faulthandler writes to its file as long as the process lives


def watch(folder: Path) -> None:
    """Have a fatal signal of this process leave its stack in a file of that folder."""
    if not _OPEN:
        _OPEN.append((folder / f"{os.getpid()}.txt").open("w", encoding="utf-8"))
        faulthandler.enable(_OPEN[0], all_threads=True)


def scene(folder: Path, clouds: CloudAsked, kinds: tuple[str, ...], control: Control) -> int:
    """Bytes of a scene's file."""
    watch(folder)
    built = look.build_scene(look.SceneTask(clouds, kinds), control)
    return len(built) if isinstance(built, bytes) else -1


def detection(folder: Path, clouds: CloudAsked, kind: str, control: Control) -> int:
    """Keys of what is detected."""
    watch(folder)
    return len(_data(look.detect(clouds, kind, None, control)))


def plan(folder: Path, request: PlanRequest, control: Control) -> tuple[str, str]:
    """Verdict and digest of the trajectory."""
    watch(folder)
    answer = run_plan(PlanTask(request), control)
    return getattr(answer, "verdict", "REFUSED"), getattr(answer, "trajectory_sha256", "")


def verification(folder: Path, files: Mapping[str, bytes], control: Control) -> str:
    """The verdict."""
    watch(folder)
    verify: Callable[..., Any] = look.verify
    takes_control = "control" in verify.__code__.co_varnames[: verify.__code__.co_argcount]
    return str(_data(verify(files, control=control) if takes_control else verify(files)).get("verdict"))


def positions(request: PlanRequest) -> tuple[str, str]:
    """Verdict of a plan made here, and the digest of its waypoints in whole nanoradians."""
    from service.planner import plan as plan_here

    result = plan_here(request)
    rows = np.zeros(0) if result.motion is None else result.motion.curve.positions
    return result.verdict.value, hashlib.sha256(np.rint(rows * 1e9).astype("<i8").tobytes()).hexdigest()


def _data(answer: Any) -> Mapping[str, Any]:
    return answer if isinstance(answer, Mapping) else {}
