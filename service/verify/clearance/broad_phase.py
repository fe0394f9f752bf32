"""Broad phase: bounding boxes and spheres of swept bodies prove most pairs clear without a distance query."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from costs.stopping import poll
from service.verify.clearance.pair_poses import ROUNDING_M, bound_chord_deviation
from service.verify.clearance.pairs import PairIntervals, PairTable
from service.verify.motion import VerifySettings
from service.verify.prepared_motion import Placements, PreparedMotion

# Intervals on which a body may leave its chords by more than this are split before all else [m],
_LEAVES_M = 0.04
# into at most 2^k parts.
_MOST_HALVINGS = 3


def refine_edges(
    prepared: PreparedMotion, table: PairTable, edges: Float[np.ndarray, "E"], phase: Int[np.ndarray, "E-1"]
) -> tuple[Float[np.ndarray, "I+1"], Int[np.ndarray, "I"]]:
    """Insert edges where bodies leave their chords far; return them with the phase of each interval."""
    poll()
    interval, body = (index.ravel() for index in np.indices((len(edges) - 1, table.n_bodies)))
    over, chains = prepared.over(edges[:-1], edges[1:]).take(interval), table.world_rows.take(body)
    leaving = chains.deviation(over).reshape(len(edges) - 1, table.n_bodies).max(axis=1, initial=0.0)
    # Halving an interval leaves a quarter of what its bodies leave their chords by.
    halvings = np.ceil(np.log2(np.maximum(leaving / _LEAVES_M, 1.0)) / 2.0)
    parts = 2 ** np.minimum(halvings, _MOST_HALVINGS).astype(int)
    part = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    fine = np.repeat(edges[:-1], parts) + part * np.repeat(np.diff(edges) / parts, parts)
    return np.append(fine, edges[-1]), np.repeat(phase, parts)


def bound_clearances(
    prepared: PreparedMotion, table: PairTable, edges: Float[np.ndarray, "I+1"], settings: VerifySettings
) -> Float[np.ndarray, "I C"]:
    """Return a lower bound of every pair's clearance on every interval between neighbouring edges [m].

    Bounds are taken in the world frame and may be negative.
    On an interval every point is near its chord, and along the chords the gaps
    of two boxes change linearly: an axis that separates them at both ends separates them between.
    """
    if len(table.mover) == 0:
        return np.empty((len(edges) - 1, 0))
    placed, rows = prepared.at(np.concatenate([edges, 0.5 * (edges[:-1] + edges[1:])]))
    ends, middles = rows[: len(edges)], rows[len(edges) :]
    leaving = _leaving(prepared, table, edges, placed, middles, settings)
    gap = _box_gaps(table, placed, ends)
    selves = np.flatnonzero(table.holder < table.n_bodies)
    gap[:, selves] = np.maximum(gap[:, selves], _sphere_gaps(table, selves, placed, ends))
    return np.asarray(gap - leaving[:, table.mover] - leaving[:, table.holder])


def find_open_intervals(
    table: PairTable,
    edges: Float[np.ndarray, "I+1"],
    phase: np.ndarray,
    floors: Float[np.ndarray, "I C"],
    horizon: float,
) -> PairIntervals:
    """Return pairs and intervals that the broad phase leaves open: nearer than the horizon, or touching if allowed.

    Pairs that are left out are open where they may touch.
    """
    may_touch = ~np.isnan(table.allowed[:, phase].T)
    near = np.where(table.is_left_out, ROUNDING_M, np.maximum(horizon, table.demanded + ROUNDING_M))
    # Negated, so that a floor that is NaN leaves its pair open.
    interval, pair = np.nonzero(~(floors >= np.where(may_touch, ROUNDING_M, near)))
    return PairIntervals.unknown(
        pair, edges[:-1][interval], edges[1:][interval], phase[interval], floors[interval, pair]
    )


def _leaving(
    prepared: PreparedMotion,
    table: PairTable,
    edges: Float[np.ndarray, "I+1"],
    placed: Placements,
    middles: Int[np.ndarray, "I"],
    settings: VerifySettings,
) -> Float[np.ndarray, "I S"]:
    """Bound the distance of the points of each solid from their chords in the world [m]."""
    poll()
    leaving = np.zeros((len(middles), len(table.solids)))
    interval, body = (index.ravel() for index in np.indices((len(middles), table.n_bodies)))
    over = prepared.over(edges[:-1], edges[1:])
    bounds = bound_chord_deviation(
        table, body, table.world_rows, body, over, interval, placed, middles[interval], settings
    )
    leaving[interval, body] = np.where(table.joint[body] > 0, bounds, 0.0)
    return leaving


def _box_gaps(table: PairTable, placed: Placements, ends: Int[np.ndarray, "I+1"]) -> Float[np.ndarray, "I C"]:
    """Return the gap between the bounding boxes of every pair, which change linearly along the chords [m]."""
    poll()
    low, high = np.empty((2, 3, len(ends), len(table.solids)))
    for k, solid in enumerate(table.solids):
        if solid.joint == 0:
            low[..., k], high[..., k] = solid.vertices.min(axis=0)[:, None], solid.vertices.max(axis=0)[:, None]
            continue
        along = (placed.rotation[ends, solid.joint].reshape(-1, 3) @ solid.vertices.T).reshape(len(ends), 3, -1)
        origin = placed.translation[ends, solid.joint]
        low[..., k], high[..., k] = (along.min(axis=2) + origin).T, (along.max(axis=2) + origin).T
    square = np.zeros((len(ends) - 1, len(table.mover)))
    for axis_low, axis_high in zip(low, high, strict=True):
        before = axis_low[:, table.holder] - axis_high[:, table.mover]
        behind = axis_low[:, table.mover] - axis_high[:, table.holder]
        apart = np.maximum(np.minimum(before[:-1], before[1:]), np.minimum(behind[:-1], behind[1:]))
        np.maximum(apart, 0.0, out=apart)
        square += apart * apart
    return np.sqrt(square)


def _sphere_gaps(
    table: PairTable, chosen: Int[np.ndarray, "K"], placed: Placements, ends: Int[np.ndarray, "I+1"]
) -> Float[np.ndarray, "I K"]:
    """Return the gap between the spheres of the chosen pairs, whose centres move along their chords [m]."""
    poll()
    at = ends[:, None], table.joint[: table.n_bodies]
    world = (placed.rotation[at] @ table.centre[..., None])[..., 0] + placed.translation[at]
    mover, holder = table.mover[chosen], table.holder[chosen]
    path = world[:, mover] - world[:, holder]
    step = np.diff(path, axis=0)
    length2 = np.maximum(np.einsum("ikx,ikx->ik", step, step), 1e-300)
    along = np.clip(-np.einsum("ikx,ikx->ik", path[:-1], step) / length2, 0.0, 1.0)
    nearest = path[:-1] + along[..., None] * step
    distance = np.sqrt(np.einsum("ikx,ikx->ik", nearest, nearest))
    return np.asarray(distance - table.radius[mover] - table.radius[holder])
