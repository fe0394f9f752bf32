"""Verification of a result folder: its motion is held to the request's demands, not to those in the folder."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from costs.robot import RobotError, RobotModel, load_robot
from perception.detect.door.geometry import DoorGeometry, HandleGeometry
from service.demands import Demands, HeldMotion, compare_pace, hold_to_request
from service.demands.door_demand import SeenDoor
from service.errors import RequestError, ResultError, shown
from service.replay.consistency import CHANGED, find_contradictions
from service.replay.rebuild import Grounds, Record, rebuild_demands
from service.request.file import load_request, parse_request
from service.request.schema import PlanRequest
from service.result.folder import TRAJECTORY_NAME, read_result, result_path
from service.result.motion_json import motion_from_json
from service.result.phase_report import PhaseReport, PhaseStatus, report_phases
from service.result.result_json import add_reports, proof_summary
from service.verify import Certificate, Motion, Status, VerifyError, verify

if TYPE_CHECKING:
    from perception import LeverDetection, SeenPart, ValveDetection

VECTORS = ("centre", "axis", "direction")  # of detected valves
OTHER = "it answers another request, or was changed after it was written"
WITHOUT_CERTIFICATE = ("FEASIBLE_AT_SAMPLES", "NOT_FOUND", "INFEASIBLE", "TIME_LIMIT", "CANCELLED")


def verify_result(path: str | Path, request: Path | None = None, clouds: Sequence[Path] = ()) -> dict[str, Any]:
    """Return the verdict on a result folder: the keys of ``summary_json`` and ``held_to``.

    The demands on a certified motion are rebuilt from the request, and the folder's are compared with them.

    Args:
        path: the folder or its ``result.json``.
        request: file of the user's request; by default the request in the folder.
        clouds: files of the request's scan, to be read again; by default the recorded pieces are taken.

    Raises:
        ResultError: the folder cannot be read, or its data contradict each other or the request.
        RequestError: the user's request, or a file that it names, cannot be used.
    """
    started = time.perf_counter()
    data = read_result(path)
    folder = result_path(path).parent
    robot, recorded = read_record(data, folder)
    is_claimed = data["verdict"] == Status.CERTIFIED.value
    if is_claimed and data.get("certificate") is None:
        raise ResultError(f"{folder}: the verdict is CERTIFIED, and there is no certificate; {CHANGED}")
    held, grounds, demands = HeldMotion(recorded, ()), None, None
    if is_claimed:
        demands, grounds = _read_demands(data, folder, Record(robot, recorded.scene), request, clouds)
        with _explain_defects(folder):
            held = hold_to_request(demands, recorded)
    table = folder / TRAJECTORY_NAME
    with _explain_defects(folder):
        certificate = verify(held.motion)
        reports = report_phases(held.motion, certificate, _read_unsolved(data))
        differences = held.differences
        if demands is not None:
            differences += tuple(compare_pace(demands.request, certificate))
            if demands.task is not None:
                differences += tuple(demands.task.compare_figures(data["figures"]))
        if data.get("certificate") is not None:
            differences += tuple(_compare_phases(data, reports))
            differences += find_contradictions(data, recorded, robot, certificate, table if table.is_file() else None)
    if certificate.status is Status.CERTIFIED and is_claimed and differences:
        why = CHANGED if request is None else OTHER
        raise ResultError("\n".join(f"{folder}: {line}; {why}" for line in differences))
    verdict, explanation = _judge(data["verdict"], certificate)
    return {
        "verdict": verdict,
        "explanation": [*explanation, *differences],
        "notes": list(certificate.notes),
        "held_to": None if grounds is None else grounds.sentence(),
        "timings": {"verify": time.perf_counter() - started},
        **proof_summary(certificate),
        "phases": add_reports(data["phases"], reports),
        "not_planned": data["not_planned"],
    }


def _read_demands(
    data: dict[str, Any], folder: Path, record: Record, given: Path | None, clouds: Sequence[Path]
) -> tuple[Demands, Grounds]:
    """Return the demands of the user's or the recorded request, and their sources."""
    request = read_request(data, folder) if given is None else load_request(given)
    with _explain_defects(folder):
        record = replace(record, valves=read_valves(data), doors=read_doors(data), seen=read_seen_parts(data))
    try:
        return rebuild_demands(request, record, given, clouds)
    except RequestError as error:
        if given is not None or clouds:
            raise
        line = " ".join(str(error).split())
        raise ResultError(f"{folder}: the request in this folder cannot be used: {line}; {CHANGED}") from None


def _read_unsolved(data: dict[str, Any]) -> list[str]:
    """Return the phases that a result calls best attempts; only a result without a solution has any."""
    if data["verdict"] in (Status.CERTIFIED.value, Status.FEASIBLE_AT_SAMPLES.value):
        return []
    return [str(phase["name"]) for phase in data["phases"] if phase["status"] == PhaseStatus.NOT_FOUND.value]


def _compare_phases(data: dict[str, Any], reports: Sequence[PhaseReport]) -> Iterator[str]:
    """Yield a sentence for each phase whose recorded status or checks are not the verifier's."""
    for phase, report in zip(data["phases"], reports, strict=True):
        if phase["status"] != report.status.value:
            yield f"phase '{report.name}' is {report.status.value}; recorded is {shown(phase['status'])}"
        elif phase["checks"] != list(report.checks):
            yield f"checks of phase '{report.name}' are not those of the certificate"
    planned = {report.name for report in reports}
    repeated = [name for name in data["not_planned"] if name in planned]
    if repeated:
        yield f"not_planned lists {shown(repeated[0])}, which is in the motion"
    elif data["not_planned"] and data["verdict"] == Status.CERTIFIED.value:
        yield "the verdict is CERTIFIED, and not_planned lists phases"


def read_valves(data: dict[str, Any]) -> tuple[ValveDetection | LeverDetection, ...]:
    """Read the valves of ``detections``; those with a ``direction`` are levers."""
    hits = [hit for hit in data["detections"] if hit["kind"] == "valve"]
    if not hits:
        return ()
    from perception import LeverDetection, ValveDetection  # slow to import

    valves: list[ValveDetection | LeverDetection] = []
    for hit in hits:
        kind = LeverDetection if "direction" in hit else ValveDetection
        values = {field.name: hit[field.name] for field in fields(kind)}
        values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        vectors = {name: np.array(values[name], dtype=float) for name in VECTORS if name in values}
        valves.append(kind(**{**values, **vectors}))
    return tuple(valves)


def read_doors(data: dict[str, Any]) -> tuple[SeenDoor, ...]:
    """Read the doors of ``detections``."""
    doors = []
    for hit in data["detections"]:
        if hit["kind"] == "door":
            geometry, handle = dict(hit["geometry"]), hit["geometry"]["handle"]
            if handle is not None:
                vectors = {name: np.array(handle[name], dtype=float) for name in ("centre", "direction")}
                handle = HandleGeometry(**{**handle, **vectors})
            vectors = {name: np.array(geometry[name], dtype=float) for name in ("hinge", "along", "normal")}
            door = DoorGeometry(**{**geometry, **vectors, "handle": handle})
            doors.append(SeenDoor(door, float(hit["confidence"]), bool(hit.get("knows_hinge", True))))
    return tuple(doors)


def read_seen_parts(data: dict[str, Any]) -> tuple[SeenPart, ...]:
    """Read the parts of the task's valve or door that the scan shows; none where an earlier release wrote none."""
    parts = data["detections"][0].get("parts", ()) if data["detections"] else ()
    if not parts:
        return ()
    from perception import SeenPart  # slow to import

    return tuple(SeenPart.from_json(part) for part in parts)


def read_request(data: dict[str, Any], folder: Path) -> PlanRequest:
    """Return the request of a parsed ``result.json`` (ResultError where it cannot be used)."""
    try:
        return parse_request(data.get("request"), folder)
    except RequestError as error:
        line = " ".join(str(error).split())
        raise ResultError(f"{folder}: request of result.json cannot be used: {line}; {CHANGED}") from None


def read_motion(data: dict[str, Any], folder: Path) -> Motion:
    """Return the motion of a parsed ``result.json`` whose robot files are in ``folder``.

    Raises:
        ResultError: there is no motion, or the data contradict each other.
    """
    return read_record(data, folder)[1]


def read_record(data: dict[str, Any], folder: Path) -> tuple[RobotModel, Motion]:
    """Return the robot of a result's folder, without the joints that the task moves, and the motion."""
    if data.get("curve") is None:
        raise ResultError(f"{folder}: the result has no motion to verify; its verdict is {shown(data.get('verdict'))}")
    with _explain_defects(folder):
        robot = _read_robot(data["robot"], folder)
        return robot, motion_from_json(data, robot)


@contextmanager
def _explain_defects(folder: Path) -> Iterator[None]:
    """Turn errors in a result's data into a ``ResultError`` of one line that names the folder."""
    try:
        yield
    except KeyError as error:
        raise ResultError(f"{folder}: result.json lacks {error}; docs/result-format.md lists what it holds") from None
    except (RobotError, VerifyError, ValueError, TypeError, IndexError, AttributeError) as error:
        line = " ".join(str(error).split())
        raise ResultError(f"{folder}: result.json cannot be used: {line}") from None


def _read_robot(robot: dict[str, Any], folder: Path) -> RobotModel:
    def resolve(name: str) -> Path:
        resolved = (folder / name).resolve()
        if not resolved.is_relative_to(folder.resolve()):
            raise ResultError(f"{folder}: robot file {shown(name)} lies outside the result folder")
        return resolved

    return load_robot(
        urdf=resolve(robot["urdf"]),
        srdf=None if robot["srdf"] is None else resolve(robot["srdf"]),
        package_dirs=[resolve(name) for name in robot["package_dirs"]],
        root=robot["root"],
    )


def _judge(planned: object, certificate: Certificate) -> tuple[str, list[str]]:
    """Return the verdict and its reasons: a motion without defects is certified only if its plan was."""
    if certificate.status is Status.CERTIFIED and planned == Status.CERTIFIED.value:
        return Status.CERTIFIED.value, []
    if certificate.status is Status.CERTIFIED:
        if planned not in WITHOUT_CERTIFICATE:
            raise ResultError(f"verdict is {shown(planned)}; expected CERTIFIED, {', '.join(WITHOUT_CERTIFICATE)}")
        return str(planned), [f"the motion holds, but its plan is {planned}: it does not meet the whole request"]
    is_feasible = certificate.status is Status.FEASIBLE_AT_SAMPLES
    return "FEASIBLE_AT_SAMPLES" if is_feasible else "NOT_FOUND", [check.text for check in certificate.failed()]
