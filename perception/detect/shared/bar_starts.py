"""Start bars of a fit about a straight run of points, and misfits of bars to the rays there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.shared.arithmetic import cross, median_of_known, quantiles
from perception.detect.shared.bars import (
    SIGMA_DEPTH,
    SIGMA_EDGE,
    Bar,
    BarCrossing,
    Section,
    SurroundingRays,
    cross_bars,
    cross_sections,
    sort_rays,
)

_WORST = 9.0
_TURNS = np.radians(np.arange(0.0, 180.0, 15.0))
_OFFSET, _MOST_OFFSETS = 0.02, 6
_LIKELY = 24
_BLUR = 2.5
_EDGEWISE = 0.7
_LEAST_SQUARE = 0.05
_DIGITS = 6  # of a misfit after the point


@dataclass(frozen=True)
class Run:
    """Segment of a straight line.

    Attributes:
        place: (3,) point on it [m].
        axis: (3,) unit.
        first, last: its ends, from ``place`` along ``axis`` [m].
        away: (3,) unit, square to the axis, into the visible face; None: no face is known.
    """

    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    first: float
    last: float
    away: Float[np.ndarray, "3"] | None = None

    def places(self, spacing: float, beyond: float = 0.0) -> Float[np.ndarray, "K 3"]:
        """Return points at most ``spacing`` apart, from ``beyond`` before the start to ``beyond`` past the end [m]."""
        low, high = self.first - beyond, self.last + beyond
        n = max(2, int(np.ceil((high - low) / spacing)) + 1)
        return np.asarray(self.place + np.linspace(low, high, n)[:, None] * self.axis)


def run_of(bar: Bar) -> Run:
    """Return the run along a bar's axis."""
    return Run(bar.centre, bar.axis, bar.first, bar.last)


@dataclass(frozen=True)
class Sample:
    """Some of the rays about a straight run.

    Attributes:
        rays: rays that ended near the run's line, and rays that passed it.
        mine: (N,) which rays ended in the tube about the line.
        away: (3,) unit, square to the line, into the visible face or along the rays' mean direction.
    """

    rays: SurroundingRays
    mine: Bool[np.ndarray, "N"]
    away: Float[np.ndarray, "3"]


def sample_about(rays: SurroundingRays, run: Run, radius: float, most: int) -> Sample | None:
    """Return rays between the ends of a run; None when too few ended there or all are parallel to it.

    Args:
        radius: of the tube about the run whose points the bar must explain [m].
        most: largest number of rays of each sort; more are thinned.
    """
    offset = rays.ends - run.place
    along = offset @ run.axis
    apart = np.linalg.norm(offset - along[:, None] * run.axis, axis=1)
    # A ray that passes is located where it is nearest to the line, not where it ends.
    way = rays.direction - (rays.direction @ run.axis)[:, None] * run.axis
    nearest = ((run.place - rays.start) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-6)
    passes_at = (rays.start + nearest[:, None] * rays.direction - run.place) @ run.axis
    is_mine = (apart < radius) & ~rays.elsewhere
    if rays.taken is not None:
        is_mine &= ~rays.taken
    mine = np.flatnonzero(is_mine & (along > run.first) & (along < run.last))
    is_pass = ~is_mine & (rays.length > nearest) & (passes_at > run.first) & (passes_at < run.last)
    passes = np.flatnonzero(is_pass)
    if len(mine) < 12:
        return None
    away = rays.direction[mine].mean(axis=0) if run.away is None else run.away
    away = away - (away @ run.axis) * run.axis
    norm = float(np.linalg.norm(away))
    if norm < _LEAST_SQUARE:
        return None
    mine, passes = (mask[:: max(1, -(-len(mask) // most))] for mask in (mine, passes))
    chosen = rays.select(np.concatenate([mine, passes]))
    return Sample(chosen, np.arange(len(chosen)) < len(mine), away / norm)


def misfits(sample: Sample, bars: Sequence[Bar]) -> Float[np.ndarray, "B"]:
    """Return each bar's sum of squared residuals, in standard deviations, each bounded at three of them.

    A ray that ended near the line should end on the bar, a ray that passed should miss the bar.
    """
    return _misfits(sample, cross_bars(sample.rays, bars))


def _misfits(sample: Sample, crossing: BarCrossing, blur: float = 1.0) -> Float[np.ndarray, "B"]:
    gap = (sample.rays.length - crossing.depth) / (blur * SIGMA_DEPTH)
    on = gap**2 + (np.maximum(crossing.outside, 0.0) / (blur * SIGMA_EDGE)) ** 2
    off = (np.maximum(-crossing.outside, 0.0) / (blur * SIGMA_EDGE)) ** 2 * sort_rays(sample.rays, crossing).passed
    # Bars of equal misfit are in the order of their starts, whatever the last digits of the sums are.
    return np.asarray(np.round(np.minimum(np.where(sample.mine, on, off), _WORST).sum(axis=1), _DIGITS))


Start = tuple[Bar, tuple[float, float]]


def starts_about(
    sample: Sample, run: Run, halves: Sequence[tuple[float, float]], section: Section, most: int
) -> list[Start]:
    """Return at most ``most`` start bars with their half sizes [m]: first the best turn of every size."""
    across = cross(sample.away, run.axis)
    seen = (sample.rays.ends - run.place)[sample.mine] @ across
    low, high = quantiles(seen, 0.04, 0.96)
    frames, middles, size, side = [], [], [], []
    for i, half in enumerate(halves):
        for turn in _turns(half, section):
            width = np.cos(turn) * across + np.sin(turn) * sample.away
            frame = np.stack([run.axis, width, cross(run.axis, width)])
            reach, deep = np.abs(frame[1:] @ np.stack([across, sample.away], axis=1)).T @ half
            # Points of other objects may be in the tube too, so the bar may be anywhere in the points' extent.
            room = high - low - 2.0 * reach
            n = int(min(max(np.ceil(room / _OFFSET) + 1, 1), _MOST_OFFSETS))
            places = np.linspace(low + reach, high - reach, n) if n > 1 else np.array([0.5 * (low + high)])
            frames += [frame] * n
            middles.append(run.place + places[:, None] * across + deep * sample.away)
            size += [i] * n
            side += [2 * i + (half[0] != half[1] and abs(np.cos(turn)) < _EDGEWISE)] * n
    bars = _Many(np.stack(frames), np.concatenate(middles), np.array(size), np.array(side), np.array(halves), section)
    bars = _at_their_depth(sample, bars)
    likely = np.argsort(_misfits(sample, bars.crossed_by(sample.rays), _BLUR), kind="stable")
    likely = np.unique(np.concatenate([_leaders(bars.side[likely], likely), likely[:_LIKELY]]))
    bars = _at_their_depth(sample, bars.choose(likely))
    return _best(sample, bars, run, most, _BLUR)


def starts_flush_with(sample: Sample, bar: Bar, halves: Sequence[tuple[float, float]], most: int) -> list[Start]:
    """Return boxes of every size whose near faces are flush with a fitted box's, the best first."""
    facing = bar.frame[1:] @ sample.away
    near, other = np.argsort(-np.abs(facing)).tolist()
    frames, middles, size, side = [], [], [], []
    for i, half in enumerate(halves):
        for is_swapped in (False, True) if half[0] != half[1] else (False,):
            wide, thick = bar.frame[1], bar.frame[2]
            frame = np.stack([bar.axis, thick, -wide] if is_swapped else [bar.axis, wide, thick])
            larger = np.array(half[::-1] if is_swapped else half) - bar.half
            into = np.sign(facing[near]) * larger[near] * bar.frame[1 + near]
            for along in (-1.0, 0.0, 1.0):
                frames.append(frame)
                middles.append(bar.centre + into + along * larger[other] * bar.frame[1 + other])
                size.append(i)
                side.append(2 * i + is_swapped)
    bars = _Many(np.stack(frames), np.array(middles), np.array(size), np.array(side), np.array(halves), bar.section)
    return _best(sample, bars, run_of(bar), most, 1.0)


def _best(sample: Sample, bars: _Many, run: Run, most: int, blur: float) -> list[Start]:
    """Return the best start of every size and side, then the best of the rest, ``most`` in all."""
    order = np.argsort(_misfits(sample, bars.crossed_by(sample.rays), blur), kind="stable")
    leaders = _leaders(bars.side[order], order).tolist()
    chosen = [*leaders, *(i for i in order.tolist() if i not in leaders)][:most]
    halves = [(float(width), float(thickness)) for width, thickness in bars.halves[bars.size]]
    return [
        (Bar(bars.frames[i], bars.centres[i], halves[i], run.first, run.last, bars.section), halves[i]) for i in chosen
    ]


def _leaders(side: Int[np.ndarray, "B"], order: Int[np.ndarray, "B"]) -> Int[np.ndarray, "L"]:
    """Return the first bar of each size and side in ``order``, in that order."""
    return np.asarray(order[np.sort(np.unique(side, return_index=True)[1])])


def _turns(half: tuple[float, float], section: Section) -> Float[np.ndarray, "K"]:
    """Return the turns about the axis that symmetry does not repeat [rad]."""
    if section == "round":
        return np.asarray(_TURNS[:1])
    return np.asarray(_TURNS[: len(_TURNS) // 2] if half[0] == half[1] else _TURNS)


@dataclass(frozen=True)
class _Many:
    """Bars as arrays: frames (B, 3, 3), centres (B, 3) [m], index ``size`` into the half sizes (S, 2) [m], and
    ``side``, a number for the size and whether its broad face or its edge is towards the sensor."""

    frames: Float[np.ndarray, "B 3 3"]
    centres: Float[np.ndarray, "B 3"]
    size: Int[np.ndarray, "B"]
    side: Int[np.ndarray, "B"]
    halves: Float[np.ndarray, "S 2"]
    section: Section

    def crossed_by(self, rays: SurroundingRays) -> BarCrossing:
        return cross_sections(rays, self.frames, self.centres, self.halves[self.size], self.section)

    def choose(self, keep: Int[np.ndarray, "K"]) -> _Many:
        return replace(
            self, frames=self.frames[keep], centres=self.centres[keep], size=self.size[keep], side=self.side[keep]
        )


def _at_their_depth(sample: Sample, bars: _Many) -> _Many:
    """Return the bars moved along ``away`` by the median depth residual of the rays that hit them."""
    mine = sample.rays.select(sample.mine)
    crossing = bars.crossed_by(mine)
    gap = np.where(crossing.outside < SIGMA_EDGE, mine.length - crossing.depth, np.nan)
    shift = median_of_known(gap, 0.0)
    return replace(bars, centres=bars.centres + shift[:, None] * sample.away)
