"""Names and values of steps that do not fit the robot."""

from __future__ import annotations

from collections.abc import Iterator

from service.demands.steps.compile import compile_step
from service.demands.steps.extent import NamedStep
from service.demands.steps.holding import Holding, choose_grippers
from service.errors import RequestError, would_do
from service.request.schema import PlanRequest
from service.request.tasks.step_objects import GraspStep
from service.request.tasks.steps import StepRequest
from service.start.configuration import SNAP_TOLERANCE, find_limit_violations, find_unknown_joints, find_unknown_links


def list_step_problems(start: Holding, step: StepRequest, field: str, request: PlanRequest) -> Iterator[str]:
    """Yield a line per unknown hand, frame, joint or posture of a step, and per joint value beyond its limits.

    Args:
        start: the objects at the start.
        step, field: the step, and where it is in the request.
        request: all of it.
    """
    move, robot = step.move, start.placed
    if move is not None:
        yield from find_unknown_joints(robot, move.joints, f"{field}.move.joints") or find_limit_violations(
            robot, move.joints, f"{field}.move.joints", SNAP_TOLERANCE
        )
        if move.posture is not None and move.posture not in robot.postures:
            known = would_do(move.posture, robot.postures) or "no postures; give joints"
            yield f"unknown posture {move.posture!r} in {field}.move.posture; {robot.name} has {known}"
            return
        for index, pose in enumerate(move.poses):
            yield from find_unknown_links(robot, (pose.link,), f"{field}.move.poses[{index}].link")
            if pose.relative_to is not None:
                where = f"{field}.move.poses[{index}].relative_to"
                yield from find_unknown_links(robot, (pose.relative_to,), where)
    pieces = {obstacle.name for obstacle in request.scene.obstacles}
    where, wanted = _find_pieces(step)
    if request.scene.cloud is None and request.scene.file is None:
        yield from (
            f"{field}.{where}.pieces: unknown piece {name!r}; expected {would_do(name, pieces) or 'an obstacle'}"
            for name in wanted
            if name not in pieces
        )
    try:
        compile_step(start, NamedStep(0, field, step))
        if step.hold is not None:
            choose_grippers(robot, step.hold.hand, "hold.hand")
        if step.grasp is not None:
            choose_grippers(robot, step.grasp.hand, "grasp.hand")
            yield from _list_grasp_problems(start, step.grasp, field)
    except RequestError as error:
        yield from (f"{field}: {problem}" for problem in error.problems)


def _find_pieces(step: StepRequest) -> tuple[str, tuple[str, ...]]:
    """Return the field that names pieces of the scene, and their names."""
    if step.follow is not None:
        return "follow.face", step.follow.face.pieces
    if step.touch is not None:
        return "touch", step.touch.pieces
    return (step.kind, step.fit.pieces) if step.fit is not None else ("", ())


def _list_grasp_problems(start: Holding, grasp: GraspStep, field: str) -> Iterator[str]:
    given = len(start.items[grasp.object].given.grasps)
    if grasp.grasp is not None and grasp.grasp >= given:
        yield f"{field}.grasp.grasp: {grasp.grasp}; {grasp.object} has {given or 'no'} grasps, numbered from 0"
