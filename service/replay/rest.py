"""Request for the rest of an earlier plan: from one of its phases on, starting at the robot's state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from costs.robot import BASE_NAMES, RobotModel
from service.demands import has_scan
from service.demands.held_motion import Demands
from service.demands.rest.earlier_motion import record_motion
from service.demands.task_demand import IncompletePlanError
from service.demands.valve.demand import turn_back
from service.errors import RequestError, ResultError, shown
from service.replay.detections import read_doors, read_seen_parts, read_valves
from service.replay.rebuild import RecordedWorld, rebuild_demands, select_scanned
from service.replay.replay import read_record, read_request
from service.request.file import hash_request_data, load_section, replace_cloud
from service.request.resume import ResumeRequest
from service.request.scene import MeshRequest
from service.request.schema import PlanRequest, PoseRequest, StartRequest, StateRequest
from service.result.folder import read_result, result_path
from service.result.manifest import hash_certificate
from service.result.motion_json import BASE_COLUMNS
from service.setup.world import Surroundings
from service.start.configuration import make_start_configuration
from service.verify import Motion


def hash_plan(data: Mapping[str, Any]) -> str:
    """Return the hash of the certificate of a parsed ``result.json``, as ``resume.plan`` cites it."""
    return hash_certificate(data)


def make_rest_request(
    path: Path, phase: str, state_file: Path | None, cloud: Path | None = None, *, is_compliant: bool = False
) -> PlanRequest:
    """Return the request that plans the rest of an earlier plan from the robot's state.

    Args:
        path: result folder of the earlier plan, or its ``result.json``.
        phase: name of the phase to begin with.
        state_file: file with a ``StateRequest``; None for the state in which the earlier plan begins the phase.
        cloud: new scan, which shows the scene as it is now.
        is_compliant: whether the earlier motion is kept if it can be, and only the arm that holds yields.

    Raises:
        ResultError: the earlier plan cannot be read or continued.
        RequestError: one line per problem of the state.
    """
    data = read_result(path)
    folder = result_path(path).parent
    if data.get("certificate") is None or not data["phases"]:
        raise ResultError(
            f"{folder}: the plan has no certified motion to continue; plan its request from the new state"
        )
    request = read_request(data, folder)
    if data["request_hash"] != hash_request_data(data["request"]):
        raise ResultError(
            f"{folder}: request_hash does not fit the request; the result was changed after it was written"
        )
    plan = hash_plan(data)
    robot, motion = read_record(data, folder)
    state = _read_state(data, phase) if state_file is None else load_section(StateRequest, state_file)
    source = folder.name if state_file is None else state_file.name
    if state.plan is not None and state.plan != plan:
        raise RequestError(f"{source}: plan: {shown(state.plan)} is not the plan in {folder}, which is {plan}")
    with _as_result_error(folder):
        demands = _rebuild(data, request, robot, motion)
        resume = _make_resume(demands, motion)
    resume = replace(resume, phase=phase, plan=plan, mechanism=state.mechanism, is_rescanned=cloud is not None)
    if is_compliant:
        if resume.nominal is None or demands.task.changes_contacts:
            raise ResultError(f"{folder}: no hand holds a mechanism in this plan; there is nothing to yield to")
        resume = replace(resume, is_compliant=True)
    names = [*(entry["name"] for entry in data["phases"]), *data["not_planned"]]
    if request.goal is not None and phase not in names:
        raise RequestError(f"--from-phase: unknown phase {shown(phase)}; the plan has {', '.join(names)}")
    start = _read_start(robot, state, source)
    rest = replace(request, start=start, resume=resume)
    q = make_start_configuration(robot, start)[0]
    with _as_result_error(folder):
        task = demands.task.make_rest(demands.world, motion, phase, q, state.contacts)
    if task is not None:
        rest = replace(rest, task=task)
    elif state.contacts is not None:
        rest = replace(rest, options=replace(request.options, feet=state.contacts))
    return rest if cloud is None else replace_cloud(rest, cloud)


@contextmanager
def _as_result_error(folder: Path) -> Iterator[None]:
    """Name the folder of a plan whose rest cannot be planned."""
    try:
        yield
    except IncompletePlanError as error:
        raise ResultError(f"{folder}: {error}; only the rest of a complete plan can be planned again") from None


def _rebuild(data: dict[str, Any], request: PlanRequest, robot: RobotModel, motion: Motion) -> Demands:
    return rebuild_demands(
        request,
        RecordedWorld(robot, motion.scene, read_valves(data), read_doors(data), read_seen_parts(data)),
        None,
        (),
    )[0]


def read_recorded_scan(path: Path, request: PlanRequest) -> Surroundings | None:
    """Return what the scan of an earlier plan showed; None where its request has no scan.

    The scan itself shows the robot where the earlier plan began, and is not read again.

    Raises:
        RequestError: a mesh of the request is matched with the scan.
    """
    if not has_scan(request):
        return None
    if any(isinstance(obstacle, MeshRequest) and obstacle.match for obstacle in request.scene.obstacles):
        raise RequestError("scene.obstacles: a mesh is matched with the scan; give a new one with --cloud")
    data, folder = read_result(path), result_path(path).parent
    _, motion = read_record(data, folder)
    earlier = read_request(data, folder).resume
    valves = tuple(turn_back(valve, earlier) for valve in read_valves(data))
    return Surroundings(
        select_scanned(request, motion.scene), valves, doors=read_doors(data), seen=read_seen_parts(data)
    )


def _make_resume(demands: Demands, motion: Motion) -> ResumeRequest:
    """Return a section with the choices of the earlier plan; those that it kept itself are kept on."""
    resume = demands.request.resume
    if resume is not None:
        return resume if resume.nominal is None else replace(resume, nominal=record_motion(motion))
    if not demands.request.section.can_resume:
        raise IncompletePlanError("its task has no phases")
    nominal = record_motion(motion) if demands.task.keeps_motion else None
    choices = demands.task.keep_choices(motion)
    return ResumeRequest(phase="-", plan="sha256:" + 64 * "0", nominal=nominal, **choices)


def _read_state(data: dict[str, Any], phase: str) -> StateRequest:
    """Return the state in which an earlier plan begins a phase.

    Raises:
        RequestError: it has no such phase.
    """
    first = {entry["name"]: entry["first"] for entry in data["phases"]}
    if phase not in first:
        raise RequestError(f"--from-phase: unknown phase {shown(phase)}; the plan has {', '.join(first)}")
    trajectory, at = data["trajectory"], first[phase]
    values = dict(zip(trajectory["joint_names"], trajectory["positions"][at], strict=True))
    base = None
    if set(BASE_COLUMNS) <= set(values):
        numbers = [values.pop(name) for name in BASE_COLUMNS]
        base = PoseRequest(tuple(numbers[:3]), tuple(numbers[3:]))
    mechanism = {movable["joint"]: movable["angles"][at] for movable in data["movables"]}
    return StateRequest(joints=values, base=base, mechanism=mechanism)


def _read_start(robot: RobotModel, state: StateRequest, file: str) -> StartRequest:
    """Return the start at a state, which names every joint.

    Raises:
        RequestError: one line for missing joints or a missing base.
    """
    given = {*state.joints, *state.joint_names}
    own = robot.joint_names[len(BASE_NAMES) :] if robot.is_floating else robot.joint_names
    missing = [name for name in own if name not in given]
    problems = []
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        problems.append(f"{file}: joints: {', '.join(missing[:3])}{more} missing; expected every joint of {robot.name}")
    if robot.is_floating and state.base is None:
        problems.append(f"{file}: base: is missing; expected position and quaternion_wxyz")
    if problems:
        raise RequestError(problems)
    return StartRequest(joints=state.joints, joint_names=state.joint_names, positions=state.positions, base=state.base)
