"""Whether a seat's back stands behind a cushion: what points and rays tell of its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import poll
from perception.detect.shared.confidence import rising
from perception.detect.vehicle.level import is_inside

_BACK = (0.08, 0.6)
_OPEN_CELL = 0.06
# Shares of its place that make known what is there.
_KNOWN = (0.05, 0.2)


@dataclass(frozen=True)
class Back:
    """What was seen of the place of a seat's back.

    Attributes:
        solid: share of what was seen that is solid.
        n_solid: how many cells of it are.
        seen: share of it that was seen.
        reach_up: how high over the cushion what is there goes on [m].
    """

    solid: float
    n_solid: int
    seen: float
    reach_up: float

    def evidence(self, unseen: float) -> float:
        """How much it speaks for a back, ``unseen`` where nobody saw it."""
        known = rising(self.seen, *_KNOWN)
        sure = rising(self.solid, 0.3, 0.6) * rising(self.n_solid, 3.0, 10.0) * rising(self.reach_up, 0.35, 0.5)
        return known * sure * (1.0 - 0.8 * rising(self.reach_up, 1.15, 1.4)) + (1.0 - known) * unseen


def back_of(
    width: float,
    depth: float,
    local: Float[np.ndarray, "N 3"],
    starts: Float[np.ndarray, "R 3"],
    ends: Float[np.ndarray, "R 3"],
) -> Back:
    """What was seen of the place behind a cushion of some width and depth [m].

    Args:
        width, depth: of the cushion [m].
        local: (N, 3) points in the seat's frame [m].
        starts, ends: (R, 3) of all rays, in the seat's frame [m].
    """
    poll()
    n_across = max(round((width - 0.04) / _OPEN_CELL), 1)
    n_up = round((_BACK[1] - _BACK[0]) / _OPEN_CELL)
    low = np.array([-0.5 * depth - 0.3, -0.5 * n_across * _OPEN_CELL, _BACK[0]])
    high = np.array([-0.5 * depth + 0.12, 0.5 * n_across * _OPEN_CELL, _BACK[0] + n_up * _OPEN_CELL])
    solid = np.zeros((n_across, n_up), dtype=bool)
    mine = local[is_inside(local, low, high)]
    cell = np.floor((mine[:, 1:] - low[1:]) / _OPEN_CELL).astype(int)
    solid[cell[:, 0], cell[:, 1]] = True
    # Rays that cross the middle of the back's place from one side of it to the other.
    at = -0.5 * depth - 0.1
    through = (starts[:, 0] - low[0]) * (ends[:, 0] - low[0]) < 0.0
    through &= np.maximum(starts[:, 0], ends[:, 0]) > high[0]
    share = (at - starts[through, 0]) / (ends[through, 0] - starts[through, 0])
    crossing = starts[through, 1:] + share[:, None] * (ends[through, 1:] - starts[through, 1:])
    cell = np.floor((crossing - low[1:]) / _OPEN_CELL).astype(int)
    cell = cell[((cell >= 0) & (cell < solid.shape)).all(axis=1)]
    opened = np.zeros_like(solid)
    opened[cell[:, 0], cell[:, 1]] = True
    seen = solid | opened
    return Back(
        float(solid.sum() / max(seen.sum(), 1)), int(solid.sum()), float(seen.mean()), _reach_up(local, low, high)
    )


def _reach_up(local: Float[np.ndarray, "N 3"], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> float:
    """How high what is behind the cushion goes on without a gap: a wall goes on far above where seats end [m]."""
    tall = local[is_inside(local, np.array([low[0], low[1], 0.3]), np.array([high[0], high[1], 1.6])), 2]
    steps = np.bincount(np.floor((tall - 0.3) / 0.1).astype(int), minlength=14) >= 5
    return 0.3 + 0.1 * float(np.argmin(np.concatenate([steps, [False]])))
