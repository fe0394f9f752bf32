"""Check of doors, valves and mechanisms that a request gives by numbers: what could not be built is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.demands.kind import find_demand_part
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
    part = find_demand_part(request)
    problems = list(part.list_given_problems(request.section, robot, start, obstacles))
    if problems:
        raise RequestError(problems)
