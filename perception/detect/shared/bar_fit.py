"""Least-squares fit of bars to rays that hit and rays that passed.

A scanner's noise is along its rays, so the residuals are the depth of the hits, and for hits and passes the distance
from the outline on its wrong side.  One Levenberg-Marquardt loop fits several bars to the same rays: a detector tries a
few sizes and turns for each candidate, and numpy takes little longer for all than for one (scipy's solver, called for
each, took four times as long).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.stopping import poll
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.bars import (
    LEAST_SLOPE,
    SIGMA_DEPTH,
    SIGMA_EDGE,
    Bar,
    Section,
    SurroundingRays,
    cross_bars,
    sort_rays,
)
from perception.sightlines import Sightlines

_STEPS = 6  # of the solver in each round
_ROUNDING = 1e-9  # share of the costs by which a step must lower them
_STILL = 1e-3  # share of the costs by which the last step may still lower them
_AROUND = 0.04
SIGMA_USUAL = 0.004
_SMALLEST, _LARGEST = 0.006, 0.12
# Typical changes of: tilts [rad], offsets across [m], half sizes [m], turn [rad].
_SCALE = np.array([0.02, 0.02, 0.005, 0.005, 0.005, 0.005, 0.1])
_LARGEST_STEP = np.array([0.15, 0.15, 0.03, 0.03, 0.02, 0.02, 0.4])
_FIRST_DAMPING = 1e-2
_SLACK = 0.03
_DIGITS = 9


@dataclass(frozen=True)
class BarFit:
    """A fitted bar.

    Attributes:
        bar: with the ends of its start.
        usual: half sizes of the prior [m].
        spread: standard deviations of tilt [rad] and offset across [m], each the larger of two directions, from the
            curvature of the cost.
    """

    bar: Bar
    usual: tuple[float, float]
    spread: tuple[float, float]


@dataclass(frozen=True)
class _State:
    """Several bars as arrays: frames (B, 3, 3), centres (B, 3) [m], half sizes (B, 2) [m]."""

    frames: Float[np.ndarray, "B 3 3"]
    centres: Float[np.ndarray, "B 3"]
    halves: Float[np.ndarray, "B 2"]


def fit_bars(
    rays: SurroundingRays,
    starts: Sequence[tuple[Bar, tuple[float, float]]],
    most_rays: int = 500,
    n_rounds: int = 2,
) -> list[BarFit]:
    """Refine axis, offset across, turn and size of bars of one section; their ends do not change.

    Args:
        starts: bars, each with the half sizes of its prior [m], which decide the sizes that rays do not show.
        n_rounds: number of solves; each sorts the rays into hits and passes anew.
    """
    if not starts:
        return []
    bars, usual = [_centre(bar) for bar, _ in starts], np.array([half for _, half in starts])
    for _ in range(n_rounds):
        bars, spreads = _solve(rays, bars, usual, most_rays)
    return [BarFit(bar, half, spread) for bar, (_, half), spread in zip(bars, starts, spreads, strict=True)]


def _centre(bar: Bar) -> Bar:
    """Return the bar with its centre moved to its middle, about which the fit tilts it."""
    half = 0.5 * bar.length
    return Bar(bar.frame, bar.middle, bar.half, -half, half, bar.section)


def _solve(
    rays: SurroundingRays, bars: list[Bar], usual: Float[np.ndarray, "B 2"], most: int
) -> tuple[list[Bar], list[tuple[float, float]]]:
    """Return the bars that minimize the soft-l1 cost, and their standard deviations of tilt and offset."""
    section = bars[0].section
    n = 5 if section == "round" else 7
    chosen, hit, counts = _relevant(rays, bars, most)
    halves = np.array([bar.half for bar in bars])
    state = _State(np.stack([bar.frame for bar in bars]), np.stack([bar.centre for bar in bars]), halves)
    best, cost = state, np.full(len(bars), np.inf)
    gradient, curvature = np.zeros((len(bars), n)), np.zeros((len(bars), n, n))
    damping = np.full(len(bars), _FIRST_DAMPING)
    for step in range(_STEPS + 1):
        residuals, jacobian = _linearize(chosen, hit, counts, state, usual, section)
        root = np.sqrt(1.0 + residuals**2)
        now = 2.0 * (root - 1.0).sum(axis=1)
        better = now < (1.0 - _ROUNDING) * cost
        weighted = jacobian / root[:, None]
        gradient = np.where(better[:, None], (weighted @ residuals[:, :, None])[:, :, 0], gradient)
        curvature = np.where(better[:, None, None], weighted @ jacobian.transpose(0, 2, 1), curvature)
        is_still = bool((np.abs(cost - now) < _STILL * now).all())
        best, cost = _choose(better, state, best), np.where(better, now, cost)
        if step == _STEPS or is_still:
            break
        damping = np.where(better, 0.3 * damping, 5.0 * damping)
        change = _step(gradient, curvature, damping)
        state = _move(best, change, section)
    best = _round(best, section)
    moved = [
        replace(bar, frame=frame, centre=centre, half=(float(half[0]), float(half[1])))
        for bar, frame, centre, half in zip(bars, best.frames, best.centres, best.halves, strict=True)
    ]
    return moved, _spreads(curvature)


def _spreads(curvature: Float[np.ndarray, "B n n"]) -> list[tuple[float, float]]:
    scale = _SCALE[: curvature.shape[1]]
    inverse = np.linalg.inv(curvature * scale[:, None] * scale + 1e-6 * np.eye(len(scale)))
    deviation = scale * np.sqrt(np.maximum(np.einsum("bnn->bn", inverse), 0.0))
    return [(float(row[:2].max()), float(row[2:4].max())) for row in deviation]


def spread_between_edges(rays: SurroundingRays, fit: BarFit, most_rays: int) -> tuple[float, float]:
    """Return standard deviations of tilt [rad] and offset across [m], counting rays that pass near the outline.

    A bar without residuals can still move until a ray crosses its outline; the cost's curvature does not show this.
    """
    bar = _centre(fit.bar)
    chosen, hit, counts = _relevant(rays, [bar], most_rays)
    state = _State(bar.frame[None], bar.centre[None], np.array([bar.half]))
    residuals, jacobian = _linearize(chosen, hit, counts, state, np.array([fit.usual]), bar.section, _SLACK)
    weighted = jacobian / np.sqrt(1.0 + residuals**2)[:, None]
    return _spreads(weighted @ jacobian.transpose(0, 2, 1))[0]


def _relevant(
    rays: SurroundingRays, bars: list[Bar], most: int
) -> tuple[Sightlines, Bool[np.ndarray, "B N"], Bool[np.ndarray, "B N"]]:
    """Return rays that hit or nearly hit any bar, and (B, N) masks of each bar's hits and of the rays it uses."""
    crossing = cross_bars(rays, bars)
    low, high = np.array([[bar.first, bar.last] for bar in bars]).T
    between = (crossing.along >= low[:, None]) & (crossing.along <= high[:, None])
    outcome = sort_rays(rays, crossing)
    counts = between & (outcome.hit | (outcome.passed & (crossing.outside < _AROUND)))
    keep = np.flatnonzero(counts.any(axis=0))
    keep = keep[:: max(1, -(-len(keep) // most))]
    return rays.select(keep), (outcome.hit & counts)[:, keep], counts[:, keep]


def _step(
    gradient: Float[np.ndarray, "B n"], curvature: Float[np.ndarray, "B n n"], damping: Float[np.ndarray, "B"]
) -> Float[np.ndarray, "B n"]:
    scale = _SCALE[: gradient.shape[1]]
    scaled = curvature * scale[:, None] * scale
    peak = np.maximum(np.einsum("bnn->bn", scaled).max(axis=1), 1e-9)
    damped = scaled + (damping * peak)[:, None, None] * np.eye(len(scale))
    step = -np.linalg.solve(damped, (gradient * scale)[:, :, None])[:, :, 0] * scale
    return np.asarray(np.clip(step, -_LARGEST_STEP[: len(scale)], _LARGEST_STEP[: len(scale)]))


def _choose(these: Bool[np.ndarray, "B"], new: _State, old: _State) -> _State:
    return _State(
        np.where(these[:, None, None], new.frames, old.frames),
        np.where(these[:, None], new.centres, old.centres),
        np.where(these[:, None], new.halves, old.halves),
    )


def _round(state: _State, section: Section) -> _State:
    """Return the bars rounded to nanometres, so that the order in which sums are made decides nothing afterwards."""
    parts = (np.round(part, _DIGITS) for part in (state.frames, state.centres, state.halves))
    return _move(_State(*parts), np.zeros((len(state.frames), 7)), section)


def _move(state: _State, x: Float[np.ndarray, "B n"], section: Section) -> _State:
    """Return the bars after a step ``x``: tilts (2), offsets across (2), half sizes (2; 1 if round), turn (box: 1)."""
    e0, e1, e2 = (state.frames[:, i] for i in range(3))
    axis = e0 + x[:, 0:1] * e1 + x[:, 1:2] * e2
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = x[:, 6:7] if section == "box" else np.zeros((len(x), 1))
    width = np.cos(turn) * e1 + np.sin(turn) * e2
    width = width - (width * axis).sum(axis=1, keepdims=True) * axis
    width /= np.linalg.norm(width, axis=1, keepdims=True)
    centres = state.centres + x[:, 2:3] * e1 + x[:, 3:4] * e2
    halves = np.clip(state.halves + (x[:, 4:6] if section == "box" else x[:, 4:5]), _SMALLEST, _LARGEST)
    return _State(np.stack([axis, width, cross(axis, width)], axis=1), centres, halves)


def _linearize(
    rays: Sightlines,
    hit: Bool[np.ndarray, "B N"],
    counts: Bool[np.ndarray, "B N"],
    state: _State,
    usual: Float[np.ndarray, "B 2"],
    section: Section,
    slack: float = 0.0,
) -> tuple[Float[np.ndarray, "B M"], Float[np.ndarray, "B n M"]]:
    """Return residuals in standard deviations (depth, edge, prior size) and their Jacobian, transposed.

    An edge on the right side of a ray has residual 0; up to ``slack`` [m] from the ray its derivative is still
    returned, over a standard deviation that grows with the distance.
    """
    poll()
    start = state.frames @ rays.start.T - (state.frames @ state.centres[:, :, None])
    way = state.frames @ rays.direction.T
    p0, p1, p2 = start[:, 0], start[:, 1], start[:, 2]
    d0, d1, d2 = way[:, 0], way[:, 1], way[:, 2]
    speed = np.maximum(np.hypot(d1, d2), LEAST_SLOPE)
    side = (d1 * p2 - d2 * p1) / speed
    half1, half2 = state.halves[:, :1], state.halves[:, 1:]
    if section == "box":
        reach = (np.abs(d2) * half1 + np.abs(d1) * half2) / speed
        depth, slopes, by_half = _box_entry(p1, p2, d1, d2, side, reach, speed, half1, half2)
    else:
        reach = np.broadcast_to(half1, side.shape)
        depth, slopes, by_half = _round_entry(p1, p2, d1, d2, side, reach, speed)
    outside = np.abs(side) - reach
    edge_sign = np.where(hit, 1.0, -1.0)
    beyond = edge_sign * outside
    edge_weight = (counts & (beyond > -slack)) / (SIGMA_EDGE + np.maximum(-beyond, 0.0))
    edge_slopes, edge_by_half = _edge_slopes(p1, p2, d1, d2, side, reach, speed, half1, half2, section)
    place, way = (p0, p1, p2), (d0, d1, d2)
    n_rays, n_sizes = side.shape[1], len(by_half)
    weights = hit / SIGMA_DEPTH, edge_sign * edge_weight
    residuals = np.empty((len(side), 2 * n_rays + n_sizes))
    jacobian = np.zeros((len(side), 7 if section == "box" else 5, residuals.shape[1]))
    residuals[:, :n_rays] = (depth - rays.length) * weights[0]
    residuals[:, n_rays : 2 * n_rays] = edge_weight * np.maximum(beyond, 0.0)
    residuals[:, 2 * n_rays :] = (state.halves - usual)[:, :n_sizes] / SIGMA_USUAL
    for k, (weight, rows, sizes) in enumerate(
        zip(weights, (slopes, edge_slopes), (by_half, edge_by_half), strict=True)
    ):
        moves = _by_moves(rows, place, way, section)
        # Order of the unknowns: tilts, shifts, sizes, turn.
        for i, row in enumerate((*moves[:4], *sizes, *moves[4:])):
            np.multiply(row, weight, out=jacobian[:, i, k * n_rays : (k + 1) * n_rays])
    for i in range(n_sizes):
        jacobian[:, 4 + i, 2 * n_rays + i] = 1.0 / SIGMA_USUAL
    return residuals, jacobian


_Rows = Float[np.ndarray, "B N"]


def _by_moves(
    by: tuple[_Rows, ...], place: tuple[_Rows, _Rows, _Rows], way: tuple[_Rows, _Rows, _Rows], section: Section
) -> list[_Rows]:
    """Return derivatives by a bar's tilts (2), offsets (2) and, of a box, its turn.

    Args:
        by: derivatives by the ray's place and direction in the section: p1, p2, d1, d2.
        place, way: a point of each ray and its direction in the bar's frame.
    """
    (p0, p1, p2), (d0, d1, d2) = place, way
    moves = [-(by[0] * p0 + by[2] * d0), -(by[1] * p0 + by[3] * d0), -by[0], -by[1]]
    if section == "box":
        moves.append(by[0] * p2 - by[1] * p1 + by[2] * d2 - by[3] * d1)
    return moves


def _edge_slopes(
    p1: _Rows, p2: _Rows, d1: _Rows, d2: _Rows, side: _Rows, reach: _Rows, speed: _Rows,
    half1: Float[np.ndarray, "B 1"], half2: Float[np.ndarray, "B 1"], section: Section,
) -> tuple[tuple[_Rows, _Rows, _Rows, _Rows], list[_Rows]]:  # fmt: skip
    """Return derivatives of each ray's distance from the outline by p1, p2, d1, d2, and those by the half sizes."""
    sign, lean1, lean2 = np.sign(side), d1 / speed, d2 / speed
    by_way1, by_way2 = sign * (p2 - side * lean1), sign * (-p1 - side * lean2)
    by_half = [np.full_like(side, -1.0)]
    if section == "box":
        by_way1 -= np.sign(d1) * half2 - reach * lean1
        by_way2 -= np.sign(d2) * half1 - reach * lean2
        by_half = [-np.abs(lean2), -np.abs(lean1)]
    return (-sign * lean2, sign * lean1, by_way1 / speed, by_way2 / speed), by_half


def _box_entry(
    p1: _Rows, p2: _Rows, d1: _Rows, d2: _Rows, side: _Rows, reach: _Rows, speed: _Rows,
    half1: Float[np.ndarray, "B 1"], half2: Float[np.ndarray, "B 1"],
) -> tuple[_Rows, tuple[_Rows, _Rows, _Rows, _Rows], list[_Rows]]:  # fmt: skip
    """Return each ray's depth at the outline, its derivatives by p1, p2, d1, d2, and those by the half sizes."""
    excess = np.sign(side) * np.maximum(np.abs(side) - reach, 0.0) / speed
    q1, q2 = p1 + d2 * excess, p2 - d1 * excess
    s1, s2 = (np.where(np.abs(d) < 1e-4, np.copysign(1e-4, d), d) for d in (d1, d2))
    t1 = (-np.sign(s1) * half1 - q1) / s1
    t2 = (-np.sign(s2) * half2 - q2) / s2
    first = t1 > t2
    depth = np.where(first, t1, t2)
    nil = np.zeros_like(depth)
    inverse1, inverse2 = np.where(first, 1.0 / s1, nil), np.where(first, nil, 1.0 / s2)
    slopes = (-inverse1, -inverse2, -depth * inverse1, -depth * inverse2)
    return depth, slopes, [-np.abs(inverse1), -np.abs(inverse2)]


def _round_entry(
    p1: _Rows, p2: _Rows, d1: _Rows, d2: _Rows, side: _Rows, reach: _Rows, speed: _Rows
) -> tuple[_Rows, tuple[_Rows, _Rows, _Rows, _Rows], list[_Rows]]:
    """Return the same as :func:`_box_entry`, for a circle."""
    inside = np.minimum(np.abs(side), 0.98 * reach)
    chord = np.sqrt(reach**2 - inside**2)
    depth = -(p1 * d1 + p2 * d2) / speed**2 - chord / speed
    x1, x2 = p1 + depth * d1, p2 + depth * d2
    # Implicit derivative: the entry point stays on the circle, whose normal there is (x1, x2).
    slope = d1 * x1 + d2 * x2
    slope = np.where(np.abs(slope) < 1e-6, -1e-6, slope)
    slopes = (-x1 / slope, -x2 / slope, -depth * x1 / slope, -depth * x2 / slope)
    return depth, slopes, [reach / slope]
