"""Displacements that answer to a force or an error: they move while it lasts, to a limit, and come back after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from service.execution.shift import limit_length

NOTHING = 1e-6  # of a displacement that fades, below which it is none [rad, m]


@dataclass(frozen=True)
class OffsetFilter:
    """Limit of a displacement, and how fast it comes back.

    Attributes:
        most_m: largest size of a displacement in space [m].
        fade_s: time constant of the way back [s].
    """

    most_m: float
    fade_s: float

    def move(
        self, offset: Float[np.ndarray, "3"], speed: Float[np.ndarray, "3"], period_s: float
    ) -> Float[np.ndarray, "3"]:
        """Return a displacement one period later, which moves with a speed [m/s] and stays within the limit."""
        return limit_length(offset + period_s * speed, self.most_m)

    def fade(self, offset: Float[np.ndarray, "k"], period_s: float) -> Float[np.ndarray, "k"]:
        """Return a displacement one period later on its way back; zero where next to nothing is left."""
        left = max(1.0 - period_s / self.fade_s, 0.0)
        return np.where(np.abs(offset) < NOTHING, 0.0, left * offset)
