"""All that watches over one execution: what it finds in every cycle, and what it cannot see."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError
from service.execution.driver import RobotReading
from service.execution.guards import Finding, Guards, GuardSettings, Severity
from service.execution.reference import PlannedReference, ReferencePhase, ReferenceState
from service.execution.sensing.forces import MeasuredForces
from service.execution.watch.assumptions import Assumption, list_assumptions
from service.execution.watch.driver_link import DriverLink
from service.execution.watch.pelvis import PelvisSettings, PelvisWatch
from service.execution.watch.readings import ReadingCheck, ReadingSettings, ReadingState
from service.execution.watch.servos import ServoModel, ServoWatch
from service.execution.watch.weight import WeightWatch


@dataclass(frozen=True)
class WatchSettings:
    """Limits of what sensors and servos do.

    Attributes:
        readings: of every reading.
        servos: law and tolerances of the joints' servos.
        pelvis: of the pelvis against feet and commands.
        silent_s: time without an answer of the driver after which nothing is commanded any more [s].
    """

    readings: ReadingSettings = field(default_factory=ReadingSettings)
    servos: ServoModel = field(default_factory=ServoModel)
    pelvis: PelvisSettings = field(default_factory=PelvisSettings)
    silent_s: float = 0.25

    def __post_init__(self) -> None:
        if not self.silent_s > 0.0:
            raise ExecutionError(f"watch: silent_s {self.silent_s:g}; expected a positive time")


class Watch:
    """Checks of one plan on one robot."""

    def __init__(
        self,
        reference: PlannedReference,
        joint_names: tuple[str, ...],
        period_s: float,
        guards: GuardSettings,
        settings: WatchSettings,
        first: RobotReading | ReadingState,
    ) -> None:
        """Prepare all checks.

        Args:
            reference: the plan.
            joint_names: of the driver.
            period_s: of the cycle [s].
            guards: limits of forces.
            settings: limits of sensors and servos.
            first: reading of a robot at rest, or the state of its sensors in the plan before.

        Raises:
            ExecutionError: one line: a sensor that every robot needs says nothing usable.
        """
        self.settings, self.period_s, self._force_limits = settings, period_s, guards
        self._reference = reference
        self._check = ReadingCheck(reference.robot, joint_names, period_s, settings.readings)
        self.readings = self._check.start(first) if isinstance(first, RobotReading) else first
        self._guards = Guards(guards)
        self._servos = ServoWatch(reference, joint_names, period_s, settings.servos)
        self._servo_state = self._servos.start(self.readings.good)
        self._pelvis = PelvisWatch(reference.robot, period_s, settings.pelvis)
        self._pelvis_state = self._pelvis.start()
        self._weight = WeightWatch.of(reference.robot)
        self._findings: tuple[Finding, ...] = ()
        self._has_false_forces = False

    @property
    def is_blind(self) -> bool:
        """Whether a sensor has failed for longer than a dropout, so that nothing may answer to sensors."""
        return self._has_false_forces or any(
            time > self.settings.readings.hold_s for time in self.readings.bad_s.values()
        )

    def read(self, link: DriverLink) -> RobotReading:
        """Return a usable reading of the driver, whatever it says."""
        raw = link.read()
        reading, self._findings, self.readings = self._check.step(self.readings, raw, link.sent)
        if link.problem:
            self._findings = (self._report_driver(link), *self._findings)
        return reading

    def judge(
        self,
        link: DriverLink,
        reading: RobotReading,
        wanted: ReferenceState,
        phases: tuple[int, ReferencePhase, ReferencePhase | None],
        forces: MeasuredForces,
        planned: Float[np.ndarray, "k"],
        place: tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]] | None,
    ) -> tuple[Finding, ...]:
        """Return everything that is wrong in this cycle.

        Args:
            link: with the last command.
            reading: usable.
            wanted: by the plan.
            phases: number of the present phase, the phase and the next one.
            forces: measured.
            planned: (k,) torques of the plan in the order of the driver's joints [N m, N].
            place: (n,) configurations that sensors show and that was commanded; None without estimate of the pelvis.
        """
        number, phase, following = phases
        found, self._guards = self._guards.check(
            phase, following, forces.contacts, forces.sizes, wanted.contact_wrenches, self.period_s
        )
        findings = [*self._findings, *found]
        if place is not None and not self.readings.failed:
            heavy, self._weight = self._weight.step(
                phase.contacts, forces.contacts, wanted.contact_wrenches, self.period_s
            )
            self._has_false_forces |= bool(heavy)
            findings += heavy
        if self.readings.failed:  # a servo cannot be told from its encoder then
            return tuple(findings)
        off, self._servo_state = self._servos.step(self._servo_state, reading, link.sent, planned, number)
        findings += off
        if place is not None:
            lean, self._pelvis_state = self._pelvis.step(
                self._pelvis_state, place[0], place[1], reading.imu_rotation, phase.contacts, forces.contacts
            )
            findings += lean
        return tuple(findings)

    def list_unwatched(self) -> tuple[str, ...]:
        """Return what the robot's sensors leave unwatched, a sentence each."""
        return self._check.list_unwatched(self.readings)

    def list_assumptions(self) -> tuple[Assumption, ...]:
        """Return what the certificate assumes, and what watches it."""
        return list_assumptions(self._reference, self.readings.good)

    def describe(self) -> dict[str, Any]:
        """Return the limits of all guards as JSON data."""
        return {
            "forces": dict(vars(self._force_limits)),
            "readings": dict(vars(self.settings.readings)),
            "pelvis": dict(vars(self.settings.pelvis)),
            "joints": self._servos.describe(),
        }

    def _report_driver(self, link: DriverLink) -> Finding:
        limit = self.settings.readings.hold_s
        severity = Severity.HOLD if link.silent_s > limit else Severity.NOTE
        return Finding(severity, "driver", link.silent_s, limit, link.problem, name="driver")
