"""The rest of a plan, planned again from where its execution stands, with an adjusted target."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from costs.rotation import make_quaternions
from service.errors import ExecutionError, ResultError, would_do
from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.execution.shift import Shift
from service.planner import plan
from service.replay.replay import verify_result
from service.replay.resume import make_rest_request, read_recorded_scan
from service.request.schema import PlanRequest
from service.result.folder import check_folder
from service.result.output import write_result
from service.setup.world import Surroundings

VALVE = "valve"


def write_state(execution: Execution, path: Path) -> None:
    """Write where an execution stands as a file for ``scopt plan --from-phase``.

    The state is the commanded one: the new plan begins where the joints' servos are told to be, so that nothing jumps.

    Raises:
        ExecutionError: the robot moves, or the file cannot be written.
    """
    if not execution.is_at_rest:
        raise ExecutionError(f"the execution is {execution.state.mode.value} and moves; pause it before planning again")
    path.write_text(json.dumps(_describe_state(execution)))


def _describe_state(execution: Execution) -> dict[str, Any]:
    reference, q = execution.reference, execution.command.q
    columns = reference.joint_columns.tolist()
    state: dict[str, Any] = {
        "joints": {name: float(q[k]) for name, k in zip(reference.joint_names, columns, strict=True)},
        "mechanism": dict(
            zip(
                reference.mechanism_names,
                reference.at(execution.state.time_s).mechanism.tolist(),
                strict=True,
            )
        ),
    }
    if reference.robot.is_floating:
        state["base"] = {
            "position": q[:3].tolist(),
            "quaternion_wxyz": make_quaternions(q[None, 3 : len(BASE_NAMES)])[0].tolist(),
        }
    return state


def adjust_request(
    request: PlanRequest, around: Surroundings | None, target: str, offset: Float[np.ndarray, "3"]
) -> tuple[PlanRequest, Surroundings | None]:
    """Return a request, and what its scan shows, with a target displaced.

    Args:
        request: the request for the rest.
        around: what its scan shows, if it has one.
        target: link of a goal's pose, or ``valve``.
        offset: displacement in world axes [m].

    Raises:
        ExecutionError: the request has no such target, or the displacement makes no sense.
    """
    offset = Shift.zero().towards(offset).goal
    valve = None if request.task is None else request.task.valve
    poses = () if request.goal is None else request.goal.poses
    known = [pose.link for pose in poses] if valve is None else [VALVE]
    if target not in known:
        expected = f"expected {would_do(target, known)}" if known else "only poses of a goal and valves can be"
        raise ExecutionError(f"adjust: this plan has no target {target!r} that can be displaced; {expected}")
    if request.goal is not None:
        moved = tuple(
            replace(pose, position=_add(pose.position, offset)) if pose.link == target else pose for pose in poses
        )
        return replace(request, goal=replace(request.goal, poses=moved)), around
    if valve is not None and request.task is not None and valve.centre is not None:
        given = replace(valve, centre=_add(valve.centre, offset))
        return replace(request, task=replace(request.task, valve=given)), around
    if around is None or not around.valves:
        raise ExecutionError("adjust: the earlier plan recorded no valve")
    first = replace(around.valves[0], centre=around.valves[0].centre + offset)
    return request, replace(around, valves=(first, *around.valves[1:]))


def plan_rest(
    folder: Path,
    phase: str,
    state_file: Path,
    adjustments: Mapping[str, Float[np.ndarray, "3"]],
    output: Path,
    *,
    cloud: Path | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> PlannedReference:
    """Plan again from a phase on, with displaced targets; write the result and return it as a reference.

    Args:
        folder: result folder of the plan that is carried out.
        phase: name of the phase to begin with.
        state_file: from ``write_state``.
        adjustments: displacement by target, as in ``adjust_request`` [m].
        output: result folder of the new plan.
        cloud: new scan.
        should_stop: polled often.

    Raises:
        ExecutionError: a target cannot be displaced, or no certified motion was found.
        ResultError, RequestError: the earlier plan cannot be continued.
    """
    check_folder(output)
    request = make_rest_request(folder, phase, state_file, cloud)
    around = read_recorded_scan(folder, request) if cloud is None else None
    for target, offset in adjustments.items():
        request, around = adjust_request(request, around, target, offset)
    result = plan(request, should_stop=should_stop, around=around)
    if result.verdict.value != "CERTIFIED" or result.motion is None:
        why = result.explanation[0] if result.explanation else "no motion"
        raise ExecutionError(f"no new plan from '{phase}' on: {result.verdict.value}, {why}")
    write_result(result, output)
    return PlannedReference.read(output)


def read_certified(folder: Path) -> PlannedReference:
    """Return the plan of a result folder that ``scopt verify`` finds certified now, whatever the folder says.

    Raises:
        ResultError: one line: the folder cannot be read or was changed, its motion is not certified, or it cannot be
            executed.
        RequestError: a file that its request names cannot be used.
    """
    summary = verify_result(folder)
    if summary["verdict"] != "CERTIFIED":
        why = summary["explanation"][0] if summary["explanation"] else "no certificate"
        raise ResultError(f"{folder} is {summary['verdict']}: {why}; only certified plans are carried out")
    return PlannedReference.read(folder)


def _add(place: tuple[float, float, float], offset: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = (np.asarray(place) + offset).tolist()
    return x, y, z
