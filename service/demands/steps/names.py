"""Names and values of steps that do not fit the robot."""

from __future__ import annotations

from collections.abc import Iterator

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.steps.compile import compile_step
from service.errors import RequestError, would_do
from service.request.schema import PlanRequest
from service.request.tasks.steps import StepRequest
from service.start.configuration import SNAP_TOLERANCE, find_limit_violations, find_unknown_joints, find_unknown_links


def list_step_problems(robot: RobotModel, step: StepRequest, field: str, request: PlanRequest) -> Iterator[str]:
    """Yield a line per unknown hand, frame, joint or posture of a step, and per joint value beyond its limits."""
    move = step.move
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
    pieces = {obstacle.name for obstacle in request.scene.obstacles}
    wanted = step.follow.face.pieces if step.follow is not None else step.touch.pieces if step.touch is not None else ()
    if request.scene.cloud is None and request.scene.file is None:
        where = "follow.face" if step.follow is not None else "touch"
        yield from (
            f"{field}.{where}.pieces: unknown piece {name!r}; expected {would_do(name, pieces) or 'an obstacle'}"
            for name in wanted
            if name not in pieces
        )
    try:
        compile_step(robot, Scene(()), step, field)
    except RequestError as error:
        yield from (f"{field}: {problem}" for problem in error.problems)
