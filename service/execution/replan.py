"""The rest of a plan, planned again from where its execution stands, with an adjusted target."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import BASE_NAMES
from costs.rotation import make_quaternions
from service.errors import ExecutionError, ResultError
from service.execution.execution import Execution
from service.execution.reference import PlannedReference
from service.planner import plan
from service.replay.adjust import adjust_request
from service.replay.replay import verify_result
from service.replay.rest import make_rest_request, read_recorded_scan
from service.result.folder import check_folder
from service.result.output import write_result


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
