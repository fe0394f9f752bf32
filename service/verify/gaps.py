"""What the clearance proof leaves open, as columns: stretches on which a pair is not shown to keep clear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from service.verify.couples import Couples
    from service.verify.search import Shown


@dataclass(frozen=True)
class Gaps:
    """Stretches without a proof.

    On the path from ``first`` to ``last`` nobody has shown that the pair keeps clear, or within its allowed depth: the
    stretch resisted, or a pose of the pair's phase refuted it and the rest of that phase was left.

    Attributes:
        pairs: (mover, holder) names.
        pair, first, last: one entry per row: index of the pair, path parameters.
        lower: what is proven of the clearance there all the same [m]; NaN where nothing is.
    """

    pairs: tuple[tuple[str, str], ...] = ()
    pair: tuple[int, ...] = ()
    first: tuple[float, ...] = ()
    last: tuple[float, ...] = ()
    lower: tuple[float, ...] = ()


def gaps_of(couples: Couples, shown: Shown) -> Gaps:
    """The stretches as columns, neighbouring ones of a pair as one row.

    Args:
        couples: all pairs.
        shown: the stretches that stayed open.
    """
    rows = list(_joined(shown))
    used = sorted({couple for couple, *_ in rows})
    index = {couple: number for number, couple in enumerate(used)}
    return Gaps(
        tuple(couples.names(couple) for couple in used),
        tuple(index[couple] for couple, *_ in rows),
        tuple(first for _, first, _, _ in rows),
        tuple(last for _, _, last, _ in rows),
        tuple(np.floor(lower * 1e7) / 1e7 if np.isfinite(lower) else float("nan") for *_, lower in rows),
    )


def _joined(shown: Shown) -> Iterator[tuple[int, float, float, float]]:
    """Pair, first, last and lower bound of the stretches, in order; those that touch are one."""
    order = np.lexsort([shown.first, shown.couple])
    current: tuple[int, float, float, float] | None = None
    for row in order.tolist():
        couple, lower = int(shown.couple[row]), float(shown.lower[row])
        first, last = float(shown.first[row]), float(shown.last[row])
        if current is not None and current[0] == couple and first <= current[2]:
            current = couple, current[1], max(current[2], last), min(current[3], lower)
            continue
        if current is not None:
            yield current
        current = couple, first, last, lower
    if current is not None:
        yield current
