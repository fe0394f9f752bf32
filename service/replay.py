"""Verify a result folder anew: only the robot's files, the pieces, the curve and the promises are taken from it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from costs.robot import RobotError, RobotModel, load_robot
from service.consistency import CHANGED, contradictions
from service.errors import ResultError, shown
from service.motion_json import motion_from_json
from service.result_folder import TRAJECTORY_NAME, read_result, result_path
from service.result_json import proof_summary
from service.verify import Certificate, Motion, Status, VerifyError, verify

WITHOUT_CERTIFICATE = ("FEASIBLE_AT_SAMPLES", "NOT_FOUND", "INFEASIBLE", "TIME_LIMIT", "CANCELLED")


def verify_result(path: str | Path) -> dict[str, Any]:
    """The verdict on a result folder, with the keys of ``result.json`` that speak of it.

    Raises:
        ResultError: the folder cannot be read or its data contradict each other.
    """
    started = time.perf_counter()
    data = read_result(path)
    folder = result_path(path).parent
    motion = read_motion(data, folder)
    table = folder / TRAJECTORY_NAME
    with _readable(folder):
        certificate = verify(motion)
        found = contradictions(data, motion, certificate, table if table.is_file() else None)
    is_certified = certificate.status is Status.CERTIFIED
    if is_certified and found:
        raise ResultError("\n".join(f"{folder}: {line}; {CHANGED}" for line in found))
    verdict, explanation = _judged(data["verdict"], certificate)
    return {
        "verdict": verdict,
        "explanation": [*explanation, *found],
        "notes": list(certificate.notes),
        "timings": {"verify": time.perf_counter() - started},
        **proof_summary(certificate),
        "phases": data["phases"],
    }


def read_motion(data: dict[str, Any], folder: Path) -> Motion:
    """The motion of a parsed ``result.json`` whose robot files are in ``folder``.

    Raises:
        ResultError: there is no motion, or the data contradict each other.
    """
    if data.get("curve") is None:
        raise ResultError(f"{folder}: the result has no motion to verify; its verdict is {shown(data.get('verdict'))}")
    with _readable(folder):
        return motion_from_json(data, _read_robot(data["robot"], folder))


@contextmanager
def _readable(folder: Path) -> Iterator[None]:
    """What is wrong with the data of a result, as one line that names the folder."""
    try:
        yield
    except KeyError as error:
        raise ResultError(f"{folder}: result.json lacks {error}; docs/result-format.md lists what it holds") from None
    except (RobotError, VerifyError, ValueError, TypeError, IndexError, AttributeError) as error:
        line = " ".join(str(error).split())
        raise ResultError(f"{folder}: result.json cannot be used: {line}") from None


def _read_robot(robot: dict[str, Any], folder: Path) -> RobotModel:
    def inside(name: str) -> Path:
        resolved = (folder / name).resolve()
        if not resolved.is_relative_to(folder.resolve()):
            raise ResultError(f"{folder}: robot file {shown(name)} lies outside the result folder")
        return resolved

    return load_robot(
        urdf=inside(robot["urdf"]),
        srdf=None if robot["srdf"] is None else inside(robot["srdf"]),
        package_dirs=[inside(name) for name in robot["package_dirs"]],
        root=robot["root"],
    )


def _judged(planned: object, certificate: Certificate) -> tuple[str, list[str]]:
    """The verdict and its reasons: a motion that holds is certified only if it also does what was asked."""
    if certificate.status is Status.CERTIFIED and planned == Status.CERTIFIED.value:
        return Status.CERTIFIED.value, []
    if certificate.status is Status.CERTIFIED:
        if planned not in WITHOUT_CERTIFICATE:
            raise ResultError(f"verdict is {shown(planned)}; CERTIFIED, {', '.join(WITHOUT_CERTIFICATE)} would do")
        return str(planned), [f"the motion holds, but its plan is {planned}: it does not do all that was asked"]
    is_feasible = certificate.status is Status.FEASIBLE_AT_SAMPLES
    return "FEASIBLE_AT_SAMPLES" if is_feasible else "NOT_FOUND", [check.text for check in certificate.failed()]
