"""Comparison of the forces at all contacts with the robot's weight: sensors that contradict it are not believed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.execution.guards import Finding, Severity
from service.verify import PlantedContact

GRAVITY = 9.81


@dataclass(frozen=True)
class WeightWatch:
    """Time for which the measured forces have not been what carries the robot.

    A foot that loses the ground leaves its load to the others; a sensor that dies takes it away.

    Attributes:
        weight_n: of the robot [N].
        share: of the weight, by which the sum of upright forces may be off the plan's.
        hold_s: for how long it must be [s].
        exceeded_s: for how long it has been [s].
    """

    weight_n: float
    share: float = 0.35
    hold_s: float = 0.06
    exceeded_s: float = 0.0

    @staticmethod
    def of(robot: RobotModel) -> WeightWatch:
        """Return the watch of a robot."""
        return WeightWatch(GRAVITY * sum(float(inertia.mass) for inertia in robot.model.inertias[1:]))

    def step(
        self,
        planted: tuple[PlantedContact, ...],
        forces: Mapping[str, Float[np.ndarray, "3"]],
        expected: Mapping[str, Float[np.ndarray, "6"]],
        period_s: float,
    ) -> tuple[tuple[Finding, ...], WeightWatch]:
        """Return whether the forces contradict the weight, and the watch one cycle later.

        Args:
            planted: contacts of the phase; one without a sensor may carry anything.
            forces: measured by link, world axes [N].
            expected: wrench of the plan by link [N, N m].
            period_s: of the cycle [s].
        """
        links = [contact.link for contact in planted]
        if not links or any(link not in forces or link not in expected for link in links):
            return (), WeightWatch(self.weight_n, self.share, self.hold_s)
        # Links that come or go are measured, too.
        off = {link: float(force[2] - expected.get(link, np.zeros(6))[2]) for link, force in forces.items()}
        total, most = sum(off.values()), self.share * self.weight_n
        exceeded = self.exceeded_s + period_s if abs(total) > most else 0.0
        watch = WeightWatch(self.weight_n, self.share, self.hold_s, exceeded)
        if exceeded <= self.hold_s:
            return (), watch
        worst = max(off, key=lambda link: off[link] * np.sign(total))
        words = (
            f"the forces at all contacts are {total:+.0f} N off what carries the robot, at most {most:.0f} N; that of "
            f"{worst} is off by {off[worst]:+.0f} N"
        )
        return (Finding(Severity.HOLD, f"force of {worst}", abs(total), most, words, name="force"),), watch
