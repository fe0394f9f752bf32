"""Verify a result folder anew: only the robot's files, the pieces, the curve and the promises are taken from it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from costs.robot import RobotError, RobotModel, load_robot
from service.errors import ResultError, shown
from service.motion_json import motion_from_json
from service.output import read_result, result_path
from service.result_json import proof_summary
from service.verify import Certificate, Motion, Status, VerifyError, verify


def verify_result(path: str | Path) -> dict[str, Any]:
    """The verdict on a result folder, with the keys of ``result.json`` that speak of it.

    Raises:
        ResultError: the folder cannot be read or its data contradict each other.
    """
    started = time.perf_counter()
    data = read_result(path)
    motion = read_motion(data, result_path(path).parent)
    certificate = verify(motion)
    seconds = time.perf_counter() - started
    is_certified = certificate.status is Status.CERTIFIED
    return {
        "verdict": "CERTIFIED" if is_certified else _without_certificate(certificate),
        "explanation": [] if is_certified else [check.text for check in certificate.failed()],
        "notes": [*certificate.notes, *_contradictions(data, certificate)],
        "timings": {"verify": seconds},
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
    try:
        return motion_from_json(data, _read_robot(data["robot"], folder))
    except KeyError as error:
        raise ResultError(f"{folder}: result.json lacks {error}; docs/result-format.md lists what it holds") from None
    except (RobotError, VerifyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise ResultError(f"{folder}: result.json cannot be used: {error}") from None


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


def _without_certificate(certificate: Certificate) -> str:
    return "FEASIBLE_AT_SAMPLES" if certificate.status is Status.FEASIBLE_AT_SAMPLES else "NOT_FOUND"


def _contradictions(data: dict[str, Any], certificate: Certificate) -> list[str]:
    """Hashes of the recorded certificate that do not fit what was verified now."""
    recorded = data.get("certificate") or {}
    names = ("scene_sha256", "bodies_sha256", "robot_sha256")
    return [
        f"{name} of the recorded certificate does not fit these files"
        for name in names
        if recorded.get(name) not in (None, getattr(certificate, name))
    ]
