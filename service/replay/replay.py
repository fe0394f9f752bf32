"""Verification of a result folder: its motion is held to the request's demands, not to those in the folder."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from costs.robot import RobotError, RobotModel, load_robot
from service.demands import Demands, HeldMotion, compare_pace, hold_to_request
from service.errors import DamagedResultError, RequestError, ResultError, shown
from service.replay.consistency import CHANGED, compare_figures, compare_servos, find_contradictions
from service.replay.detections import compare_hits, read_doors, read_seen_parts, read_valves
from service.replay.folder_files import FileFindings, check_files
from service.replay.rebuild import Grounds, RecordedWorld, rebuild_demands
from service.replay.standing import HELD_BEFORE, Standing, State
from service.request.file import has_hash, load_request, parse_request
from service.request.formats import FORMAT
from service.request.schema import PlanRequest
from service.request.versions import find_format as find_request_format
from service.request.versions import insert_defaults, list_defaults
from service.result.folder import TRAJECTORY_NAME, read_result, result_path
from service.result.motion_json import motion_from_json
from service.result.phase_report import PhaseReport, PhaseStatus, report_phases
from service.result.result_json import add_reports, proof_summary
from service.result.versions import find_format
from service.verify import Certificate, Motion, Status, VerifyError, robot_hash, verify

OTHER = "it answers another request, or was changed after it was written"
WITHOUT_CERTIFICATE = ("FEASIBLE_AT_SAMPLES", "NOT_FOUND", "INFEASIBLE", "TIME_LIMIT", "CANCELLED")


@dataclass(frozen=True)
class _Result:
    """A result to verify.

    Attributes:
        data: its ``result.json``, with the keys of this format.
        folder: where it is.
        robot, recorded: its robot, without the joints that the task moves, and its motion.
        request: file of the user's request, or None.
        clouds: files of the request's scan, to be read again.
        files: what was found about the files of the folder.
    """

    data: dict[str, Any]
    folder: Path
    robot: RobotModel
    recorded: Motion
    request: Path | None
    clouds: Sequence[Path]
    files: FileFindings

    @property
    def table(self) -> Path | None:
        """The table of its samples, if there is one."""
        table = self.folder / TRAJECTORY_NAME
        return table if table.is_file() else None

    @property
    def version(self) -> int:
        """Number of its format."""
        return find_format(self.data) or FORMAT


@dataclass(frozen=True)
class _Answer:
    """A new certificate of a result's motion.

    Attributes:
        certificate: held to the demands of ``grounds``, if there are any.
        reports: of its phases.
        differences: one sentence for each part of the result that is not the request's or contradicts another.
        grounds: sources of the demands, or None.
        standing: of the recorded certificate, or None without one.
    """

    certificate: Certificate
    reports: Sequence[PhaseReport]
    differences: tuple[str, ...]
    grounds: Grounds | None = None
    standing: Standing | None = None


def verify_result(
    path: str | Path, request: Path | None = None, clouds: Sequence[Path] = (), checked: Collection[str] = ()
) -> dict[str, Any]:
    """Return the verdict on a result folder: the keys of ``summary_json``, ``held_to``, ``standing``, ``unchecked``.

    The demands on a certified motion are rebuilt from the request, and the folder's are compared with them. A
    certificate of an earlier format that does not meet today's gets the verdict ``HELD_BEFORE``.

    Args:
        path: the folder or its ``result.json``.
        request: file of the user's request; by default the request in the folder.
        clouds: files of the request's scan, to be read again; by default the recorded pieces are taken.
        checked: files of the folder that the caller has checked, such as an approval; ``unchecked`` names all others
            of which nothing is known.

    Raises:
        ResultError: the folder cannot be read.
        DamagedResultError: its data contradict each other or the request.
        RequestError: the user's request, or a file that it names, cannot be used.
    """
    started = time.perf_counter()
    data = read_result(path)
    folder = result_path(path).parent
    robot, recorded = read_record(data, folder)
    compared = {TRAJECTORY_NAME} if data.get("certificate") is not None else set()
    with _explain_defects(folder):
        files = check_files(folder, data, robot, recorded, {*compared, *checked})
    result = _Result(data, folder, robot, recorded, request, clouds, files)
    if data["verdict"] != Status.CERTIFIED.value:
        answer = _verify_unclaimed(result)
    elif data.get("certificate") is None:
        raise DamagedResultError(f"{folder}: the verdict is CERTIFIED, and there is no certificate; {CHANGED}")
    else:
        answer = _verify_claim(result) if result.version == FORMAT else _verify_earlier(result)
    certificate, standing = answer.certificate, answer.standing
    verdict, explanation = _judge(data["verdict"], certificate)
    if standing is not None and standing.state is State.HELD_BEFORE:
        verdict, explanation = HELD_BEFORE, [standing.sentence(), *explanation]
    return {
        "verdict": verdict,
        "explanation": [*explanation, *answer.differences],
        "notes": [*certificate.notes, *files.notes],
        "unchecked": list(files.unchecked),
        "held_to": None if answer.grounds is None else answer.grounds.sentence(),
        "standing": None if standing is None else standing.to_json(),
        "timings": {"verify": time.perf_counter() - started},
        **proof_summary(certificate),
        "phases": add_reports(data["phases"], answer.reports),
        "not_planned": data["not_planned"],
    }


def _verify_unclaimed(result: _Result) -> _Answer:
    """Verify the motion of a result that does not claim to be certified, by the promises that it records."""
    data = result.data
    with _explain_defects(result.folder):
        certificate = verify(result.recorded)
        reports = report_phases(result.recorded, certificate, _read_unsolved(data))
        differences = result.files.differences
        if data.get("certificate") is not None:
            differences = _compare_record(result, certificate, reports)
    return _Answer(certificate, reports, differences)


def _verify_claim(result: _Result) -> _Answer:
    """Verify the motion of a certified result of this format, held to its request."""
    held, demands, grounds = _hold(result)
    with _explain_defects(result.folder):
        certificate = verify(held.motion)
        reports = report_phases(held.motion, certificate)
        differences = (
            *held.differences,
            *_compare_demands(result, demands, held.motion, certificate),
            *(() if grounds.hits is None else compare_hits(result.data["detections"], grounds.hits)),
            *_compare_record(result, certificate, reports),
            *compare_servos(result.data["servo"], held.motion, demands, certificate),
        )
    is_certified = certificate.status is Status.CERTIFIED
    if is_certified:
        _refuse_changes(result, differences, CHANGED if result.request is None else OTHER)
    standing = Standing.of(FORMAT) if is_certified else None
    return _Answer(certificate, reports, differences, grounds, standing)


def _verify_earlier(result: _Result) -> _Answer:
    """Verify the motion of a certified result of an earlier format: its record first, then against today's demands."""
    own = _verify_record(result)
    try:
        held, demands, grounds = _hold(result)
        with _explain_defects(result.folder):
            certificate = verify(held.motion)
            reports = report_phases(held.motion, certificate)
            differences = (*held.differences, *_compare_demands(result, demands, held.motion, certificate))
    except (RequestError, ResultError) as error:
        if own is None or result.request is not None or result.clouds:
            raise
        reason = " ".join(str(error).removeprefix(f"{result.folder}: ").split())
        return _Answer(own, report_phases(result.recorded, own), (), None, Standing.of(result.version, [reason]))
    is_own = result.request is None and not result.clouds
    if is_own and demands.request.goal is not None and _has_robot(result, demands):
        _refuse_changes(result, differences)  # what a goal promises has been the same in all formats
    standing = Standing.compare(result.version, result.data["certificate"], certificate, differences)
    is_other = result.request is not None and not has_hash(demands.request, result.data["request_hash"])
    if is_other and differences:
        raise ResultError("\n".join(f"{result.folder}: {line}; {OTHER}" for line in differences))
    return _Answer(certificate, reports, differences, grounds, standing)


def _verify_record(result: _Result) -> Certificate | None:
    """Return a certificate of the promises that an earlier format recorded; None where they are not enough for one.

    Raises:
        DamagedResultError: the record contradicts itself.
    """
    with _explain_defects(result.folder):
        try:
            own = verify(result.recorded)
        except VerifyError:
            own = None
        contradictions = find_contradictions(result.data, result.recorded, result.robot, own, result.table)
        unsolved = [
            f"phase '{phase['name']}' is {phase['status']}"
            for phase in result.data["phases"]
            if phase["status"] not in (None, PhaseStatus.CERTIFIED.value)
        ]
    _refuse_changes(result, (*contradictions, *unsolved, *result.files.differences))
    return own


def _has_robot(result: _Result, demands: Demands) -> bool:
    """Return whether today's reading of a request gives the recorded robot."""
    return robot_hash(result.robot) == robot_hash(demands.robot)


def _refuse_changes(result: _Result, lines: Sequence[str], why: str = CHANGED) -> None:
    """Refuse a result with a sentence for each part that was changed (``DamagedResultError``), if there are any."""
    if lines:
        raise DamagedResultError("\n".join(f"{result.folder}: {line}; {why}" for line in lines))


def _hold(result: _Result) -> tuple[HeldMotion, Demands, Grounds]:
    """Return the recorded motion with the promises of its request, the demands, and their sources."""
    record = RecordedWorld(result.robot, result.recorded.scene)
    demands, grounds = _read_demands(result.data, result.folder, record, result.request, result.clouds)
    with _explain_defects(result.folder):
        return hold_to_request(demands, result.recorded), demands, grounds


def _compare_demands(result: _Result, demands: Demands, motion: Motion, certificate: Certificate) -> Iterator[str]:
    """Yield a sentence for each demand on speed that is not met, and for each figure that is not the motion's."""
    yield from compare_pace(demands.request, certificate)
    yield from compare_figures(result.data["figures"], demands, motion)


def _compare_record(result: _Result, certificate: Certificate, reports: Sequence[PhaseReport]) -> tuple[str, ...]:
    """Return a sentence for each statement of a result that is not that of a new certificate."""
    contradictions = find_contradictions(result.data, result.recorded, result.robot, certificate, result.table)
    return (*_compare_phases(result.data, reports), *contradictions, *result.files.differences)


def _read_demands(
    data: dict[str, Any], folder: Path, record: RecordedWorld, given: Path | None, clouds: Sequence[Path]
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
        raise DamagedResultError(f"{folder}: the request in this folder cannot be used: {line}; {CHANGED}") from None


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


def read_request(data: dict[str, Any], folder: Path) -> PlanRequest:
    """Return the request of a parsed ``result.json``, with the defaults with which it was planned.

    Raises:
        DamagedResultError: it cannot be used, or its format or its defaults are not those of such a request.
    """
    try:
        request = parse_request(data.get("request"), folder)
        if find_format(data) == FORMAT:
            _check_request_format(data, request)
        defaults = data.get("request_defaults", {})
        if defaults == list_defaults(request):
            return request
        return parse_request(insert_defaults(request, defaults), folder)
    except RequestError as error:
        line = " ".join(str(error).split())
        raise DamagedResultError(f"{folder}: request of result.json cannot be used: {line}; {CHANGED}") from None


def _check_request_format(data: Mapping[str, Any], request: PlanRequest) -> None:
    """Refuse another format of the request, or other fields with defaults, than this version writes (RequestError)."""
    expected, names = find_request_format(request), list_defaults(request).keys()
    if data.get("request_format") != expected:
        raise RequestError(f"request_format: expected {expected}, got {shown(data.get('request_format'))}")
    missing = sorted(names - set(data.get("request_defaults") or ()))
    if missing:
        raise RequestError(f"request_defaults: {missing[0]} is missing")


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
        raise DamagedResultError(
            f"{folder}: result.json lacks {error}; docs/result-format.md lists what it holds"
        ) from None
    except (RobotError, VerifyError, ValueError, TypeError, IndexError, AttributeError) as error:
        line = " ".join(str(error).split())
        raise DamagedResultError(f"{folder}: result.json cannot be used: {line}") from None


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
