"""Search for the smallest clearance: broad phase, then intervals are halved until hulls separate or a pose collides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from service.verify.clearance.broad_phase import bound_clearances, find_open_intervals, refine_edges
from service.verify.clearance.pair_poses import FIRST, LAST, MIDDLE, ROUNDING_M, PairPoses, PairSample, PoseSamples
from service.verify.clearance.pairs import PairIntervals, PairTable
from service.verify.motion import VerifySettings
from service.verify.prepared_motion import PreparedMotion

# Intervals examined together in the first round: the nearest before all others, then this many at once.
_NEAREST, _CHUNK = 64, 2000


@dataclass(frozen=True)
class ClearanceBounds:
    """Bounds of the clearance of pairs on intervals: it is at least ``distance - bound`` there.

    Attributes:
        pair: (R,) pair.
        phase: (R,) index of the phase.
        first, last: (R,) path parameters.
        distance: (R,) lower bound of the distance of the mover's swept hull from the holder [m].
        bound: (R,) how far the mover may leave that hull [m].
    """

    pair: Int[np.ndarray, "R"]
    phase: Int[np.ndarray, "R"]
    first: Float[np.ndarray, "R"]
    last: Float[np.ndarray, "R"]
    distance: Float[np.ndarray, "R"]
    bound: Float[np.ndarray, "R"]

    @property
    def lower(self) -> Float[np.ndarray, "R"]:
        """Lower bound of the clearance [m]."""
        return np.asarray(self.distance - self.bound)

    def take(self, rows: Bool[np.ndarray, "R"]) -> ClearanceBounds:
        """Return these rows."""
        return ClearanceBounds(*(column[rows] for column in vars(self).values()))

    @staticmethod
    def join(parts: Sequence[ClearanceBounds]) -> ClearanceBounds:
        """Concatenate the parts."""
        columns = (
            [getattr(part, column.name) for part in parts] or [np.zeros(0)] for column in fields(ClearanceBounds)
        )
        pair, phase, *rest = (np.concatenate(column) for column in columns)
        return ClearanceBounds(pair.astype(int), phase.astype(int), *rest)


@dataclass(frozen=True)
class ClearanceProof:
    """Result of the search.

    Attributes:
        proven: intervals on which the pair keeps clear, or within its allowed depth.
        unproven: intervals on which neither was shown.
        abandoned: intervals that were not decided because a pose of their phase refutes their pair.
        refuted: by pair and phase, the deepest sampled pose that penetrates deeper than allowed.
        deepest: by pair and phase, the smallest sampled distance of a pair allowed to touch [m].
        examined: pairs and intervals of the broad phase that were examined.
    """

    proven: ClearanceBounds
    unproven: ClearanceBounds
    abandoned: ClearanceBounds
    refuted: Mapping[tuple[int, int], PairSample]
    deepest: Mapping[tuple[int, int], float]
    examined: PairIntervals


@dataclass(frozen=True)
class Examination:
    """Pairs with the floors of the broad phase and the proof of the search.

    Attributes:
        table: the pairs.
        edges: (I+1,) path parameters of the broad phase's intervals.
        phase_rows: (I,) index of the phase of each.
        floors: (I, C) lower bound of each pair's clearance on them [m].
        proof: result of the search.
    """

    table: PairTable
    edges: Float[np.ndarray, "I+1"]
    phase_rows: Int[np.ndarray, "I"]
    floors: Float[np.ndarray, "I C"]
    proof: ClearanceProof

    def without_left_out(self) -> Examination:
        """Return what is known of the pairs that are checked; their numbers stay the same."""
        table, proof = self.table.without_left_out(), self.proof
        n = len(table.mover)
        own = ClearanceProof(
            proof.proven.take(proof.proven.pair < n),
            proof.unproven.take(proof.unproven.pair < n),
            proof.abandoned.take(proof.abandoned.pair < n),
            {key: sample for key, sample in proof.refuted.items() if key[0] < n},
            proof.deepest,
            proof.examined.take(proof.examined.pair < n),
        )
        return Examination(table, self.edges, self.phase_rows, self.floors[:, :n], own)

    def list_touching(self) -> dict[tuple[str, str], tuple[float, float]]:
        """Return the links left out that are not shown to keep apart: deepest sampled overlap [m], and where."""
        touching: dict[tuple[str, str], tuple[float, float]] = {}
        unproven = self.proof.unproven.take(self.table.is_left_out[self.proof.unproven.pair])
        for pair, first in zip(unproven.pair.tolist(), unproven.first.tolist(), strict=True):
            touching.setdefault(self.table.link_names(pair), (0.0, first))
        for sample in self.proof.refuted.values():
            if self.table.is_left_out[sample.pair]:
                links = self.table.link_names(sample.pair)
                touching[links] = max(touching.get(links, (0.0, 0.0)), (-sample.distance, sample.s))
        return touching


def examine_pairs(
    prepared: PreparedMotion,
    table: PairTable,
    edges: Float[np.ndarray, "E"],
    phase: Int[np.ndarray, "E-1"],
    settings: VerifySettings,
) -> Examination:
    """Bound the clearance of all pairs on all intervals: broad phase, then search of what that leaves open.

    Args:
        table: pairs without chains.
        edges: knots and phase boundaries.
        phase: index of the phase between two of them.
    """
    edges, phase_rows = refine_edges(prepared, table, edges, phase)
    floors = bound_clearances(prepared, table, edges, settings)
    start = find_open_intervals(table, edges, phase_rows, floors, settings.clearance_horizon_m)
    table = table.with_chains(prepared.tree, np.unique(start.pair))
    return Examination(table, edges, phase_rows, floors, search_clearance(prepared, table, start, settings))


def search_clearance(
    prepared: PreparedMotion, table: PairTable, start: PairIntervals, settings: VerifySettings
) -> ClearanceProof:
    """Prove or refute the clearance on intervals; halve what is neither proven nor refuted."""
    samples = PoseSamples(settings.clearance_horizon_m, settings.contact_tolerance_m)
    rounds = _Rounds(prepared, table, settings, samples)
    examined, left = list[PairIntervals](), start.take(slice(0))
    for chunk in _nearest_first(table, start):
        # A small distance among the nearest makes most of the others unnecessary to examine.
        may_touch = ~np.isnan(table.allowed[chunk.pair, chunk.phase]) | table.is_left_out[chunk.pair]
        enough = np.where(may_touch, ROUNDING_M, np.maximum(samples.nearest, table.demanded[chunk.pair] + ROUNDING_M))
        examined.append(chunk.take(~(chunk.floor >= enough)))  # a floor that is NaN is examined
        left = rounds.run(PairIntervals.join([examined[-1], left]))
    while len(left):
        left = rounds.run(left)
    proven, unproven, abandoned = (
        ClearanceBounds.join(part) for part in (rounds.proven, rounds.unproven, rounds.abandoned)
    )
    return ClearanceProof(proven, unproven, abandoned, samples.refuted, samples.deepest, PairIntervals.join(examined))


def _nearest_first(table: PairTable, start: PairIntervals) -> Iterator[PairIntervals]:
    """Yield intervals in chunks, those of pairs left out last."""
    order = np.lexsort([start.floor, table.is_left_out[start.pair]])
    yield start.take(order[:_NEAREST])
    for low in range(_NEAREST, len(order), _CHUNK):
        yield start.take(order[low : low + _CHUNK])


class _Rounds:
    """Rounds of the search: intervals are proven, set aside as unproven, or halved."""

    def __init__(
        self, prepared: PreparedMotion, table: PairTable, settings: VerifySettings, samples: PoseSamples
    ) -> None:
        self.proven: list[ClearanceBounds] = []
        self.unproven: list[ClearanceBounds] = []
        self.abandoned: list[ClearanceBounds] = []
        self._prepared, self._table, self._settings, self._samples = prepared, table, settings, samples
        self._n_intervals = np.zeros(2, dtype=int)  # of checked pairs, of pairs left out: neither uses up the other's

    def run(self, intervals: PairIntervals) -> PairIntervals:
        """Decide every interval; return the halves of those that stay open."""
        poll()
        if len(intervals) == 0:
            return intervals
        settings, is_new = self._settings, intervals.halved == 0
        is_left_out = self._table.is_left_out[intervals.pair].astype(int)
        counts = np.bincount(is_left_out, minlength=2)
        is_spent = (self._n_intervals + 3 * counts > settings.max_intervals)[is_left_out] & (not np.any(is_new))
        self._n_intervals += counts
        poses = PairPoses.at(self._prepared, self._table, intervals, settings)
        attempt = _IntervalBounds(poses, self._samples, settings, is_spent)
        attempt.try_hints()
        attempt.measure(np.ones(len(intervals), dtype=bool), (MIDDLE,))
        attempt.measure(is_new, (FIRST, LAST))
        is_proven, is_blurred = attempt.is_proven, attempt.is_blurred
        self.proven.append(attempt.bounds(is_proven & ~is_blurred))
        # Once a pose refutes a pair, the other intervals of its phase need no decision.
        is_refuted = ~is_proven & self._are_refuted(poses, ~is_proven)
        is_open = ~is_proven & ~is_refuted
        self.abandoned.append(attempt.bounds(is_refuted))
        self.unproven.append(attempt.bounds(is_open & attempt.is_last))
        return attempt.halves((is_open | is_blurred) & ~attempt.is_last)

    def _are_refuted(self, poses: PairPoses, rows: Bool[np.ndarray, "E"]) -> Bool[np.ndarray, "E"]:
        refuted = np.zeros(len(rows), dtype=bool)
        for row in np.flatnonzero(rows).tolist() if self._samples.refuted else ():
            refuted[row] = poses.key(row) in self._samples.refuted
        return refuted


class _IntervalBounds:
    """Lower bounds of intervals, raised by every direction that is tried."""

    def __init__(
        self, poses: PairPoses, samples: PoseSamples, settings: VerifySettings, is_spent: Bool[np.ndarray, "E"]
    ) -> None:
        self._poses, self._samples, self._settings = poses, samples, settings
        self._may_touch = ~np.isnan(poses.allowed)
        self._need = poses.need
        self._distance = np.full(len(poses.allowed), -np.inf)
        self._direction = poses.intervals.hint.copy()
        self._sampled = np.column_stack([poses.intervals.ends, np.full(len(poses.allowed), np.inf)])
        self.is_last = (poses.intervals.halved >= settings.max_halvings) | is_spent
        self._is_left_out = poses.is_left_out
        self._sharpens = (poses.intervals.halved < settings.max_sharpenings) & ~self.is_last & ~self._is_left_out

    @property
    def _lower(self) -> Float[np.ndarray, "E"]:
        return np.asarray(self._distance - self._poses.bound)

    @property
    def _wanted(self) -> Float[np.ndarray, "E"]:
        """Bound below which the smallest clearance would be reported as smaller than it is known to be [m]."""
        known = np.where(self._is_left_out, 0.0, self._samples.nearest - self._settings.resolution_m)
        return np.asarray(np.maximum(known, np.maximum(self._need, 0.0)))

    @property
    def _aim(self) -> Float[np.ndarray, "E"]:
        """Bound above which further samples are unnecessary [m]."""
        wanted = np.where(self._sharpens, self._wanted, np.maximum(self._lower, self._need))
        return np.asarray(np.where(self._may_touch, self._need, wanted))

    @property
    def is_proven(self) -> Bool[np.ndarray, "E"]:
        """Intervals on which the pair keeps clear, or within its allowed depth."""
        is_enough = self._lower >= self._need
        return np.asarray(np.where(self._may_touch, is_enough, is_enough & (self._lower > 0.0)))

    @property
    def is_blurred(self) -> Bool[np.ndarray, "E"]:
        """Proven intervals whose bound is still too loose to be reported."""
        return np.asarray(self.is_proven & self._sharpens & ~self._may_touch & (self._lower < self._wanted))

    def try_hints(self) -> None:
        """Raise the bounds with the directions of earlier rounds."""
        rows = np.flatnonzero(np.isfinite(self._poses.intervals.hint[:, 0]))
        if len(rows):
            self._try(rows, self._poses.intervals.hint[rows, None])

    def measure(self, of: Bool[np.ndarray, "E"], columns: tuple[int, ...]) -> None:
        """Sample poses of intervals where that may decide them, and try the separating directions of the samples."""
        poll()
        is_settled = self.is_proven & (self._lower >= np.where(self._may_touch, 0.0, self._wanted))
        # A pair allowed to touch is sampled everywhere, to know its depth.
        rows = np.flatnonzero(of & ~is_settled & (self._may_help | self._may_touch | self.is_last))
        if len(rows):
            each, at = np.repeat(rows, len(columns)), np.tile(np.array(columns), len(rows))
            self._sampled[each, at], directions = self._samples.measure(self._poses, each, at)
            self._try(rows, directions.reshape(len(rows), len(columns), 3))
            touching = rows[self._may_touch[rows] & ~self.is_proven[rows]]
            if len(touching):
                self._try(touching, self._face_holders(touching)[:, None])

    def _face_holders(self, rows: Int[np.ndarray, "R"]) -> Float[np.ndarray, "R 3"]:
        """Return the best directions so far, turned to the holders' faces that they meet most squarely.

        Where two faces touch, coal's directions are off by thousandths, which is centimetres at the end of a wide face.
        """
        directions = np.array(self._direction[rows])
        for k, row in enumerate(rows.tolist()):
            normals = self._poses.table.solids[self._poses.holder[row]].normals
            if len(normals) and np.isfinite(directions[k]).all():
                normal = normals[int((normals @ directions[k]).argmin())]
                directions[k] = -normal / np.linalg.norm(normal)
        return directions

    def _try(self, rows: Int[np.ndarray, "R"], directions: Float[np.ndarray, "R D 3"]) -> None:
        """Raise the bounds of these rows where one of their directions separates better than those before."""
        poll()
        count = directions.shape[1]
        separation = self._poses.separation(np.repeat(rows, count), directions.reshape(-1, 3)).reshape(-1, count)
        best = separation.argmax(axis=1)
        distance = separation[np.arange(len(rows)), best]
        is_better = distance > self._distance[rows]
        better = rows[is_better]
        self._distance[better] = distance[is_better]
        self._direction[better] = directions[is_better, best[is_better]]

    def bounds(self, chosen: Bool[np.ndarray, "E"]) -> ClearanceBounds:
        """Return the bounds of these rows."""
        intervals = self._poses.intervals.take(chosen)
        distance, bound = self._distance[chosen], self._poses.bound[chosen]
        return ClearanceBounds(intervals.pair, intervals.phase, intervals.first, intervals.last, distance, bound)

    def halves(self, chosen: Bool[np.ndarray, "E"]) -> PairIntervals:
        """Return the halves of these rows, with their samples and directions."""
        poll()
        intervals = replace(self._poses.intervals, ends=self._sampled[:, [FIRST, LAST]])
        return intervals.take(chosen).halves(self._direction[chosen], self._sampled[chosen, MIDDLE])

    @property
    def _may_help(self) -> Bool[np.ndarray, "E"]:
        """Intervals that a better direction may settle: none bounds more than the smallest distance sampled there."""
        return np.asarray(self._sampled.min(axis=1) - self._poses.bound > self._aim)
