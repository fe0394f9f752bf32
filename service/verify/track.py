"""The motion as the proofs see it: placements along the curve, bounds of its derivatives, chains of its joints."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from service.verify.chain import JointTree
from service.verify.forward import Forward, Placements
from service.verify.motion import Motion
from service.verify.rates import Intervals, Rates, position_range


class Track:
    """What every proof about a motion starts from, prepared once.

    Attributes:
        motion: the motion.
        range: smallest and largest value of every coordinate on every knot interval, (K-1, n) each.
        tree: its joints, with the range that its sliding joints use.
    """

    def __init__(self, motion: Motion) -> None:
        """Prepare.

        Raises:
            VerifyError: for joints that cannot be verified, or samples that leave out a knot.
        """
        self.motion = motion
        self.range = low, high = position_range(motion.curve)
        travel = np.maximum(np.abs(low).max(axis=0), np.abs(high).max(axis=0))
        self.tree = JointTree(motion.robot.model, travel, 6 if motion.robot.is_floating else 0)
        self._forward = Forward(motion.robot.model)
        self._rates = Rates(motion.curve, motion.samples)
        self._rows: dict[float, int] = {}
        self._placed = self._forward.at(motion.curve(motion.curve.knots[:0]))

    def at(self, s: Float[np.ndarray, "S"]) -> tuple[Placements, Int[np.ndarray, "S"]]:
        """Joint placements, and which of their rows belong to these path parameters.

        Ends of stretches are middles of longer ones, and many proofs stop at the same places: each is computed once.
        """
        wanted = s.tolist()
        new = [place for place in dict.fromkeys(wanted) if place not in self._rows]
        if new:
            self._append(new)
        return self._placed, np.array([self._rows[place] for place in wanted], dtype=int)

    def _append(self, new: list[float]) -> None:
        """Compute placements behind those that are there, with room for as many again when there is none left."""
        placed, first = self._forward.at(self.motion.curve(np.array(new))), len(self._rows)
        last = first + len(new)
        if last > len(self._placed.translation):
            room = [np.empty((2 * last, *part.shape[1:])) for part in (placed.rotation, placed.translation)]
            room[0][:first], room[1][:first] = self._placed.rotation[:first], self._placed.translation[:first]
            self._placed = Placements(room[0], room[1])
        self._placed.rotation[first:last], self._placed.translation[first:last] = placed.rotation, placed.translation
        self._rows.update(zip(new, range(first, last), strict=True))

    def over(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Intervals:
        """Derivative bounds on stretches, none of which may cross a knot."""
        return self._rates.over(first, last)
