"""Bars to start a fit from, about a straight run of points, and how well bars explain what is seen there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.bars import SIGMA_DEPTH, SIGMA_EDGE, Bar, Section, SurroundingRays, cross_bars, sort_rays
from perception.detect.vectors import cross, median_of_known

_WORST = 9.0
_TURNS = np.radians([0.0, 30.0, 60.0, 90.0, 120.0, 150.0])
_LEAST_SQUARE = 0.05


@dataclass(frozen=True)
class Run:
    """A stretch of a straight line.

    Attributes:
        place: (3,) on it [m].
        axis: (3,) unit.
        first, last: its ends, from ``place`` along ``axis`` [m].
    """

    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    first: float
    last: float

    def places(self, spacing: float, beyond: float = 0.0) -> Float[np.ndarray, "K 3"]:
        """Places along it, from ``beyond`` before to ``beyond`` behind it, at most ``spacing`` apart [m]."""
        low, high = self.first - beyond, self.last + beyond
        n = max(2, int(np.ceil((high - low) / spacing)) + 1)
        return np.asarray(self.place + np.linspace(low, high, n)[:, None] * self.axis)


def run_of(bar: Bar) -> Run:
    """Where a bar lies."""
    return Run(bar.centre, bar.axis, bar.first, bar.last)


@dataclass(frozen=True)
class Sample:
    """Some of the rays about a straight run.

    Attributes:
        rays: that ended near its line, and that passed it.
        mine: those that ended within the tube about the line.
        away: (3,) unit, square to the line, where the rays go.
    """

    rays: SurroundingRays
    mine: Bool[np.ndarray, "N"]
    away: Float[np.ndarray, "3"]


def sample_about(rays: SurroundingRays, run: Run, radius: float, most: int) -> Sample | None:
    """Rays between the ends of a run; None when too few ended there or all look along it.

    Args:
        rays: that pass near the run.
        run: the stretch.
        radius: of the tube about it whose points are to be explained [m].
        most: rays of either sort; more are thinned.
    """
    offset = rays.ends - run.place
    along = offset @ run.axis
    apart = np.linalg.norm(offset - along[:, None] * run.axis, axis=1)
    # Rays that pass are told by where they come nearest to the line, not by where they end.
    way = rays.direction - (rays.direction @ run.axis)[:, None] * run.axis
    nearest = ((run.place - rays.start) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-6)
    passes_at = (rays.start + nearest[:, None] * rays.direction - run.place) @ run.axis
    is_mine = (apart < radius) & ~rays.elsewhere
    mine = np.flatnonzero(is_mine & (along > run.first) & (along < run.last))
    is_pass = ~is_mine & (rays.length > nearest) & (passes_at > run.first) & (passes_at < run.last)
    passes = np.flatnonzero(is_pass)
    if len(mine) < 12:
        return None
    away = rays.direction[mine].mean(axis=0)
    away -= (away @ run.axis) * run.axis
    norm = float(np.linalg.norm(away))
    if norm < _LEAST_SQUARE:
        return None
    mine, passes = (one[:: max(1, -(-len(one) // most))] for one in (mine, passes))
    chosen = rays.selected(np.concatenate([mine, passes]))
    return Sample(chosen, np.arange(len(chosen)) < len(mine), away / norm)


def misfits(sample: Sample, bars: Sequence[Bar]) -> Float[np.ndarray, "B"]:
    """How badly each bar explains the sample: squared residuals, none worse than three standard deviations.

    What ended near the line should lie on the bar, what passed should miss it.
    """
    crossing = cross_bars(sample.rays, bars)
    gap = (sample.rays.length - crossing.depth) / SIGMA_DEPTH
    on = gap**2 + (np.maximum(crossing.outside, 0.0) / SIGMA_EDGE) ** 2
    off = (np.maximum(-crossing.outside, 0.0) / SIGMA_EDGE) ** 2 * sort_rays(sample.rays, crossing).passed
    return np.asarray(np.minimum(np.where(sample.mine, on, off), _WORST).sum(axis=1))


Start = tuple[Bar, tuple[float, float]]


def starts_about(
    sample: Sample, run: Run, halves: Sequence[tuple[float, float]], section: Section, most: int
) -> list[Start]:
    """Bars of every size, each at the turn that explains the sample best, then the next best; each with its half
    sizes [m]."""
    across = cross(sample.away, run.axis)
    seen = (sample.rays.ends - run.place)[sample.mine] @ across
    low, high = np.percentile(seen, [4, 96])
    bars: list[Start] = []
    for half in halves:
        for turn in _turns(half, section):
            width = np.cos(turn) * across + np.sin(turn) * sample.away
            frame = np.stack([run.axis, width, cross(run.axis, width)])
            reach, deep = (
                abs(frame[1] @ way) * half[0] + abs(frame[2] @ way) * half[1] for way in (across, sample.away)
            )
            middles = [0.5 * (low + high)]
            if high - low > 2.0 * reach + 0.02:
                # Something else ended near the line too: one of the edges is the thing's own.
                middles += [low + reach, high - reach]
            bars += [
                (Bar(frame, run.place + middle * across + deep * sample.away, half, run.first, run.last, section), half)
                for middle in middles
            ]
    for _ in range(2):
        bars = _at_their_depth(sample, bars)
    order = np.argsort(misfits(sample, [bar for bar, _ in bars]), kind="stable").tolist()
    # The best of every size first: which size it is shows only after the fit.
    leaders = [next(i for i in order if bars[i][1] == half) for half in halves]
    return [bars[i] for i in [*leaders, *(i for i in order if i not in leaders)][:most]]


def _turns(half: tuple[float, float], section: Section) -> Float[np.ndarray, "K"]:
    """Turns about the axis that make a difference."""
    if section == "round":
        return _TURNS[:1]
    return _TURNS[:3] if half[0] == half[1] else _TURNS


def _at_their_depth(sample: Sample, bars: list[Start]) -> list[Start]:
    """Moved along the rays, so that those that ended near the line and meet the bar end on it."""
    crossing = cross_bars(sample.rays, [bar for bar, _ in bars])
    gap = np.where(sample.mine & (crossing.outside < SIGMA_EDGE), sample.rays.length - crossing.depth, np.nan)
    shift = median_of_known(gap, 0.0)
    return [
        (replace(bar, centre=bar.centre + by * sample.away), half)
        for (bar, half), by in zip(bars, shift.tolist(), strict=True)
    ]
