"""Relative poses of many pairs on their intervals, bounds of movers from their chords, separations, and samples.

For every unit vector ``n`` from set A to set B, ``min_B n.y - max_A n.x`` is a lower bound of their signed distance
(penetration counts negative).  GJK/EPA finds the best ``n`` for a pose; evaluated on all vertices at both ends of the
interval it bounds the distance of the swept hull, however well the direction was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.native import find_library
from costs.stopping import poll
from service.verify.clearance import compiled
from service.verify.clearance.pairs import PairIntervals, PairTable
from service.verify.curves.bounds import RateBounds
from service.verify.joint_chain import JointChain
from service.verify.motion import VerifySettings
from service.verify.prepared_motion import Placements, PreparedMotion
from service.verify.solids import DistanceQuery, supports

# Far above the rounding errors of placements and distances within 100 m, far below any tolerance [m].
ROUNDING_M = 1e-9

FIRST, LAST, MIDDLE = 0, 1, 2
_MEASURED = 512  # distances between two polls: a millisecond, ten of hulls of thousands of vertices


@dataclass(frozen=True)
class PairPoses:
    """Poses of the movers in their holders' frames at the ends and middles of intervals.

    Attributes:
        table: all pairs.
        allowed: (E,) greatest penetration allowed [m]; NaN where the pair may not touch.
        need: (E,) least signed distance [m]: minus the depth where the pair may touch, else the demanded clearance.
        mover, holder: (E,) indices of their solids.
        s: (E, 3) path parameters of first, last and middle pose.
        placed, pose: joint placements in the world, and (E, 3) which of their rows belong to ``s``.
        rotation, translation: (E, 3, ...) the mover's joint in the frame of the holder's joint.
        bound: (E,) how far the mover may leave its chords [m].
    """

    table: PairTable
    intervals: PairIntervals
    allowed: Float[np.ndarray, "E"]
    need: Float[np.ndarray, "E"]
    mover: Int[np.ndarray, "E"]
    holder: Int[np.ndarray, "E"]
    s: Float[np.ndarray, "E 3"]
    placed: Placements
    pose: Int[np.ndarray, "E 3"]
    rotation: Float[np.ndarray, "E 3 3 3"]
    translation: Float[np.ndarray, "E 3 3"]
    bound: Float[np.ndarray, "E"]

    @staticmethod
    def at(prepared: PreparedMotion, table: PairTable, intervals: PairIntervals, settings: VerifySettings) -> PairPoses:
        """Return the poses and bounds of these intervals."""
        # Many pairs share an interval.
        poll()
        ends, where = np.unique(intervals.first + 1j * intervals.last, return_inverse=True)
        first, last = ends.real, ends.imag
        s = np.stack([first, last, 0.5 * (first + last)], axis=1)
        placed, poses = prepared.at(s.ravel())
        pose, over = poses.reshape(s.shape)[where], prepared.over(first, last)
        mover, holder = table.mover[intervals.pair], table.holder[intervals.pair]
        held, moved = table.joint[holder], table.joint[mover]
        rotation, translation = place_pairs(placed, pose, held, moved)
        allowed = table.allowed[intervals.pair, intervals.phase]
        return PairPoses(
            table,
            intervals,
            allowed,
            np.where(np.isnan(allowed), table.demanded[intervals.pair], -allowed),
            mover,
            holder,
            s[where],
            placed,
            pose,
            rotation,
            translation,
            bound_chord_deviation(
                table, mover, table.chains, table.chain[intervals.pair], over, where, placed, pose[:, MIDDLE], settings
            ),
        )

    @property
    def is_left_out(self) -> Bool[np.ndarray, "E"]:
        """Rows of pairs that are left out."""
        return np.asarray(self.table.is_left_out[self.intervals.pair])

    def key(self, row: int) -> tuple[int, int]:
        """Return pair and phase of a row."""
        return int(self.intervals.pair[row]), int(self.intervals.phase[row])

    def separation(self, rows: Int[np.ndarray, "R"], direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
        """Return a lower bound of the signed distance between the hull of the mover's two end poses and the holder [m].

        ``direction`` are unit vectors from mover to holder in the holder's frame; those that are not finite give -inf.
        """
        poll()
        library = find_library()
        if library is not None:
            return compiled.separate(
                library, self.table.hulls, self.mover, self.holder, self.rotation, self.translation, rows, direction
            )
        turned = direction[:, None, None, :] @ self.rotation[rows, :MIDDLE]
        mover, n = self.mover[rows], len(rows)
        which = np.concatenate([mover, mover, self.holder[rows]])
        reach = supports(
            self.table.solids, which, np.concatenate([turned[:, FIRST, 0], turned[:, LAST, 0], -direction])
        ).reshape(3, n)
        shift = (self.translation[rows, :MIDDLE] @ direction[..., None])[..., 0].T
        separation = -reach[2] - (reach[:2] + shift).max(axis=0)
        return np.where(np.isnan(separation), -np.inf, separation)

    def closest(
        self, rows: Int[np.ndarray, "R"], columns: Int[np.ndarray, "R"], query: DistanceQuery
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Return signed distances [m] and directions from mover to holder of these rows, each at one pose."""
        library, solids = find_library(), self.table.solids
        mover, holder = self.mover[rows], self.holder[rows]
        rotation, translation = self.rotation[rows, columns], self.translation[rows, columns]
        is_left = np.ones(len(rows), dtype=bool)
        distance, direction = np.empty(len(rows)), np.empty((len(rows), 3))
        if library is not None:
            for low in range(0, len(rows), _MEASURED):
                poll()
                some = slice(low, low + _MEASURED)
                distance[some], direction[some], is_left[some] = self.table.hulls.measure_pairs(
                    library, mover[some], holder[some], rotation[some], translation[some]
                )
        if np.any(is_left):
            distance[is_left], direction[is_left] = query.closest(
                [solids[k].convex for k in mover[is_left].tolist()],
                rotation[is_left],
                translation[is_left],
                [solids[k].convex for k in holder[is_left].tolist()],
            )
        return distance, direction

    def nearest_point(self, row: int, column: int, query: DistanceQuery) -> Float[np.ndarray, "3"]:
        """Return the holder's point nearest to the mover at an interval's end or middle, in the world [m]."""
        mover, holder = self.table.solids[self.mover[row]], self.table.solids[self.holder[row]]
        point = query.nearest_point(
            mover.convex, self.rotation[row, column], self.translation[row, column], holder.convex
        )
        at = self.pose[row, column], holder.joint
        return np.asarray(self.placed.rotation[at] @ point + self.placed.translation[at])


def place_pairs(
    placed: Placements, pose: Int[np.ndarray, "E 3"], held: Int[np.ndarray, "E"], moved: Int[np.ndarray, "E"]
) -> tuple[Float[np.ndarray, "E 3 3 3"], Float[np.ndarray, "E 3 3"]]:
    """Return rotations and translations of joints ``moved`` in the frames of joints ``held`` at these poses [m]."""
    library = find_library()
    if library is not None:
        return compiled.place_pairs(library, placed, pose, held, moved)
    back = np.swapaxes(placed.rotation[pose, held[:, None]], -1, -2)
    offset = placed.translation[pose, moved[:, None]] - placed.translation[pose, held[:, None]]
    return back @ placed.rotation[pose, moved[:, None]], (back @ offset[..., None])[..., 0]


def bound_chord_deviation(
    table: PairTable,
    mover: Int[np.ndarray, "E"],
    chains: JointChain,
    chain: Int[np.ndarray, "E"],
    over: RateBounds,
    interval: Int[np.ndarray, "E"],
    placed: Placements,
    middle: Int[np.ndarray, "E"],
    settings: VerifySettings,
) -> Float[np.ndarray, "E"]:
    """Bound the distance of a mover from its chords per interval, exported samples and rounding included [m].

    Args:
        chain: row of ``chains``.
        interval: row of ``over``.
        middle: row of ``placed`` that holds the interval's middle.
    """
    poll()
    library = find_library()
    if library is not None:
        bound = compiled.bound_deviation(
            library, table, mover, chains, chain, over, interval, placed, middle, settings.rounding
        )
        return np.asarray(bound + ROUNDING_M)
    joint, chains, over = table.joint[mover], chains.take(chain), over.take(interval)
    world = (placed.rotation[middle, joint] @ table.centre[mover][..., None])[..., 0]
    world += placed.translation[middle, joint]
    gap = placed.translation[middle[:, None], chains.joints] - world[:, None]
    distance = np.sqrt(np.einsum("emk,emk->em", gap, gap)) + table.radius[mover][:, None]
    deviation = chains.deviation(over, chains.local_reach(distance, over))
    return np.asarray(deviation + chains.sampling_slack(over, settings.rounding) + ROUNDING_M)


@dataclass(frozen=True)
class PairSample:
    """Pair at one pose: signed distance, its least value [m], and the holder's closest point in the world."""

    pair: int
    s: float
    distance: float
    allowed: float
    need: float
    position: Float[np.ndarray, "3"]


class PoseSamples:
    """Signed distances at poses, from coal, and what is extreme among them.

    Attributes:
        nearest: smallest distance of a checked pair that may not touch, or the horizon [m].
        deepest: by pair and phase, the smallest distance of a pair allowed to touch [m].
        refuted: by pair and phase, the deepest pose that is nearer than demanded, or deeper than allowed.
    """

    def __init__(self, horizon: float, tolerance: float) -> None:
        """``horizon`` bounds what is of interest, ``tolerance`` is the excess that refutes [m]."""
        self.nearest = horizon
        self.deepest: dict[tuple[int, int], float] = {}
        self.refuted: dict[tuple[int, int], PairSample] = {}
        self._tolerance = tolerance
        self._query = DistanceQuery()

    def measure(
        self, poses: PairPoses, rows: Int[np.ndarray, "R"], columns: Int[np.ndarray, "R"]
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"]]:
        """Measure these rows, each at one pose; return distances and directions."""
        distance, direction = poses.closest(rows, columns, self._query)
        allowed = poses.allowed[rows]
        may_touch = ~np.isnan(allowed)
        counts = ~may_touch & ~poses.is_left_out[rows]
        self.nearest = min(self.nearest, float(distance[counts].min(initial=np.inf)))
        for k in np.flatnonzero(may_touch).tolist():
            key = poses.key(int(rows[k]))
            self.deepest[key] = min(self.deepest.get(key, np.inf), float(distance[k]))
        need = poses.need[rows]
        for k in np.flatnonzero(distance < need - self._tolerance).tolist():
            row, column = int(rows[k]), int(columns[k])
            key = poses.key(row)
            if key not in self.refuted or distance[k] < self.refuted[key].distance:
                point = poses.nearest_point(row, column, self._query)
                s = float(poses.s[row, column])
                self.refuted[key] = PairSample(key[0], s, float(distance[k]), float(allowed[k]), float(need[k]), point)
        return distance, direction
