"""Result of a plan: verdict, motion, certificate, and everything needed to check and draw them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import Scene
from service.body.monitor import TriedStart
from service.explain.conflict import Conflict
from service.request.schema import PlanRequest
from service.result.motion_json import sample_rates, sample_times, samples_of
from service.result.phase_report import PhaseReport, report_phases
from service.verify import Certificate, Motion, round_down


class Verdict(Enum):
    """How a plan ended."""

    CERTIFIED = "CERTIFIED"  # proven on the whole curve
    FEASIBLE_AT_SAMPLES = "FEASIBLE_AT_SAMPLES"  # dense samples hold, a proof is missing
    NOT_FOUND = "NOT_FOUND"  # no feasible trajectory found: local evidence only
    INFEASIBLE = "INFEASIBLE"  # for a reason that holds globally
    TIME_LIMIT = "TIME_LIMIT"
    CANCELLED = "CANCELLED"
    INVALID_REQUEST = "INVALID_REQUEST"


@dataclass(frozen=True, repr=False)
class PlanResult:
    """Result of a plan, with the best motion found.

    Attributes:
        request: the request with all defaults filled in.
        verdict: how the plan ended.
        robot: the robot, without the joints that the task moves.
        scene: pieces that the motion was planned and checked against.
        start: (n,) first configuration.
        motion: the motion, timed and sampled; the last coordinates of its robot may be joints of a mechanism.
        certificate: the verifier's certificate of ``motion``.
        unsolved: names of phases in the motion that are the best attempts at steps without a solution.
        task_phases: names of all phases of a task that stopped at such a step; empty where it does not know them.
        explanation: what prevents a certified motion; empty when certified.
        conflict: demands that contradict each other at a step without a solution.
        found_from: start of the optimiser that led to the motion; empty if there was only one.
        tried: every start that the search tried, with its cost and outcome.
        notes: what was adjusted, assumed or detected.
        planning_time_s: wall time of the plan; ``timings`` maps its steps to seconds.
        pose_graph: poses from which a sequence of stances was chosen (JSON-ready), or None.
        servo: stiffness of the joints' servos and the expected sag of the centre of mass (JSON-ready), or None.
    figures, detections: numbers reported by the task, and objects in the scan (JSON-ready).
        obstruction: the requested end of a motion that was not found (JSON-ready).
        cloud: (N, 3) obstacle points to draw [m].
    """

    request: PlanRequest
    verdict: Verdict
    robot: RobotModel
    scene: Scene
    start: Float[np.ndarray, "n"]
    motion: Motion | None = None
    certificate: Certificate | None = None
    unsolved: tuple[str, ...] = ()
    task_phases: tuple[str, ...] = ()
    explanation: tuple[str, ...] = ()
    conflict: Conflict | None = None
    found_from: str = ""
    tried: tuple[TriedStart, ...] = ()
    notes: tuple[str, ...] = ()
    planning_time_s: float = 0.0
    timings: Mapping[str, float] = field(default_factory=dict)
    pose_graph: Mapping[str, Any] | None = None
    servo: Mapping[str, Any] | None = None
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

    def __repr__(self) -> str:
        if self.motion is None:
            reason = f": {self.explanation[0]}" if self.explanation else ""
            return f"<PlanResult {self.verdict.value}, no motion{reason}>"
        clearance = float("nan") if self.certificate is None else self.certificate.min_clearance_m
        shown = "" if np.isnan(clearance) else f", clearance {round_down(1e3 * clearance, 1)} mm"
        duration = "untimed" if self.motion.law is None else f"{self.times[-1]:.2f} s"
        return f"<PlanResult {self.verdict.value}, {len(self.positions)} samples, {duration}{shown}>"

    def _repr_html_(self) -> str:
        """Return verdict, checks and viewer page, as notebooks show an object."""
        from service.result.notebook import make_html  # it writes the page, which few results need

        return make_html(self)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Coordinates of the robot: a floating base as six (position, yaw, pitch, roll), then the joints."""
        return self.robot.joint_names

    @property
    def times(self) -> Float[np.ndarray, "S"]:
        """Times of the samples [s]; path parameters of an untimed motion, empty without a motion."""
        return np.zeros(0) if self.motion is None else sample_times(self.motion)

    @property
    def positions(self) -> Float[np.ndarray, "S n"]:
        """Coordinates at the samples, in the order of ``joint_names`` [rad, m]."""
        n = self.robot.n
        return np.zeros((0, n)) if self.motion is None else self.motion.curve(samples_of(self.motion))[:, :n]

    @property
    def waypoints(self) -> Float[np.ndarray, "K n"]:
        """Coordinates at the knots of the curve; empty without a motion [rad, m]."""
        n = self.robot.n
        return np.zeros((0, n)) if self.motion is None else self.motion.curve.positions[:, :n]

    @property
    def velocities(self) -> Float[np.ndarray, "S n"] | None:
        """Their velocities [rad/s, m/s]; None for an untimed motion or without one."""
        rates = None if self.motion is None else sample_rates(self.motion)
        return None if rates is None else rates[0][:, : self.robot.n]

    @property
    def accelerations(self) -> Float[np.ndarray, "S n"] | None:
        """Their accelerations, where they jump those after the sample [rad/s^2, m/s^2]; None as for velocities."""
        rates = None if self.motion is None else sample_rates(self.motion)
        return None if rates is None else rates[1][:, : self.robot.n]

    @property
    def phases(self) -> tuple[PhaseReport, ...]:
        """Status and checks of each phase in the order of execution, also of those that were not planned."""
        return report_phases(self.motion, self.certificate, self.unsolved, self.task_phases)
