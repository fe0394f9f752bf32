"""Broad phase: bounding boxes and spheres of swept bodies prove most pairs clear without a distance query."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from service.verify.clearance import ROUNDING_M, Stretches, stretch_bounds
from service.verify.couples import Couples
from service.verify.forward import placements
from service.verify.motion import Motion
from service.verify.narrow import Solid
from service.verify.rates import intervals
from service.verify.settings import VerifySettings


def clearance_floors(
    motion: Motion, couples: Couples, edges: Float[np.ndarray, "I+1"], settings: VerifySettings
) -> Float[np.ndarray, "I C"]:
    """Lower bound of every pair's clearance on every stretch between neighbouring edges [m]; may be negative."""
    n_stretches, n_couples = len(edges) - 1, len(couples.mover)
    if n_couples == 0:
        return np.empty((n_stretches, 0))
    middle = 0.5 * (edges[:-1] + edges[1:])
    placed = placements(motion.robot.model, motion.curve(np.concatenate([edges, middle])))
    over = intervals(motion.curve, edges[:-1], edges[1:], motion.samples)
    rows = np.arange(n_stretches)
    floors = np.empty((n_stretches, n_couples))
    is_world = couples.holder >= couples.n_bodies
    pieces = couples.solids[couples.n_bodies :]
    piece_low = np.array([piece.vertices.min(axis=0) for piece in pieces]).reshape(-1, 3)
    piece_high = np.array([piece.vertices.max(axis=0) for piece in pieces]).reshape(-1, 3)
    for mover in np.unique(couples.mover[is_world]):
        columns = np.flatnonzero(is_world & (couples.mover == mover))
        bound = stretch_bounds(
            couples, np.full(n_stretches, columns[0]), over, placed, n_stretches + 1 + rows, settings
        )
        solid = couples.solids[mover]
        points = solid.vertices @ np.swapaxes(placed.rotation[: n_stretches + 1, solid.joint], -1, -2)
        low, high = _swept_box(points + placed.translation[: n_stretches + 1, None, solid.joint])
        held = couples.holder[columns] - couples.n_bodies
        gap = np.maximum(piece_low[held] - high[:, None], low[:, None] - piece_high[held])
        floors[:, columns] = np.linalg.norm(np.maximum(gap, 0.0), axis=2) - bound[:, None]
    bounds: dict[int, np.ndarray] = {}
    for couple in np.flatnonzero(~is_world).tolist():
        mover, holder = couples.solids[couples.mover[couple]], couples.solids[couples.holder[couple]]
        key = id(couples.chains[couple])
        if key not in bounds:
            same = np.full(n_stretches, couple)
            bounds[key] = stretch_bounds(couples, same, over, placed, n_stretches + 1 + rows, settings)
        bound = bounds[key]
        rotation, translation = placed.relative(holder.joint, mover.joint, slice(0, n_stretches + 1))
        floors[:, couple] = (
            _self_gap(mover, holder, rotation, translation, bound + settings.clearance_horizon_m) - bound
        )
    return floors


def open_stretches(
    couples: Couples,
    edges: Float[np.ndarray, "I+1"],
    phase: np.ndarray,
    floors: Float[np.ndarray, "I C"],
    horizon: float,
) -> Stretches:
    """Pairs and stretches that the broad phase leaves open: nearer than the horizon, or perhaps touching if allowed."""
    may_touch = ~np.isnan(couples.allowed[:, phase].T)
    # Negated, so that a floor that is NaN leaves its pair open.
    stretch, couple = np.nonzero(~(floors >= np.where(may_touch, ROUNDING_M, horizon)))
    return Stretches(couple, edges[:-1][stretch], edges[1:][stretch], phase[stretch], floors[stretch, couple])


def _swept_box(points: Float[np.ndarray, "S V 3"]) -> tuple[Float[np.ndarray, "I 3"], Float[np.ndarray, "I 3"]]:
    low, high = points.min(axis=1), points.max(axis=1)
    return np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])


def _self_gap(
    mover: Solid,
    holder: Solid,
    rotation: Float[np.ndarray, "S 3 3"],
    translation: Float[np.ndarray, "S 3"],
    wanted: Float[np.ndarray, "I"],
) -> Float[np.ndarray, "I"]:
    """Gap between the mover's swept hull and the holder: of spheres, of boxes where that is less than wanted [m]."""
    centre, radius = mover.sphere
    held_centre, held_radius = holder.sphere
    path = rotation @ centre + translation - held_centre
    step = np.diff(path, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-300)
    along = np.clip(-(path[:-1] * step).sum(axis=1) / length2, 0.0, 1.0)
    gap = np.linalg.norm(path[:-1] + along[:, None] * step, axis=1) - radius - held_radius
    close = np.flatnonzero(gap < wanted)
    if len(close):
        ends = np.stack([close, close + 1], axis=1)
        points = mover.vertices @ np.swapaxes(rotation[ends], -1, -2) + translation[ends][:, :, None]
        low, high = points.min(axis=(1, 2)), points.max(axis=(1, 2))
        apart = np.maximum(holder.vertices.min(axis=0) - high, low - holder.vertices.max(axis=0))
        gap[close] = np.maximum(gap[close], np.linalg.norm(np.maximum(apart, 0.0), axis=1))
    return np.asarray(gap)
