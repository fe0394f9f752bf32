"""The search for the smallest clearance: stretches are halved until the hulls separate or a pose collides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.stopping import poll
from service.verify.couples import Couples
from service.verify.look import FIRST, LAST, MIDDLE, ROUNDING_M, Look
from service.verify.samples import Meeting, Samples
from service.verify.settings import VerifySettings
from service.verify.stretches import Stretches
from service.verify.track import Track

# Stretches looked at together in the first round: the nearest few before all others, then so many at once.
_NEAREST, _CHUNK = 64, 2000


@dataclass(frozen=True)
class Shown:
    """Pairs on stretches with what was shown: the pair's clearance is at least ``distance - bound`` there.

    Attributes:
        couple: (R,) pair.
        phase: (R,) index of the phase.
        first, last: (R,) path parameters.
        distance: (R,) lower bound of the distance of the mover's swept hull from the holder [m].
        bound: (R,) how far the mover may leave that hull [m].
    """

    couple: Int[np.ndarray, "R"]
    phase: Int[np.ndarray, "R"]
    first: Float[np.ndarray, "R"]
    last: Float[np.ndarray, "R"]
    distance: Float[np.ndarray, "R"]
    bound: Float[np.ndarray, "R"]

    @property
    def lower(self) -> Float[np.ndarray, "R"]:
        """Lower bound of the clearance [m]."""
        return np.asarray(self.distance - self.bound)

    @staticmethod
    def join(parts: Sequence[Shown]) -> Shown:
        """All parts one after another."""
        columns = ([getattr(part, column.name) for part in parts] or [np.zeros(0)] for column in fields(Shown))
        couple, phase, *rest = (np.concatenate(column) for column in columns)
        return Shown(couple.astype(int), phase.astype(int), *rest)


@dataclass(frozen=True)
class ClearanceProof:
    """What the search has shown.

    Attributes:
        proven: stretches on which the pair keeps clear, or within its allowed depth.
        unproven: stretches that resisted.
        abandoned: stretches that were left because a pose of their phase refutes their pair.
        refuted: by pair and phase, the deepest pose found that penetrates deeper than allowed.
        deepest: by pair and phase, the smallest sampled distance of a pair allowed to touch [m].
        looked: pairs and stretches of the broad phase that were looked at.
    """

    proven: Shown
    unproven: Shown
    abandoned: Shown
    refuted: Mapping[tuple[int, int], Meeting]
    deepest: Mapping[tuple[int, int], float]
    looked: Stretches


def search(track: Track, couples: Couples, start: Stretches, settings: VerifySettings) -> ClearanceProof:
    """Examine stretches, halve what is neither proven nor refuted, and return what was found."""
    samples = Samples(settings.clearance_horizon_m, settings.contact_tolerance_m)
    rounds = _Rounds(track, couples, settings, samples)
    looked, left = list[Stretches](), start.take(slice(0))
    for chunk in _nearest_first(start):
        # What is found among the nearest makes most of the rest not worth a look.
        may_touch = ~np.isnan(couples.allowed[chunk.couple, chunk.phase])
        enough = np.where(may_touch, ROUNDING_M, max(samples.nearest, ROUNDING_M))
        looked.append(chunk.take(~(chunk.floor >= enough)))  # a floor that is NaN is looked at
        left = rounds.run(Stretches.join([looked[-1], left]))
    while len(left):
        left = rounds.run(left)
    proven, unproven, abandoned = (Shown.join(part) for part in (rounds.proven, rounds.unproven, rounds.abandoned))
    return ClearanceProof(proven, unproven, abandoned, samples.refuted, samples.deepest, Stretches.join(looked))


def _nearest_first(start: Stretches) -> Iterator[Stretches]:
    order = np.argsort(start.floor, kind="stable")
    yield start.take(order[:_NEAREST])
    for low in range(_NEAREST, len(order), _CHUNK):
        yield start.take(order[low : low + _CHUNK])


class _Rounds:
    """Round by round, stretches are proven, set aside as unproven, or halved."""

    def __init__(self, track: Track, couples: Couples, settings: VerifySettings, samples: Samples) -> None:
        self.proven: list[Shown] = []
        self.unproven: list[Shown] = []
        self.abandoned: list[Shown] = []
        self._track, self._couples, self._settings, self._samples = track, couples, settings, samples
        self._n_stretches = 0

    def run(self, stretches: Stretches) -> Stretches:
        """Decide every stretch; returns the halves of those that are left."""
        poll()
        if len(stretches) == 0:
            return stretches
        settings, is_new = self._settings, stretches.halved == 0
        is_spent = not np.any(is_new) and self._n_stretches + 3 * len(stretches) > settings.max_stretches
        self._n_stretches += len(stretches)
        look = Look.at(self._track, self._couples, stretches, settings)
        attempt = _Attempt(look, self._samples, settings, is_spent)
        attempt.try_hints()
        attempt.measure(np.ones(len(stretches), dtype=bool), (MIDDLE,))
        attempt.measure(is_new, (FIRST, LAST))
        is_proven, is_blurred = attempt.is_proven, attempt.is_blurred
        self.proven.append(attempt.shown(is_proven & ~is_blurred))
        # Where a pair is refuted once, the rest of its phase need not be settled.
        is_refuted = ~is_proven & self._are_refuted(look, ~is_proven)
        is_open = ~is_proven & ~is_refuted
        self.abandoned.append(attempt.shown(is_refuted))
        self.unproven.append(attempt.shown(is_open & attempt.is_last))
        return attempt.halves((is_open | is_blurred) & ~attempt.is_last)

    def _are_refuted(self, look: Look, rows: Bool[np.ndarray, "E"]) -> Bool[np.ndarray, "E"]:
        refuted = np.zeros(len(rows), dtype=bool)
        for row in np.flatnonzero(rows).tolist() if self._samples.refuted else ():
            refuted[row] = look.key(row) in self._samples.refuted
        return refuted


class _Attempt:
    """Stretches looked at: lower bounds that grow with every direction that is tried."""

    def __init__(self, look: Look, samples: Samples, settings: VerifySettings, is_spent: bool) -> None:
        self._look, self._samples, self._settings = look, samples, settings
        self._may_touch = ~np.isnan(look.allowed)
        self._need = np.where(self._may_touch, -look.allowed, 0.0)
        self._distance = np.full(len(look.allowed), -np.inf)
        self._direction = look.stretches.hint.copy()
        self._sampled = np.column_stack([look.stretches.ends, np.full(len(look.allowed), np.inf)])
        self.is_last = (look.stretches.halved >= settings.max_halvings) | is_spent
        self._sharpens = (look.stretches.halved < settings.max_sharpenings) & ~self.is_last

    @property
    def _lower(self) -> Float[np.ndarray, "E"]:
        return np.asarray(self._distance - self._look.bound)

    @property
    def _wanted(self) -> float:
        """A bound below this makes the smallest clearance look smaller than it is known to be [m]."""
        return max(self._samples.nearest - self._settings.resolution_m, 0.0)

    @property
    def _aim(self) -> Float[np.ndarray, "E"]:
        """A bound above this makes further looks unnecessary [m]."""
        wanted = np.where(self._sharpens, self._wanted, np.maximum(self._lower, 0.0))
        return np.asarray(np.where(self._may_touch, self._need, wanted))

    @property
    def is_proven(self) -> Bool[np.ndarray, "E"]:
        """Where the pair keeps clear, or within its allowed depth."""
        return np.asarray(np.where(self._may_touch, self._lower >= self._need, self._lower > 0.0))

    @property
    def is_blurred(self) -> Bool[np.ndarray, "E"]:
        """Where the bound proves enough, and yet is to be sharpened to be worth reporting."""
        return np.asarray(self.is_proven & self._sharpens & ~self._may_touch & (self._lower < self._wanted))

    def try_hints(self) -> None:
        """Raise the bounds by what is known from before."""
        rows = np.flatnonzero(np.isfinite(self._look.stretches.hint[:, 0]))
        if len(rows):
            self._try(rows, self._look.stretches.hint[rows, None])

    def measure(self, of: Bool[np.ndarray, "E"], columns: tuple[int, ...]) -> None:
        """Sample poses of these stretches where that may decide them, or must, and try the directions found there."""
        poll()
        is_settled = self.is_proven & (self._lower >= np.where(self._may_touch, 0.0, self._wanted))
        # A pair allowed to touch is sampled wherever it may, to know how deep it does.
        rows = np.flatnonzero(of & ~is_settled & (self._may_help | self._may_touch | self.is_last))
        if len(rows):
            each, at = np.repeat(rows, len(columns)), np.tile(np.array(columns), len(rows))
            self._sampled[each, at], directions = self._samples.measure(self._look, each, at)
            self._try(rows, directions.reshape(len(rows), len(columns), 3))

    def _try(self, rows: Int[np.ndarray, "R"], directions: Float[np.ndarray, "R D 3"]) -> None:
        """Raise the bounds of these rows where one of their directions separates better than what was tried before."""
        poll()
        count = directions.shape[1]
        found = self._look.separation(np.repeat(rows, count), directions.reshape(-1, 3)).reshape(-1, count)
        best = found.argmax(axis=1)
        distance = found[np.arange(len(rows)), best]
        is_better = distance > self._distance[rows]
        better = rows[is_better]
        self._distance[better] = distance[is_better]
        self._direction[better] = directions[is_better, best[is_better]]

    def shown(self, chosen: Bool[np.ndarray, "E"]) -> Shown:
        """What these rows show."""
        stretches = self._look.stretches.take(chosen)
        distance, bound = self._distance[chosen], self._look.bound[chosen]
        return Shown(stretches.couple, stretches.phase, stretches.first, stretches.last, distance, bound)

    def halves(self, chosen: Bool[np.ndarray, "E"]) -> Stretches:
        """The halves of these rows, with what is known of them."""
        poll()
        stretches = replace(self._look.stretches, ends=self._sampled[:, [FIRST, LAST]])
        return stretches.take(chosen).halves(self._direction[chosen], self._sampled[chosen, MIDDLE])

    @property
    def _may_help(self) -> Bool[np.ndarray, "E"]:
        """Where a better direction may settle the stretch: none shows more than the smallest distance sampled there."""
        return np.asarray(self._sampled.min(axis=1) - self._look.bound > self._aim)
