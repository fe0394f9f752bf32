"""State of the robot at any time of a recorded motion, as a file for ``--state``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from costs.robot import BASE_NAMES
from costs.rotation import make_quaternions
from service.errors import ResultError
from service.replay.replay import read_record
from service.result.folder import read_result, result_path

TIME_ROUNDING_S = 1e-6


def read_state(result: Path, time_s: float | None) -> dict[str, Any]:
    """Return the keys of a ``StateRequest`` at a time of a result's motion: joints, base, mechanism.

    Args:
        result: the folder or its ``result.json``.
        time_s: from the motion's beginning [s]; of an untimed one its path parameter; None for its end.

    Raises:
        ResultError: the folder cannot be read, it has no motion, or the motion does not last until then.
    """
    data, folder = read_result(result), result_path(result).parent
    robot, motion = read_record(data, folder)
    law = motion.law
    first, last = (law.times if law is not None else motion.curve.knots)[[0, -1]].tolist()
    at = last if time_s is None else first + time_s
    if not first <= at <= last + TIME_ROUNDING_S:
        raise ResultError(f"--at: {time_s:g} is outside the motion; expected 0 to {last - first:.6g}")
    s = np.array([min(at, last)]) if law is None else law.at(np.array([min(at, last)]))[0]
    q = motion.curve(s)[0]
    n_base = len(BASE_NAMES) if robot.is_floating else 0
    state: dict[str, Any] = {
        "joints": dict(zip(robot.joint_names[n_base:], q[n_base : robot.n].tolist(), strict=True)),
        "mechanism": dict(zip(motion.robot.joint_names[robot.n :], q[robot.n :].tolist(), strict=True)),
    }
    if n_base:
        turn = make_quaternions(q[None, 3:n_base])[0].tolist()
        state["base"] = {"position": q[:3].tolist(), "quaternion_wxyz": turn}
    return state


def write_state(result: Path, time_s: float | None, path: Path) -> None:
    """Write the state at a time of a result's motion, as ``read_state`` returns it.

    Raises:
        ResultError: as there, or the file cannot be written.
    """
    state = read_state(result, time_s)
    try:
        path.write_text(json.dumps(state, indent=1) + "\n")
    except OSError as error:
        raise ResultError(f"{path}: cannot be written: {error.strerror}") from None
