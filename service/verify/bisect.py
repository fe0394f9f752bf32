"""Bisection of a quantity along the curve: an upper bound per stretch, sharpened where it is not enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from costs.stopping import poll

# (first (I,), last (I,)) -> upper bounds over the stretches (I,), values at their first ends (I,) and last ends (I,)
Evaluate = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Extreme:
    """What is known of the largest value along the curve.

    Attributes:
        bound: proven upper bound over all stretches.
        sampled: largest sampled value.
        s: path parameter of that sample.
        is_proven: the bound does not exceed the limit.
        n_stretches: stretches looked at.
    """

    bound: float
    sampled: float
    s: float
    is_proven: bool
    n_stretches: int


def largest(
    edges: Float[np.ndarray, "E"],
    evaluate: Evaluate,
    limit: float,
    resolution: float,
    max_halvings: int,
    max_sharpenings: int,
) -> Extreme:
    """Bound the largest value between the edges, halving stretches until each is below the limit.

    A bound above the largest sample by more than ``resolution`` is sharpened too, to be worth reporting, by at most
    ``max_sharpenings`` halvings.  A stretch is given up when a sample on it exceeds the limit or after
    ``max_halvings``.
    """
    first, last = edges[:-1], edges[1:]
    bound, sampled, where, n_stretches = -np.inf, -np.inf, float(edges[0]), 0
    is_proven = True
    for halving in range(max_halvings + 1):
        poll()
        upper, at_first, at_last = evaluate(first, last)
        n_stretches += len(first)
        samples = np.maximum(at_first, at_last)
        best = int(samples.argmax())
        if samples[best] > sampled:
            sampled = float(samples[best])
            where = float(first[best] if at_first[best] >= at_last[best] else last[best])
        is_high = ~(upper <= limit)  # a bound that is NaN proves nothing
        is_blurred = ~is_high & (upper > sampled + resolution) & (halving < max_sharpenings)
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
    return Extreme(bound, sampled, where, is_proven, n_stretches)
