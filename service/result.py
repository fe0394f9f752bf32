"""What a user gets: trajectory, verdict, and everything needed to check and to draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.request import PlanRequest


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
class Where:
    """The place a check speaks of: when [s], where in the world [m], and which links or pieces."""

    time_s: float | None = None
    position: tuple[float, float, float] | None = None
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Check:
    """One line of the verdict: ``value`` against ``limit`` in ``unit``; ``text`` says it in words."""

    name: str
    ok: bool
    value: float | None
    limit: float | None
    unit: str
    text: str
    where: Where = field(default_factory=Where)


@dataclass(frozen=True)
class Contact:
    """Where a link stays planted: its pose and the corners of its sole in the world [m]."""

    link: str
    position: Float[np.ndarray, "3"]
    quaternion_wxyz: Float[np.ndarray, "4"]
    sole: Float[np.ndarray, "C 3"]


@dataclass(frozen=True)
class Phase:
    """A named part of the trajectory, samples ``first`` to ``last`` inclusive.

    ``targets`` are JSON-ready mappings as docs/result-format.md lists them.
    """

    name: str
    first: int
    last: int
    contacts: tuple[Contact, ...] = ()
    allowances: tuple[Allowance, ...] = ()
    targets: tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True)
class SupportPolygon:
    """Samples ``first`` to ``last`` stand on ``polygon`` (counter-clockwise) [m] and stay ``margin_m`` inside it."""

    first: int
    last: int
    polygon: Float[np.ndarray, "C 2"]
    margin_m: float


@dataclass(frozen=True)
class Movable:
    """What the task moves: bodies in the world at angle 0, turned about ``axis`` through ``origin`` by ``angles``."""

    name: str
    joint: str
    origin: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    bodies: tuple[ConvexPiece, ...]
    angles: Float[np.ndarray, "S"]


@dataclass(frozen=True)
class PlanResult:
    """The answer to a request; the best trajectory found always comes along.

    Attributes:
        request: as it was understood.
        verdict: how it ended; ``explanation`` says what stands in the way (empty when certified).
        robot: the robot, without the joints of what the task moves.
        scene: the pieces it was planned and checked against.
        q: (S, n) dense samples in the robot's coordinates, at ``times`` (S,) [s]; S may be 0 or 1.
        notes: what was snapped, assumed or detected.
        planning_time_s: wall time of it all; ``timings`` maps its steps to seconds.
        min_clearance_m: smallest certified clearance of the pairs not allowed to touch, with their two names.
        min_balance_margin_m: smallest distance of the balance point inside the support polygon.
        curve, law: the executed curve and its timing; its columns are ``curve_joint_names``.
        waypoints: indices of the samples that are waypoints.
        com, zmp: (S, 3) and (S, 2) in the world [m].
        certificate: the proof as data (``service.verify``).
        figures: numbers the task reports; detections: what perception found (JSON-ready).
        cloud: (N, 3) obstacle points to draw.
    """

    request: PlanRequest
    verdict: Verdict
    robot: RobotModel
    scene: Scene
    q: Float[np.ndarray, "S n"]
    times: Float[np.ndarray, "S"]
    explanation: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    planning_time_s: float = 0.0
    timings: Mapping[str, float] = field(default_factory=dict)
    min_clearance_m: float | None = None
    min_clearance_pair: tuple[str, str] | None = None
    min_balance_margin_m: float | None = None
    curve: Curve | None = None
    law: TimeLaw | None = None
    curve_joint_names: tuple[str, ...] = ()
    waypoints: tuple[int, ...] = ()
    phases: tuple[Phase, ...] = ()
    movables: tuple[Movable, ...] = ()
    support_polygons: tuple[SupportPolygon, ...] = ()
    com: Float[np.ndarray, "S 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    zmp: Float[np.ndarray, "S 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    checks: tuple[Check, ...] = ()
    certificate: Any = None
    figures: Mapping[str, Any] = field(default_factory=dict)
    detections: tuple[Mapping[str, Any], ...] = ()
    cloud: Float[np.ndarray, "N 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if self.q.shape != (len(self.times), self.robot.n):
            raise ValueError(f"q must be ({len(self.times)}, {self.robot.n}), got {self.q.shape}")
        if len(self.times) > 1 and np.any(np.diff(self.times) <= 0.0):
            raise ValueError("times must increase strictly")
