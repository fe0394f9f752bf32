"""What a user gets: verdict, motion, certificate, and everything needed to check and to draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.explain.conflict import Conflict
from service.request.schema import PlanRequest
from service.verify.certificate import Certificate
from service.verify.motion import Motion


class Verdict(Enum):
    """How a plan ended."""

    CERTIFIED = "CERTIFIED"  # proven on the whole curve
    FEASIBLE_AT_SAMPLES = "FEASIBLE_AT_SAMPLES"  # dense samples hold, a proof is missing
    NOT_FOUND = "NOT_FOUND"  # no feasible trajectory found: local evidence only
    INFEASIBLE = "INFEASIBLE"  # for a reason that holds globally
    TIME_LIMIT = "TIME_LIMIT"
    CANCELLED = "CANCELLED"
    INVALID_REQUEST = "INVALID_REQUEST"


@dataclass(frozen=True)
class PlanResult:
    """The answer to a request; the best motion found always comes along.

    Attributes:
        request: as it was understood.
        verdict: how it ended; ``explanation`` says what stands in the way (empty when certified).
        robot: the robot, without the joints of what the task moves.
        scene: the pieces it was planned and checked against.
        start: (n,) configuration at which the robot stands at first.
        motion: what is executed, timed and sampled, with its phases; its robot may have the joints of a mechanism as
            its last coordinates. None when there is nothing to execute.
        certificate: what the verifier says of ``motion``.
        conflict: the demands that stand against each other at a step without a solution; None where there is none.
        found_from: the start of the optimiser that led to the motion, in words; empty where there was but one.
        notes: what was snapped, assumed or detected.
        planning_time_s: wall time of it all; ``timings`` maps its steps to seconds.
        figures: numbers the task reports (JSON-ready); detections: what perception found (JSON-ready).
        obstruction: where a motion that was never planned should have ended (JSON-ready).
        cloud: (N, 3) obstacle points to draw [m].
    """

    request: PlanRequest
    verdict: Verdict
    robot: RobotModel
    scene: Scene
    start: Float[np.ndarray, "n"]
    motion: Motion | None = None
    certificate: Certificate | None = None
    explanation: tuple[str, ...] = ()
    conflict: Conflict | None = None
    found_from: str = ""
    notes: tuple[str, ...] = ()
    planning_time_s: float = 0.0
    timings: Mapping[str, float] = field(default_factory=dict)
    figures: Mapping[str, Any] = field(default_factory=dict)
    detections: tuple[Mapping[str, Any], ...] = ()
    obstruction: Mapping[str, Any] | None = None
    cloud: Float[np.ndarray, "N 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if self.start.shape != (self.robot.n,):
            raise ValueError(f"start must have shape ({self.robot.n},), got {self.start.shape}")
        if self.motion is not None and self.motion.robot.joint_names[: self.robot.n] != self.robot.joint_names:
            raise ValueError("the motion's robot must begin with the joints of the result's robot")
        if self.verdict is Verdict.CERTIFIED and self.certificate is None:
            raise ValueError("a certified result needs its certificate")
