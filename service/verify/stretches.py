"""Pairs on stretches of the curve: what the search for the smallest clearance still has to decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Stretches:
    """Pairs on stretches, with what is known of them from before.

    Attributes:
        couple: (E,) pair.
        first, last: (E,) path parameters.
        phase: (E,) index of the phase.
        floor: (E,) a lower bound of the pair's clearance [m] (-inf: none).
        halved: (E,) how often a stretch of the broad phase was halved to this one.
        hint: (E, 3) a unit direction from mover to holder worth trying, in the holder's frame; NaN: none.
        ends: (E, 2) sampled distance at both ends [m] (inf: not sampled).
    """

    couple: Int[np.ndarray, "E"]
    first: Float[np.ndarray, "E"]
    last: Float[np.ndarray, "E"]
    phase: Int[np.ndarray, "E"]
    floor: Float[np.ndarray, "E"]
    halved: Int[np.ndarray, "E"]
    hint: Float[np.ndarray, "E 3"]
    ends: Float[np.ndarray, "E 2"]

    @staticmethod
    def unknown(
        couple: Int[np.ndarray, "E"],
        first: Float[np.ndarray, "E"],
        last: Float[np.ndarray, "E"],
        phase: Int[np.ndarray, "E"],
        floor: Float[np.ndarray, "E"],
    ) -> Stretches:
        """Stretches that nobody has looked at yet."""
        n = len(couple)
        hint, ends = np.full((n, 3), np.nan), np.full((n, 2), np.inf)
        return Stretches(couple, first, last, phase, floor, np.zeros(n, dtype=int), hint, ends)

    def __len__(self) -> int:
        return len(self.couple)

    def take(self, rows: np.ndarray | slice) -> Stretches:
        """These rows only."""
        return Stretches(*(column[rows] for column in self._columns))

    @staticmethod
    def join(parts: Sequence[Stretches]) -> Stretches:
        """All parts one after another; at least one."""
        if len(parts) == 1:
            return parts[0]
        return Stretches(*(np.concatenate(column) for column in zip(*(part._columns for part in parts), strict=True)))

    def halves(self, hint: Float[np.ndarray, "E 3"], middle: Float[np.ndarray, "E"]) -> Stretches:
        """Both halves of every stretch.

        Args:
            hint: (E, 3) the direction that did best.
            middle: (E,) sampled distance at the stretches' middles [m] (inf: not sampled).
        """
        half = 0.5 * (self.first + self.last)
        ends = np.empty((2, len(self), 2))
        ends[0, :, 0], ends[1, :, 1] = self.ends.T
        ends[0, :, 1] = ends[1, :, 0] = middle
        return Stretches(
            np.concatenate([self.couple, self.couple]),
            np.concatenate([self.first, half]),
            np.concatenate([half, self.last]),
            np.concatenate([self.phase, self.phase]),
            np.full(2 * len(self), -np.inf),
            np.concatenate([self.halved, self.halved]) + 1,
            np.concatenate([hint, hint]),
            ends.reshape(-1, 2),
        )

    @property
    def _columns(self) -> tuple[np.ndarray, ...]:
        return self.couple, self.first, self.last, self.phase, self.floor, self.halved, self.hint, self.ends
