"""Choice of the bar that best explains the rays about a straight run of points, and the doubt about its size."""

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
    """Standard sizes of a kind of bar.

    Attributes:
        halves: half width and half thickness of each size [m].
        rarity: penalty of each size in squared standard deviations, added to its misfit, in the order of halves.
    """

    section: Section
    halves: tuple[tuple[float, float], ...]
    rarity: tuple[float, ...]

    def rarity_of(self, half: tuple[float, float]) -> float:
        """Return the penalty of a size in squared standard deviations."""
        return self.rarity[self.halves.index(half)]


@dataclass(frozen=True)
class Choice:
    """Bar of least misfit.

    Attributes:
        doubt: largest distance across the axis to the centre of a bar that explains the rays nearly as well [m].
        misfit: per ray that ended near it, in squared standard deviations; 1 with the usual noise.
    """

    fit: BarFit
    doubt: float
    misfit: float


def rays_about(
    index: SightIndex, run: Run, beyond: float, floor: FloorPlane | None, known: Sequence[Bar] = ()
) -> SurroundingRays:
    """Return rays that pass near a run, marked where they ended on the floor or on a known bar."""
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
    """Fit bars of all sizes about a run and return the one of least misfit; None: too few points.

    Args:
        radius: of the tube about the run whose points the bar must explain [m].
        floor: a bar that reaches into it or hovers just over it costs more.
        also: earlier fit, used as a further start, together with boxes of other sizes flush with it.
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
    # Of sizes that differ by no more than noise the commonest is chosen.
    usual = [stock.rarity_of(fit.usual) for fit in fits]
    best = min(np.flatnonzero(cost <= cost.min() + _UNDECIDED).tolist(), key=lambda i: (usual[i], cost[i]))
    # The model is not exact: the larger the remaining misfit, the less a small difference means.
    misfit = float(cost[best]) / max(1, int(many.mine.sum()))
    tolerance = _UNDECIDED * max(1.0, misfit)
    doubt = max(
        _distance(fit.bar, fits[best].bar)
        for fit, fit_cost in zip(fits, cost, strict=True)
        if fit_cost <= cost[best] + tolerance
    )
    return Choice(fits[best], doubt, misfit)


def _costs(sample: Sample, fits: Sequence[BarFit], stock: Stock, floor: FloorPlane | None) -> Float[np.ndarray, "B"]:
    """Return each bar's misfit plus its prior cost, in squared standard deviations."""
    prior = [stock.rarity_of(fit.usual) + _unusual(fit) + _support_cost(fit.bar, floor) for fit in fits]
    return np.asarray(misfits(sample, [fit.bar for fit in fits]) + prior)


def _unusual(fit: BarFit) -> float:
    """Return the distance of a bar's sizes from its prior's, in squared standard deviations."""
    return float((((np.array(fit.bar.half) - fit.usual) / SIGMA_USUAL) ** 2).sum())


def _support_cost(bar: Bar, floor: FloorPlane | None) -> float:
    """Return the cost of a bar that reaches into the floor or hovers just over it, in squared standard deviations.

    The lowest two centimetres of a bar that touches the floor cannot be distinguished from the floor.
    """
    if floor is None:
        return 0.0
    lowest = float(floor.above(bar.corners).min())
    hovering = max(0.0, lowest) if lowest < _HOVER else 0.0
    return min(_WORST_HOVER, (hovering / _SIGMA_FLOOR) ** 2) + (min(lowest, 0.0) / _SIGMA_FLOOR) ** 2


def _distance(bar: Bar, other: Bar) -> float:
    """Return the distance of the first bar's middle from the other's axis [m]."""
    offset = bar.middle - other.middle
    return float(np.linalg.norm(offset - (offset @ other.axis) * other.axis))


@dataclass(frozen=True)
class Rivalry:
    """Comparison of a bar with the best bar of another section.

    Attributes:
        better: misfit of the other minus its own, in squared standard deviations.
        share: ``better`` over its own misfit, since noise alone makes large differences when both fit badly.
        misfit: its own misfit per ray that ended near it; 1 with the usual noise.
    """

    better: float
    share: float
    misfit: float


def rivalry(rays: SurroundingRays, bar: Bar, rivals: Sequence[tuple[float, float]], section: Section) -> Rivalry:
    """Compare a bar with bars of another section fitted to the same rays.

    Args:
        rivals: half sizes of the other section's starts [m].
    """
    run, radius = run_of(bar), max(bar.half) + 0.02
    few, many = (sample_about(rays, run, radius, most) for most in (_FOR_STARTS, _FOR_CHOICE))
    if few is None or many is None:
        return Rivalry(0.0, 0.0, 0.0)
    fits = fit_bars(rays, starts_about(few, run, rivals, section, len(rivals)), _FOR_STARTS)
    mine = float(misfits(many, [bar])[0])
    better = float(misfits(many, [fit.bar for fit in fits]).min()) - mine
    return Rivalry(better, better / max(mine, 1.0), mine / max(1, int(many.mine.sum())))
