"""Proof of clearance: swept hulls inflated by the rotation bound, bisected until they separate or a pose collides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from service.verify.couples import Couples
from service.verify.forward import Placements, placements
from service.verify.motion import Motion
from service.verify.narrow import Narrow, separation
from service.verify.rates import Intervals, intervals
from service.verify.settings import VerifySettings

# Stretches prepared at once in the first round.
_CHUNK = 2000
# Far above the rounding errors of placements and distances at the scale of a room, far below anything that matters [m].
ROUNDING_M = 1e-9


@dataclass(frozen=True)
class Stretches:
    """Pairs on stretches of the curve that the narrow phase looks at.

    Attributes:
        couple: (E,) pair.
        first, last: (E,) path parameters.
        phase: (E,) index of the phase.
        floor: (E,) a lower bound of the pair's clearance known beforehand [m] (-inf: none).
    """

    couple: Int[np.ndarray, "E"]
    first: Float[np.ndarray, "E"]
    last: Float[np.ndarray, "E"]
    phase: Int[np.ndarray, "E"]
    floor: Float[np.ndarray, "E"]

    def take(self, rows: np.ndarray) -> Stretches:
        """These rows only."""
        return Stretches(self.couple[rows], self.first[rows], self.last[rows], self.phase[rows], self.floor[rows])

    @staticmethod
    def join(parts: Sequence[Stretches]) -> Stretches:
        """All parts one after another."""
        return Stretches(
            np.concatenate([part.couple for part in parts] or [np.array([], dtype=int)]),
            np.concatenate([part.first for part in parts] or [np.array([])]),
            np.concatenate([part.last for part in parts] or [np.array([])]),
            np.concatenate([part.phase for part in parts] or [np.array([], dtype=int)]),
            np.concatenate([part.floor for part in parts] or [np.array([])]),
        )

    def halves(self, rows: np.ndarray) -> Stretches:
        """Both halves of the chosen stretches."""
        middle = 0.5 * (self.first[rows] + self.last[rows])
        return Stretches(
            np.tile(self.couple[rows], 2),
            np.concatenate([self.first[rows], middle]),
            np.concatenate([middle, self.last[rows]]),
            np.tile(self.phase[rows], 2),
            np.full(2 * len(rows), -np.inf),
        )


@dataclass(frozen=True)
class Meeting:
    """A pair at one pose: signed distance [m] and the closest points in the world."""

    couple: int
    s: float
    distance: float
    allowed: float
    first: Float[np.ndarray, "3"]
    second: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class Unproven:
    """A pair on a stretch with the lower bound of its clearance that was reached, and its allowed depth or NaN [m]."""

    couple: int
    first: float
    last: float
    lower: float
    allowed: float


@dataclass
class ClearanceProof:
    """What the search has shown so far.

    Attributes:
        couple, first, last, distance, bound: columns of the proven stretches; on each the pair's clearance is at least
            ``distance - bound`` [m].
        refuted: poses at which a pair penetrates deeper than allowed, the deepest found per pair and phase.
        unproven: stretches that resisted.
        nearest: smallest sampled distance of a pair that may not touch.
        deepest: per pair allowed to touch and phase, the smallest sampled distance and where.
        n_stretches: stretches looked at.
    """

    couple: list[int] = field(default_factory=list)
    first: list[float] = field(default_factory=list)
    last: list[float] = field(default_factory=list)
    distance: list[float] = field(default_factory=list)
    bound: list[float] = field(default_factory=list)
    refuted: dict[tuple[int, int], Meeting] = field(default_factory=dict)
    unproven: list[Unproven] = field(default_factory=list)
    nearest: float = np.inf
    deepest: dict[tuple[int, int], Meeting] = field(default_factory=dict)
    n_stretches: int = 0


class ClearanceSearch:
    """Bisection of all pairs of one motion."""

    def __init__(self, motion: Motion, couples: Couples, settings: VerifySettings) -> None:
        """Prepare the search."""
        self._motion = motion
        self._couples = couples
        self._settings = settings
        self._narrow = Narrow()
        self.proof = ClearanceProof()

    def run(self, start: Stretches) -> ClearanceProof:
        """Examine stretches, halve what is neither proven nor refuted, and return what was found."""
        order = np.argsort(start.floor, kind="stable")
        left = []
        for low in range(0, len(order), _CHUNK):
            # Nearest first: what is found there makes most of the rest not worth a look.
            chunk = start.take(order[low : low + _CHUNK])
            chunk = chunk.take(np.flatnonzero(self._is_wanted(chunk)))
            left.append(chunk.halves(self._examine(chunk, 0, is_last=self._settings.max_halvings == 0)))
        stretches = Stretches.join(left)
        for halving in range(1, self._settings.max_halvings + 1):
            if len(stretches.couple) == 0:
                break
            is_last = halving == self._settings.max_halvings or self._is_spent(len(stretches.couple))
            stretches = stretches.halves(self._examine(stretches, halving, is_last=is_last))
        return self.proof

    def _is_wanted(self, stretches: Stretches) -> Bool[np.ndarray, "E"]:
        """Where the floor leaves something to know: a pair may touch, or may be nearer than the nearest known."""
        nearest = min(self.proof.nearest, self._settings.clearance_horizon_m)
        enough = np.where(np.isnan(self._allowed(stretches)), max(nearest, ROUNDING_M), ROUNDING_M)
        return ~np.asarray(stretches.floor >= enough)  # NaN is wanted

    def _allowed(self, stretches: Stretches) -> Float[np.ndarray, "E"]:
        return np.asarray(self._couples.allowed[stretches.couple, stretches.phase])

    def _is_spent(self, more: int) -> bool:
        return self.proof.n_stretches + 3 * more > self._settings.max_stretches

    def _examine(self, stretches: Stretches, halving: int, *, is_last: bool) -> Int[np.ndarray, "H"]:
        """Decide every stretch; returns the rows to be halved."""
        proof, settings = self.proof, self._settings
        allowed = self._allowed(stretches)
        if len(allowed) == 0:
            return np.array([], dtype=int)
        look = _Look.prepare(self._motion, self._couples, stretches, settings)
        lower = np.full(len(stretches.couple), np.nan)
        distance = np.full(len(stretches.couple), np.nan)
        open_rows: list[int] = []
        for row in range(len(allowed)):
            may_touch = not np.isnan(allowed[row])
            need = -allowed[row] if may_touch else 0.0
            enough = ROUNDING_M if may_touch else max(min(proof.nearest, settings.clearance_horizon_m), ROUNDING_M)
            if stretches.floor[row] >= enough:
                continue
            proof.n_stretches += 1
            distance[row] = look.hull_distance(row, self._narrow, need)
            lower[row] = distance[row] - look.bound[row]
            is_proven = lower[row] >= need if may_touch else lower[row] > 0.0
            # Poses are sampled only where they matter: to refute, to find the smallest clearance or the deepest touch.
            if not is_proven or (lower[row] < 0.0 if may_touch else lower[row] < enough - settings.resolution_m):
                self._sample(look, stretches, row, allowed[row], ends=halving == 0 or is_proven)
            # Where a pair is refuted once, the rest of its phase need not be settled.
            if not is_proven and (int(stretches.couple[row]), int(stretches.phase[row])) not in proof.refuted:
                open_rows.append(row)
        reported = min(proof.nearest, settings.clearance_horizon_m) - settings.resolution_m
        is_blurred = (
            np.isnan(allowed)
            & (lower > 0.0)
            & (lower < reported)
            & (halving < settings.max_sharpenings)
            & (not is_last)
        )
        is_kept = (lower > 0.0) | (lower >= -allowed)
        self._keep(stretches, np.flatnonzero(is_kept & ~is_blurred), distance, look.bound)
        if is_last:
            proof.unproven += [
                Unproven(
                    int(stretches.couple[k]),
                    float(stretches.first[k]),
                    float(stretches.last[k]),
                    float(lower[k]),
                    float(allowed[k]),
                )
                for k in open_rows
            ]
            return np.array([], dtype=int)
        return np.concatenate([np.array(open_rows, dtype=int), np.flatnonzero(is_blurred)])

    def _keep(self, stretches: Stretches, rows: np.ndarray, distance: np.ndarray, bound: np.ndarray) -> None:
        proof = self.proof
        proof.couple += stretches.couple[rows].tolist()
        proof.first += stretches.first[rows].tolist()
        proof.last += stretches.last[rows].tolist()
        proof.distance += distance[rows].tolist()
        proof.bound += bound[rows].tolist()

    def _sample(self, look: _Look, stretches: Stretches, row: int, allowed: float, *, ends: bool) -> None:
        """Measure the pair at the stretch's middle (and ends) and remember what is extreme."""
        couple, proof = int(stretches.couple[row]), self.proof
        key = (couple, int(stretches.phase[row]))
        for column in (0, 1, 2) if ends else (2,):
            meeting = look.meeting(row, column, self._narrow, couple, allowed)
            if np.isnan(allowed):
                proof.nearest = min(proof.nearest, meeting.distance)
            elif key not in proof.deepest or meeting.distance < proof.deepest[key].distance:
                proof.deepest[key] = meeting
            need = 0.0 if np.isnan(allowed) else -allowed
            if meeting.distance < need - self._settings.contact_tolerance_m:
                known = proof.refuted.get(key)
                if known is None or meeting.distance < known.distance:
                    proof.refuted[key] = meeting


@dataclass(frozen=True)
class _Look:
    """Relative placements of mover in holder at the stretches' ends and middles (columns 0, 1, 2)."""

    couples: Couples
    mover: Int[np.ndarray, "E"]
    holder: Int[np.ndarray, "E"]
    s: Float[np.ndarray, "E 3"]
    rotation: Float[np.ndarray, "E 3 3 3"]
    translation: Float[np.ndarray, "E 3 3"]
    holder_rotation: Float[np.ndarray, "E 3 3 3"]
    holder_translation: Float[np.ndarray, "E 3 3"]
    bound: Float[np.ndarray, "E"]

    @staticmethod
    def prepare(motion: Motion, couples: Couples, stretches: Stretches, settings: VerifySettings) -> _Look:
        middle = 0.5 * (stretches.first + stretches.last)
        s = np.stack([stretches.first, stretches.last, middle], axis=1)
        unique, where = np.unique(s, return_inverse=True)
        where = where.reshape(s.shape)
        placed = placements(motion.robot.model, motion.curve(unique))
        over = intervals(motion.curve, stretches.first, stretches.last, motion.samples)
        mover, holder = couples.mover[stretches.couple], couples.holder[stretches.couple]
        joints = np.array([solid.joint for solid in couples.solids])
        mover_joint, holder_joint = joints[mover][:, None], joints[holder][:, None]
        rotation_holder = placed.rotation[where, holder_joint]
        translation_holder = placed.translation[where, holder_joint]
        back = np.swapaxes(rotation_holder, -1, -2)
        rotation = back @ placed.rotation[where, mover_joint]
        offset = placed.translation[where, mover_joint] - translation_holder
        return _Look(
            couples,
            mover,
            holder,
            s,
            rotation,
            (back @ offset[..., None])[..., 0],
            rotation_holder,
            translation_holder,
            stretch_bounds(couples, stretches.couple, over, placed, where[:, 2], settings),
        )

    def hull_distance(self, row: int, narrow: Narrow, need: float) -> float:
        """Lower bound of the signed distance between the hull of the mover's two end poses and the holder [m]."""
        mover, holder = self.couples.solids[self.mover[row]], self.couples.solids[self.holder[row]]
        moving = self._swept(row, mover.vertices)
        proxy = moving if mover.proxy is mover.vertices else self._swept(row, mover.proxy)
        distance = separation(narrow.direction(proxy, holder), moving, holder.vertices)
        if mover.proxy is not mover.vertices and distance - self.bound[row] <= need:
            # The proxy is fatter than the body: ask again with the body itself at mid-stretch.
            closest = narrow.closest(mover, self.rotation[row, 2], self.translation[row, 2], holder)
            distance = max(distance, separation(closest.direction, moving, holder.vertices))
        return distance

    def meeting(self, row: int, column: int, narrow: Narrow, couple: int, allowed: float) -> Meeting:
        """The pair at an end or the middle of the stretch."""
        mover, holder = self.couples.solids[self.mover[row]], self.couples.solids[self.holder[row]]
        closest = narrow.closest(mover, self.rotation[row, column], self.translation[row, column], holder)
        world = [
            self.holder_rotation[row, column] @ point + self.holder_translation[row, column]
            for point in (closest.first, closest.second)
        ]
        return Meeting(couple, float(self.s[row, column]), closest.distance, allowed, world[0], world[1])

    def _swept(self, row: int, points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
        n = len(points)
        moving = np.empty((2 * n, 3))
        np.matmul(points, self.rotation[row, 0].T, out=moving[:n])
        np.matmul(points, self.rotation[row, 1].T, out=moving[n:])
        moving[:n] += self.translation[row, 0]
        moving[n:] += self.translation[row, 1]
        return moving


def stretch_bounds(
    couples: Couples,
    couple: Int[np.ndarray, "E"],
    over: Intervals,
    placed: Placements,
    middle: Int[np.ndarray, "E"],
    settings: VerifySettings,
) -> Float[np.ndarray, "E"]:
    """How far a mover may leave its chords, the exported samples' line and rounding included, per stretch [m].

    ``middle`` are the rows of ``placed`` that hold the stretches' middles.
    """
    bound = np.empty(len(couple))
    # Pairs of one mover with many pieces share a chain: group by chain, not by pair.
    keys = np.array([id(couples.chains[c]) for c in couple.tolist()])
    order = np.argsort(keys, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(keys[order])) + 1):
        if len(rows):
            solid = couples.solids[couples.mover[couple[rows[0]]]]
            chain = couples.chains[couple[rows[0]]]
            part = over.take(rows)
            centre, radius = solid.sphere
            at = middle[rows]
            world = placed.rotation[at, solid.joint] @ centre + placed.translation[at, solid.joint]
            distance = np.linalg.norm(placed.translation[at][:, chain.joints] - world[:, None], axis=2) + radius
            reach = chain.local_reach(distance, part)
            bound[rows] = chain.deviation(part, reach) + chain.sampling_slack(part, settings.rounding) + ROUNDING_M
    return bound
