"""A base on two wheels: from waypoint to waypoint it turns on the spot or drives along its heading."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from costs.robot.model import PLANAR_NAMES
from costs.state import MotionState
from scopt import AffineRows, Residual

# Shares of a path at which the base changes between turning (first) and driving.
CHANGES = (0.16, 0.42, 0.58, 0.84)
FEWEST_INTERVALS = len(CHANGES) + 1


def find_drives(n_intervals: int) -> Bool[np.ndarray, "I"]:
    """Return which intervals of a path drive; the base turns on the spot in the others, before, between and after."""
    at = (np.arange(n_intervals) + 0.5) / n_intervals
    return np.asarray(np.searchsorted(CHANGES, at) % 2 == 1)


class RollingBase(Residual[MotionState]):
    """Errors of a planar base that cannot slide, two rows per interval.

    Where it turns: the displacement along x and y [m].  Where it drives: the turn [rad], and the displacement across
    the heading at the interval's beginning [m].
    """

    def __init__(self, n_waypoints: int) -> None:
        """
        Args:
            n_waypoints: of the path; the first coordinates are those of the base.
        """
        self._drives = find_drives(n_waypoints - 1)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        base = self._read(state)
        step = np.diff(base, axis=0)
        across = -np.sin(base[:-1, 2]) * step[:, 0] + np.cos(base[:-1, 2]) * step[:, 1]
        driving, turning = np.stack([step[:, 2], across], axis=1), step[:, :2]
        return np.asarray(np.where(self._drives[:, None], driving, turning).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        base = self._read(state)
        step, n_intervals = np.diff(base, axis=0), len(base) - 1
        n = state.kinematics.q.shape[1]
        blocks = np.zeros((n_intervals, 2, 2, n))  # interval, row, end, coordinate
        sine, cosine = np.sin(base[:-1, 2]), np.cos(base[:-1, 2])
        for end, sign in ((0, -1.0), (1, 1.0)):
            blocks[:, 0, end, 0] = blocks[:, 1, end, 1] = np.where(self._drives, 0.0, sign)
            blocks[:, 0, end, 2] = np.where(self._drives, sign, 0.0)
            blocks[self._drives, 1, end, 0] = -sign * sine[self._drives]
            blocks[self._drives, 1, end, 1] = sign * cosine[self._drives]
        turned = -cosine * step[:, 0] - sine * step[:, 1]
        blocks[:, 1, 0, 2] += np.where(self._drives, turned, 0.0)
        first = np.repeat(np.arange(n_intervals), 2)
        return AffineRows.from_blocks(self.value(state), first, blocks.reshape(-1, 2, n), state.kinematics.n_waypoints)

    def _read(self, state: MotionState) -> Float[np.ndarray, "T 3"]:
        return np.asarray(state.kinematics.q[:, : len(PLANAR_NAMES)])
