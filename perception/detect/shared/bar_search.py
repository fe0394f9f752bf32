"""The bar that explains best what is seen about a straight run of points, and how sure its size is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.detect.shared.bar_fit import SIGMA_USUAL, BarFit, fit_bars
from perception.detect.shared.bar_starts import (
    Run,
    Sample,
    misfits,
    run_of,
    sample_about,
    starts_about,
    starts_flush_with,
)
from perception.detect.shared.bars import Bar, Section, SurroundingRays
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex

_SPACING = 0.06
_AROUND = 0.13
_ON_FLOOR = 0.02
_ON_KNOWN = 0.012
_HOVER = 0.03
_SIGMA_FLOOR = 0.005
_WORST_HOVER = 16.0
_FOR_STARTS = 200
_N_FLUSH = 3
_FOR_CHOICE = 900
_UNDECIDED = 10.0
_HOPEFUL, _HOPEFUL_SHARE = 40.0, 0.4
_MOST_RAYS = 10000


@dataclass(frozen=True)
class Stock:
    """Sizes that a kind of bar comes in.

    Attributes:
        halves: half width and half thickness of each [m].
        rarity: squared standard deviations by which one has to explain better to be believed, in the order of halves.
    """

    section: Section
    halves: tuple[tuple[float, float], ...]
    rarity: tuple[float, ...]

    def rarity_of(self, half: tuple[float, float]) -> float:
        """Return the rarity of the size."""
        return self.rarity[self.halves.index(half)]


@dataclass(frozen=True)
class Choice:
    """The bar that explains best.

    Attributes:
        doubt: how far across the axis the centres of others lie that explain nearly as well [m].
    """

    fit: BarFit
    doubt: float


def rays_about(
    index: SightIndex, run: Run, beyond: float, floor: FloorPlane | None, known: Sequence[Bar] = ()
) -> SurroundingRays:
    """Return rays that pass near a run, with those marked that ended on the floor or on bars already known."""
    rays = index.passing(run.places(_SPACING, beyond), _AROUND).thin(_MOST_RAYS)
    ends = rays.ends
    elsewhere = np.zeros(len(rays), dtype=bool) if floor is None else floor.above(ends) < _ON_FLOOR
    taken = np.zeros(len(rays), dtype=bool) if known else None
    for bar in known:
        taken |= bar.holds(ends, _ON_KNOWN)
    return SurroundingRays(rays.start, rays.direction, rays.length, elsewhere, taken)


def choose_bar(
    rays: SurroundingRays,
    run: Run,
    radius: float,
    stock: Stock,
    floor: FloorPlane | None,
    n_starts: int,
    most_rays: int,
    also: BarFit | None = None,
) -> Choice | None:
    """Fit bars of all sizes about a run and take the one that explains best.

    Args:
        radius: of the tube about the run whose points are to be explained [m].
        floor: nothing lies in it, and hardly anything just over it.
        also: a further start, and others from where it lies.
    """
    few, many = (sample_about(rays, run, radius, most) for most in (_FOR_STARTS, _FOR_CHOICE))
    if few is None or many is None:
        return None
    starts = starts_about(few, run, stock.halves, stock.section, n_starts)
    if also is not None:
        bar = replace(also.bar, centre=run.place, first=run.first, last=run.last)
        starts += [(bar, also.usual), *starts_flush_with(few, bar, stock.halves, _N_FLUSH)]
    fits = fit_bars(rays, starts, most_rays, n_rounds=1)
    cost = _costs(many, fits, stock, floor)
    promising = np.flatnonzero(cost <= cost.min() + max(_HOPEFUL, _HOPEFUL_SHARE * float(cost.min()))).tolist()
    again = fit_bars(rays, [(fits[i].bar, fits[i].usual) for i in promising], most_rays, n_rounds=1)
    for i, fit, fit_cost in zip(promising, again, _costs(many, again, stock, floor), strict=True):
        fits[i], cost[i] = fit, fit_cost
    # Where nothing but noise tells sizes apart, it is the usual one.
    usual = [stock.rarity_of(fit.usual) for fit in fits]
    best = min(np.flatnonzero(cost <= cost.min() + _UNDECIDED).tolist(), key=lambda i: (usual[i], cost[i]))
    # A model is never quite true; what is left unexplained makes small differences mean less.
    tolerance = _UNDECIDED * max(1.0, float(cost[best]) / max(1, int(many.mine.sum())))
    doubt = max(
        _distance(fit.bar, fits[best].bar)
        for fit, fit_cost in zip(fits, cost, strict=True)
        if fit_cost <= cost[best] + tolerance
    )
    return Choice(fits[best], doubt)


def _costs(sample: Sample, fits: Sequence[BarFit], stock: Stock, floor: FloorPlane | None) -> Float[np.ndarray, "B"]:
    """Return how badly each explains what is seen, and how unlikely it was before, in squared standard deviations."""
    prior = [stock.rarity_of(fit.usual) + _unusual(fit) + _support_cost(fit.bar, floor) for fit in fits]
    return np.asarray(misfits(sample, [fit.bar for fit in fits]) + prior)


def _unusual(fit: BarFit) -> float:
    """Return how far a bar's sizes are from those it was drawn towards, in squared standard deviations."""
    return float((((np.array(fit.bar.half) - fit.usual) / SIGMA_USUAL) ** 2).sum())


def _support_cost(bar: Bar, floor: FloorPlane | None) -> float:
    """Return how far a bar reaches into the floor or hovers just over it, in squared standard deviations.

    Where a bar touches the floor its lowest two centimetres cannot be distinguished from it.
    """
    if floor is None:
        return 0.0
    lowest = float(floor.above(bar.corners).min())
    hovering = max(0.0, lowest) if lowest < _HOVER else 0.0
    return min(_WORST_HOVER, (hovering / _SIGMA_FLOOR) ** 2) + (min(lowest, 0.0) / _SIGMA_FLOOR) ** 2


def _distance(bar: Bar, other: Bar) -> float:
    """Return how far the middle of one is from the axis of the other [m]."""
    offset = bar.middle - other.middle
    return float(np.linalg.norm(offset - (offset @ other.axis) * other.axis))


@dataclass(frozen=True)
class Rivalry:
    """A bar held against the best of another section.

    Attributes:
        better: by how many squared standard deviations it explains better.
        share: that over what it leaves unexplained: noise alone makes much of a little when both explain badly.
        misfit: what it leaves unexplained, for each ray that ended near it; 1 where the noise is the usual one.
    """

    better: float
    share: float
    misfit: float


def rivalry(rays: SurroundingRays, bar: Bar, rivals: Sequence[tuple[float, float]], section: Section) -> Rivalry:
    """Return how much better a bar explains what is about it than bars of another section fitted to the same.

    Args:
        rivals: half sizes to start from [m].
    """
    run, radius = run_of(bar), max(bar.half) + 0.02
    few, many = (sample_about(rays, run, radius, most) for most in (_FOR_STARTS, _FOR_CHOICE))
    if few is None or many is None:
        return Rivalry(0.0, 0.0, 0.0)
    fits = fit_bars(rays, starts_about(few, run, rivals, section, len(rivals)), _FOR_STARTS)
    mine = float(misfits(many, [bar])[0])
    better = float(misfits(many, [fit.bar for fit in fits]).min()) - mine
    return Rivalry(better, better / max(mine, 1.0), mine / max(1, int(many.mine.sum())))
