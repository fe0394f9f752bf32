"""A look at many pairs on their stretches at once: relative poses, how far movers leave their chords, separations.

For every unit vector ``n`` from set A to set B, ``min_B n.y - max_A n.x`` is a lower bound of their signed distance
(penetration counts negative).  GJK/EPA finds the best ``n`` for a pose; evaluated on all vertices at both ends of the
stretch it bounds the distance of the swept hull, however well the direction was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.stopping import poll
from service.verify.chain import Chain
from service.verify.couples import Couples
from service.verify.forward import Placements
from service.verify.narrow import Narrow
from service.verify.rates import Intervals
from service.verify.settings import VerifySettings
from service.verify.solid import supports
from service.verify.stretches import Stretches
from service.verify.track import Track

# Far above the rounding errors of placements and distances at the scale of a room, far below anything that matters [m].
ROUNDING_M = 1e-9

FIRST, LAST, MIDDLE = 0, 1, 2


@dataclass(frozen=True)
class Look:
    """Pairs on stretches with the mover's poses in the holder's frame at the stretches' ends and middles.

    Attributes:
        couples: all pairs.
        stretches: what is looked at.
        allowed: (E,) greatest penetration allowed [m]; NaN where the pair may not touch.
        mover, holder: (E,) indices of their solids.
        s: (E, 3) path parameters of first, last and middle pose.
        rotation, translation: (E, 3, ...) the mover's joint in the frame of the holder's joint.
        holder_rotation, holder_translation: (E, 3, ...) the holder's joint in the world.
        bound: (E,) how far the mover may leave its chords [m].
    """

    couples: Couples
    stretches: Stretches
    allowed: Float[np.ndarray, "E"]
    mover: Int[np.ndarray, "E"]
    holder: Int[np.ndarray, "E"]
    s: Float[np.ndarray, "E 3"]
    rotation: Float[np.ndarray, "E 3 3 3"]
    translation: Float[np.ndarray, "E 3 3"]
    holder_rotation: Float[np.ndarray, "E 3 3 3"]
    holder_translation: Float[np.ndarray, "E 3 3"]
    bound: Float[np.ndarray, "E"]

    @staticmethod
    def at(track: Track, couples: Couples, stretches: Stretches, settings: VerifySettings) -> Look:
        """Poses and bounds of these stretches."""
        # Many pairs share a stretch.
        poll()
        ends, where = np.unique(stretches.first + 1j * stretches.last, return_inverse=True)
        first, last = ends.real, ends.imag
        s = np.stack([first, last, 0.5 * (first + last)], axis=1)
        placed, poses = track.at(s.ravel())
        pose, over = poses.reshape(s.shape)[where], track.over(first, last).take(where)
        mover, holder = couples.mover[stretches.couple], couples.holder[stretches.couple]
        held, moved = couples.joint[holder][:, None], couples.joint[mover][:, None]
        holder_rotation, holder_translation = placed.rotation[pose, held], placed.translation[pose, held]
        back = np.swapaxes(holder_rotation, -1, -2)
        offset = placed.translation[pose, moved] - holder_translation
        chains = couples.chains.take(couples.chain[stretches.couple])
        return Look(
            couples,
            stretches,
            couples.allowed[stretches.couple, stretches.phase],
            mover,
            holder,
            s[where],
            back @ placed.rotation[pose, moved],
            (back @ offset[..., None])[..., 0],
            holder_rotation,
            holder_translation,
            stretch_bounds(couples, mover, chains, over, placed, pose[:, MIDDLE], settings),
        )

    def key(self, row: int) -> tuple[int, int]:
        """Pair and phase of a row."""
        return int(self.stretches.couple[row]), int(self.stretches.phase[row])

    def separation(self, rows: Int[np.ndarray, "R"], direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
        """Lower bound of the signed distance between the hull of the mover's two end poses and the holder [m].

        ``direction`` are unit vectors from mover to holder in the holder's frame; those that are not finite give -inf.
        """
        poll()
        turned = direction[:, None, None, :] @ self.rotation[rows, :MIDDLE]
        mover, n = self.mover[rows], len(rows)
        which = np.concatenate([mover, mover, self.holder[rows]])
        reach = supports(
            self.couples.solids, which, np.concatenate([turned[:, FIRST, 0], turned[:, LAST, 0], -direction])
        ).reshape(3, n)
        shift = (self.translation[rows, :MIDDLE] @ direction[..., None])[..., 0].T
        separation = -reach[2] - (reach[:2] + shift).max(axis=0)
        return np.where(np.isnan(separation), -np.inf, separation)

    def closest(
        self, rows: Int[np.ndarray, "R"], columns: Int[np.ndarray, "R"], narrow: Narrow
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Signed distances [m] and directions from mover to holder of these rows at one of their poses each."""
        solids = self.couples.solids
        return narrow.closest(
            [solids[k].convex for k in self.mover[rows].tolist()],
            self.rotation[rows, columns],
            self.translation[rows, columns],
            [solids[k].convex for k in self.holder[rows].tolist()],
        )

    def touching(self, row: int, column: int, narrow: Narrow) -> Float[np.ndarray, "3"]:
        """The holder's point nearest to the mover at a stretch's end or middle, in the world [m]."""
        mover, holder = self.couples.solids[self.mover[row]], self.couples.solids[self.holder[row]]
        point = narrow.nearest_point(
            mover.convex, self.rotation[row, column], self.translation[row, column], holder.convex
        )
        return np.asarray(self.holder_rotation[row, column] @ point + self.holder_translation[row, column])


def stretch_bounds(
    couples: Couples,
    mover: Int[np.ndarray, "E"],
    chains: Chain,
    over: Intervals,
    placed: Placements,
    middle: Int[np.ndarray, "E"],
    settings: VerifySettings,
) -> Float[np.ndarray, "E"]:
    """How far a mover may leave its chords, the exported samples' line and rounding included, per stretch [m].

    ``chains`` and ``over`` have a row for each, ``middle`` are the rows of ``placed`` that hold the stretches' middles.
    """
    poll()
    joint = couples.joint[mover]
    world = (placed.rotation[middle, joint] @ couples.centre[mover][..., None])[..., 0]
    world += placed.translation[middle, joint]
    gap = placed.translation[middle[:, None], chains.joints] - world[:, None]
    distance = np.sqrt(np.einsum("emk,emk->em", gap, gap)) + couples.radius[mover][:, None]
    deviation = chains.deviation(over, chains.local_reach(distance, over))
    return np.asarray(deviation + chains.sampling_slack(over, settings.rounding) + ROUNDING_M)
