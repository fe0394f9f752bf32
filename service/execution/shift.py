"""Displacements of targets while a plan runs: approached with bounded speed and acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from service.errors import ExecutionError

LARGEST_SHIFT_M = 0.3  # a plan's clearances and balance say nothing about farther targets


@dataclass(frozen=True)
class ShiftLimits:
    """How fast a target may be displaced.

    Attributes:
        speed: largest [m/s].
        acceleration: largest [m/s^2].
    """

    speed: float = 0.1
    acceleration: float = 0.5


@dataclass(frozen=True)
class Shift:
    """Displacement of a link's target from the plan, in world axes.

    Attributes:
        offset: (3,) now [m].
        speed: (3,) now [m/s].
        goal: (3,) where it goes [m].
    """

    offset: Float[np.ndarray, "3"]
    speed: Float[np.ndarray, "3"]
    goal: Float[np.ndarray, "3"]

    @staticmethod
    def zero() -> Shift:
        """Return no displacement."""
        return Shift(np.zeros(3), np.zeros(3), np.zeros(3))

    @property
    def is_at_goal(self) -> bool:
        """Whether the displacement is complete, to 0.1 mm."""
        return bool(np.linalg.norm(self.goal - self.offset) <= 1e-4)

    def stop(self) -> Shift:
        """Return the displacement at rest where it is."""
        return Shift(self.offset, np.zeros(3), self.offset)

    def towards(self, goal: Float[np.ndarray, "3"]) -> Shift:
        """Return the same displacement on its way to another goal.

        Raises:
            ExecutionError: the goal is no finite displacement of at most ``LARGEST_SHIFT_M``.
        """
        goal = np.asarray(goal, dtype=float)
        if goal.shape != (3,) or not np.all(np.isfinite(goal)):
            raise ExecutionError(f"shift {goal.tolist()}; expected three finite numbers [m]")
        if np.linalg.norm(goal) > LARGEST_SHIFT_M:
            raise ExecutionError(
                f"shift {goal.tolist()} is {np.linalg.norm(goal):.3g} m long; expected at most {LARGEST_SHIFT_M:g} m, "
                "plan again for farther targets"
            )
        return Shift(self.offset, self.speed, goal)


def limit_length(vector: Float[np.ndarray, "3"], most: float) -> Float[np.ndarray, "3"]:
    """Return a vector, shortened to a largest length if it is longer."""
    size = float(np.linalg.norm(vector))
    return vector if size <= most else vector * (most / size)


def step_shift(shift: Shift, limits: ShiftLimits, period_s: float) -> Shift:
    """Return a displacement one period later.

    The wanted speed falls with the root of the distance that is left, so that half of the acceleration stops it at the
    goal, and near the goal in proportion to the distance.
    """
    left = shift.goal - shift.offset
    distance = float(np.linalg.norm(left))
    rate = limits.acceleration / limits.speed
    wanted = np.zeros(3)
    if distance > 0.0:
        size = min(limits.speed, np.sqrt(limits.acceleration * distance), rate * distance)
        wanted = size / distance * left
    speed = shift.speed + limit_length(wanted - shift.speed, limits.acceleration * period_s)
    return Shift(shift.offset + period_s * speed, speed, shift.goal)
