"""Check of doors, valves and mechanisms that a request gives by numbers: what could not be built is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.demands.door.demand import read_given_door
from service.demands.mechanism.given import read_given_mechanism
from service.demands.plausible import list_door_problems, list_mechanism_problems
from service.errors import RequestError
from service.request.schema import PlanRequest


def check_given_objects(
    request: PlanRequest, robot: RobotModel, start: Float[np.ndarray, "n"], obstacles: Sequence[ConvexPiece]
) -> None:
    """Refuse a handle that is not on its leaf, and a mechanism whose moving parts are inside what stands still.

    Args:
        request: with the mechanism's URDF as text.
        robot: the robot.
        start: (n,) configuration at the start.
        obstacles: pieces of the request's obstacles.

    Raises:
        RequestError: one line with field and distance.
    """
    task, problems = request.task, list[str]()
    if task is not None and task.door is not None:
        geometry = read_given_door(task.door, start[:3] if robot.is_floating else np.zeros(3))
        problems += [] if geometry is None else list_door_problems(geometry)
    if task is not None and task.mechanism is not None:
        problems += list_mechanism_problems(read_given_mechanism(task.mechanism), obstacles)
    if problems:
        raise RequestError(problems)
