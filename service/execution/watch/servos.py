"""Comparison of every joint with what its servo's law and the plan's load let it do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from costs.robot.servo import DAMPING_S, default_stiffness
from service.errors import ExecutionError
from service.execution.driver import JointCommand, RobotReading
from service.execution.guards import Finding, Severity
from service.execution.reference import PlannedReference, ReferencePhase
from service.execution.sensing.filters import find_share, low_pass


@dataclass(frozen=True)
class ServoModel:
    """Law of the servos, ``Kp (q_d - q) + Kd (qd_d - qd) + Kf tau_d`` (Liu et al. 2015, eq. 8), and its tolerances.

    Attributes:
        stiffness: ``Kp`` by joint [N m/rad, N/m]; empty for the defaults of the robot.
        damping_s: ``Kd`` per ``Kp`` [s].
        feed_forward: ``Kf``.
        delay_s: longest time from a command to its servo, and from a sensor to its reading [s].
        encoder_rad: error of an encoder, which its servo takes for a torque [rad, m].
        law_share: of a joint's effort, and
        made_share: of the torque that the law gives, by which the measured torque may be off it.
        free_share: of the effort, by which the load of a joint may be off the plan's where nothing is held or stood on.
        loaded_share: the same of joints between links that are planted or hold something.
        angle_share: of the effort, that the servo may make beyond the plan's where torques are not measured.
        cutoff_hz: of the low-pass filter of all three.
        hold_s: time for which a limit must be exceeded [s].
    """

    stiffness: Mapping[str, float] = field(default_factory=dict)
    damping_s: float = DAMPING_S
    feed_forward: float = 1.0
    delay_s: float = 0.006
    encoder_rad: float = 2e-4
    law_share: float = 0.05
    made_share: float = 0.25
    free_share: float = 0.3
    loaded_share: float = 0.5
    angle_share: float = 0.75
    cutoff_hz: float = 5.0
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        shares = (self.law_share, self.made_share, self.free_share, self.loaded_share, self.angle_share, self.cutoff_hz)
        if not min(shares) > 0.0 or min(self.damping_s, self.delay_s, self.hold_s, *self.stiffness.values(), 0.0) < 0.0:
            raise ExecutionError("servos: expected positive shares and stiffness, and times of 0 or more")
        if not 0.0 <= self.feed_forward <= 1.0:
            raise ExecutionError(f"servos: feed_forward {self.feed_forward:g}; expected 0 to 1")


@dataclass(frozen=True)
class ServoState:
    """Filtered residuals [N m, N] in the order of the joints, and the time for which each is exceeded [s].

    Attributes:
        law: measured torque less that of the servo's law; None without measured torques.
        load: measured torque less that of the plan, or of the servo's law less that of the plan.
        law_s, load_s: (k,) times.
    """

    law: Float[np.ndarray, "k"] | None
    load: Float[np.ndarray, "k"]
    law_s: Float[np.ndarray, "k"]
    load_s: Float[np.ndarray, "k"]


class ServoWatch:
    """Limits of a plan's joints, from their servos' law and from what each phase holds on to."""

    def __init__(
        self, reference: PlannedReference, joint_names: Sequence[str], period_s: float, model: ServoModel | None = None
    ) -> None:
        """Prepare the limits of all phases, in the order of a driver's joints."""
        self.model, self.joint_names, self.period_s = model or ServoModel(), tuple(joint_names), period_s
        robot, law = reference.robot, self.model
        table = {**default_stiffness(robot), **law.stiffness}
        self._columns = np.array([robot.joint_names.index(name) for name in joint_names], dtype=int)
        self.stiffness = np.array([table[name] for name in joint_names])
        self.effort = robot.effort[self._columns]
        self._share = find_share(law.cutoff_hz, period_s)
        phases = reference.phases
        self._loaded = [self._find_loaded(reference, phases[max(k - 1, 0) : k + 2]) for k in range(len(phases))]
        self._unit = np.array(["m" if _is_prismatic(robot.model, name) else "rad" for name in joint_names])

    def limit_load(self, phase: int) -> Float[np.ndarray, "k"]:
        """Return by how much the load of each joint may be off the plan's [N m, N]."""
        law = self.model
        return np.asarray(np.where(self._loaded[phase], law.loaded_share, law.free_share) * self.effort)

    def describe(self) -> dict[str, dict[str, float]]:
        """Return the limits by joint: of law and load [N m, N], least over the phases, and of the angle [rad, m]."""
        least = np.min([self.limit_load(k) for k in range(len(self._loaded))], axis=0)
        rows = zip(self.joint_names, self.model.law_share * self.effort, least, self._limit_angle(), strict=True)
        return {
            name: {"law_n": float(law), "load_n": float(load), "angle": float(angle)} for name, law, load, angle in rows
        }

    def start(self, reading: RobotReading) -> ServoState:
        """Return the state before the first command."""
        zero = np.zeros(len(self.joint_names))
        return ServoState(zero if np.size(reading.torque) else None, zero, zero, zero)

    def step(
        self, state: ServoState, reading: RobotReading, sent: JointCommand, planned: Float[np.ndarray, "k"], phase: int
    ) -> tuple[tuple[Finding, ...], ServoState]:
        """Return the joints that do not do what their servos should, and the state one cycle later.

        Args:
            state: the earlier one.
            reading: after the command.
            sent: the command.
            planned: (k,) torques of the plan in the order of the joints [N m, N].
            phase: number of the phase.
        """
        law, effort = self.model, self.effort
        angle = self.stiffness * (sent.q - reading.q)
        made = angle + law.damping_s * self.stiffness * (sent.qd - reading.qd) + law.feed_forward * sent.tau
        made = np.clip(made, -effort, effort)
        # Of a joint that follows late, and of one whose encoder is noisy.
        late = self.stiffness * (np.abs(sent.qd) * (self.period_s + law.delay_s) + law.encoder_rad)
        has_torque = state.law is not None
        torque = reading.torque if has_torque else made
        off_law = low_pass(state.law, torque - made, self._share) if has_torque else None
        off_load = low_pass(state.load, torque - planned, self._share)
        most_law = law.law_share * effort + law.made_share * np.abs(made) + late
        most_load = (self.limit_load(phase) if has_torque else law.angle_share * effort) + late
        law_s = np.zeros_like(effort) if off_law is None else self._count(state.law_s, np.abs(off_law) > most_law)
        load_s = self._count(state.load_s, np.abs(off_load) > most_load)
        findings = []
        if off_law is not None:
            for k in np.flatnonzero(law_s > law.hold_s).tolist():
                words = (
                    f"{self.joint_names[k]} makes {torque[k]:.0f} {self._name(k)}, and its servo should make "
                    f"{made[k]:.0f}: it is weak, or its encoder slipped"
                )
                findings.append(self._report(k, float(abs(off_law[k])), float(most_law[k]), words, "weak servo"))
        for k in np.flatnonzero(load_s > law.hold_s).tolist():
            if abs(torque[k]) < abs(planned[k]):
                carried = f"{torque[k]:.0f} {self._name(k)} of {planned[k]:.0f}"
                words = f"{self.joint_names[k]} carries {carried}: its load is gone"
                findings.append(self._report(k, float(abs(off_load[k])), float(most_load[k]), words, "load lost"))
                continue
            words = (
                f"{self.joint_names[k]} is {1e3 * (sent.q - reading.q)[k]:.0f} m{self._unit[k]} off its command with "
                f"{torque[k]:.0f} {self._name(k)}, and the plan expects {planned[k]:.0f}: it is stuck, or held"
            )
            findings.append(self._report(k, float(abs(off_load[k])), float(most_load[k]), words, "blocked joint"))
        return tuple(findings), replace(state, law=off_law, load=off_load, law_s=law_s, load_s=load_s)

    def _limit_angle(self) -> Float[np.ndarray, "k"]:
        """Return how far a joint at rest may be off its command beyond the plan's sag [rad, m]."""
        return np.asarray(self.model.angle_share * self.effort / self.stiffness)

    def _name(self, k: int) -> str:
        return "N" if self._unit[k] == "m" else "N m"

    def _report(self, k: int, value: float, limit: float, words: str, kind: str) -> Finding:
        words = f"{words}; {value:.0f} {self._name(k)} off, at most {limit:.0f}"
        return Finding(Severity.HOLD, self.joint_names[k], value, limit, words, name=kind)

    def _count(self, before: Float[np.ndarray, "k"], exceeds: Bool[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        return np.where(exceeds, before + self.period_s, 0.0)

    def _find_loaded(self, reference: PlannedReference, phases: Sequence[ReferencePhase]) -> Bool[np.ndarray, "k"]:
        """Return the joints between the base and links that are planted in or beside a phase, or tools with a load."""
        model = reference.robot.model
        links = {part.link for phase in phases for part in phase.contacts}
        links |= {load.tool for phase in phases for load in phase.loads}
        joints = {int(joint) for link in links for joint in model.supports[_find_joint(model, link)]}
        loaded = {int(model.joints[joint].idx_v) for joint in joints if joint > 0}
        return np.array([int(column) in loaded for column in self._columns], dtype=bool)


def _find_joint(model: pin.Model, link: str) -> int:
    return int(model.frames[model.getFrameId(link)].parentJoint)


def _is_prismatic(model: pin.Model, name: str) -> bool:
    return bool(model.joints[model.getJointId(name)].shortname().removeprefix("JointModel").startswith("P"))
