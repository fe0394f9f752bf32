"""Proof of a quantity's largest value along a phase, by bisection of the curve, and the check made of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.stopping import poll
from service.verify.certificate import Basis, Check, Where
from service.verify.motion import Phase, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import edges_within, find_time

# (first (I,), last (I,)) -> upper bounds over the intervals (I,), values at their first ends (I,) and last ends (I,)
Evaluate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

RESOLUTION_SHARE = 0.05  # of a limit: how far a bound may exceed the largest value, where samples are close together
_PROGRESS = 0.9  # of an interval's excess over its samples; halves that keep more of it show nothing new


@dataclass(frozen=True)
class Extreme:
    """Largest value of a quantity along the curve.

    Attributes:
        bound: proven upper bound over all intervals.
        sampled: largest sampled value.
        s: path parameter of that sample.
        is_proven: the bound does not exceed the limit.
    """

    bound: float
    sampled: float
    s: float
    is_proven: bool

    @staticmethod
    def at_one_pose(value: float, s: float, limit: float) -> Extreme:
        """Return a value that counts at a single pose."""
        return Extreme(value, value, s, bool(value <= limit))


def bound_largest(
    edges: Float[np.ndarray, "E"],
    evaluate: Evaluate,
    limit: float,
    resolution: float,
    max_halvings: int,
    max_sharpenings: int,
) -> Extreme:
    """Bound the largest value between the edges, halving intervals until each is below the limit.

    A bound above the largest sample by more than ``resolution`` is sharpened too, by at most ``max_sharpenings``
    halvings, so that the reported margin is close; also where the limit is exceeded, so that the largest sample is
    close to the largest value.  Sharpening ends where half of an interval has nearly the bound of the whole, as where
    the samples are far apart.  An interval stays open when a sample on it exceeds the limit or after ``max_halvings``.
    """
    first, last = edges[:-1], edges[1:]
    bound, sampled, where = -np.inf, -np.inf, float(edges[0])
    before = np.full(len(first), np.inf)
    is_proven = True
    for halving in range(max_halvings + 1):
        poll()
        upper, at_first, at_last = evaluate(first, last)
        samples = np.maximum(at_first, at_last)
        best = int(samples.argmax())
        if samples[best] > sampled:
            sampled = float(samples[best])
            where = float(first[best] if at_first[best] >= at_last[best] else last[best])
        is_high = ~(upper <= limit)  # a bound that is NaN proves nothing
        above = np.subtract(upper, samples, out=np.zeros_like(upper), where=samples < np.inf)
        is_blurred = (upper > sampled + resolution) & (above < _PROGRESS * before) & (halving < max_sharpenings)
        is_split = (is_high & (samples <= limit)) | is_blurred
        if halving == max_halvings:
            is_split[:] = False
        settled = ~is_split
        if np.any(settled):
            bound = max(bound, float(upper[settled].max()))
            is_proven = is_proven and not bool(np.any(is_high & settled))
        if not np.any(is_split):
            break
        middle = 0.5 * (first[is_split] + last[is_split])
        first = np.concatenate([first[is_split], middle])
        last = np.concatenate([middle, last[is_split]])
        before = np.tile(above[is_split], 2)
    return Extreme(bound, sampled, where, is_proven)


@dataclass(frozen=True)
class PhaseProof:
    """Proofs along one phase of a motion."""

    prepared: PreparedMotion
    phase: Phase
    settings: VerifySettings

    def bound(
        self, evaluate: Evaluate, limit: float, resolution: float | None = None, largest: float = np.inf
    ) -> Extreme:
        """Bound the largest value along the phase.

        Args:
            evaluate: bounds on intervals, and values at their ends.
            limit: of the quantity.
            resolution: distance from the largest value within which a few halvings are tried; by default they go on
                until it is within ``RESOLUTION_SHARE`` of the limit.
            largest: value that the quantity never exceeds, though its bounds may.
        """
        edges, settings = edges_within(self.prepared.edges, self.phase), self.settings
        fine, sharpenings = resolution, settings.max_sharpenings
        if fine is None:
            fine, sharpenings = RESOLUTION_SHARE * min(limit, largest), settings.max_halvings
        required = np.inf if limit >= largest else limit
        extreme = bound_largest(edges, evaluate, required, fine, settings.max_halvings, sharpenings)
        return replace(extreme, bound=min(extreme.bound, largest))

    def bound_convex(
        self,
        value: Callable[[np.ndarray], np.ndarray],
        deviation: Callable[[np.ndarray, np.ndarray], np.ndarray],
        limit: float,
        resolution: float | None = None,
    ) -> Extreme:
        """Bound a quantity that is convex along the chord of a path, so that its largest value there is at an end.

        Args:
            value: quantity at path parameters.
            deviation: bound of the distance between path and chord on intervals, in the quantity's unit.
            limit, resolution: as in ``bound``.
        """

        def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            ends = values_at_ends(value, first, last)
            return np.maximum(*ends) + deviation(first, last), *ends

        return self.bound(evaluate, limit, resolution)

    def check(
        self,
        name: str,
        extreme: Extreme,
        limit: float,
        unit: str,
        text: str,
        position: np.ndarray | None,
        *,
        names: tuple[str, ...] = (),
        negate: bool = False,
        failure: str = "",
        promise: str = "",
    ) -> Check:
        """Make a check of a bound.

        Args:
            text: sentence for a bound that is proven.
            position: (3,) where the largest sample is, in the world [m].
            names: links or joints concerned.
            negate: report "at least -limit" instead of "at most limit".
            failure: sentence where a sample refutes; by default that ``text`` is not so.
            promise: sentence on the limit, for a bound that is not proven; by default ``text``.
        """
        sign = -1.0 if negate else 1.0
        point = None if position is None else (float(position[0]), float(position[1]), float(position[2]))
        where = Where(extreme.s, find_time(self.prepared.motion.law, extreme.s), point, names)
        is_ok = bool(extreme.sampled <= limit)
        value = sign * float(extreme.bound if extreme.is_proven else extreme.sampled)
        basis = Basis.PROOF if extreme.is_proven else Basis.UNPROVEN if is_ok else Basis.SAMPLES
        if not extreme.is_proven:
            text = f"not shown that {promise or text}" if is_ok else failure or f"not so: {text}"
        return Check(name, is_ok, value, sign * float(limit), unit, text, where, basis)


def values_at_ends(
    values: Callable[[np.ndarray], np.ndarray], first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]
) -> tuple[Float[np.ndarray, "I"], Float[np.ndarray, "I"]]:
    """Return a quantity at the first and at the last ends of intervals."""
    both = values(np.concatenate([first, last]))
    return both[: len(first)], both[len(first) :]
