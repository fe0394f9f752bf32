"""What a request demands of every motion that answers it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.program import ProgramDemand
from service.demands.stance import planted_feet
from service.demands.wheel import Wheel
from service.request.schema import PlanRequest


@dataclass(frozen=True)
class Demands:
    """What a request demands of every motion that answers it.

    Attributes:
        request: as it was asked.
        robot: without what a task moves.
        start: (n,) where it stands at first.
        scene: all pieces, the floor's included.
        program: what the request's TrajOpt problem demands, or None.
        wheel: the valve that the request has turned, or None.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene
    program: ProgramDemand | None = None
    wheel: Wheel | None = None

    @property
    def feet(self) -> tuple[str, ...]:
        """Links that are planted."""
        if self.program is not None:
            return self.program.planted
        return planted_feet(self.robot, self.request.options.feet)
