"""How far the normal of a contact turns while no point of the hand's core moves by more than a distance.

Seen from the body, whose core ``B`` rests, the hand's core ``A`` becomes ``A'``, each point ``x`` some ``x'`` within
``e``.  Three bounds hold, of which the least counts:

- Any two convex cores, ``d`` apart: the shortest vector changes by at most ``sqrt(e (2 d + e))``.
- Over a flat face of ``B``: let ``h`` be the height above its plane, ``h0`` the least of ``A``.  The point with ``h0``
  stays over the face if it is over it by ``e``, and ends no higher than ``h0 + e``.  Points higher than ``h0 + 2 e``
  stay above that.  So if all points up to ``h0 + 2 e`` are over the face by ``e``, the shortest vector is along the
  face's normal.
- A rod across a round bar: away from their ends the shortest vector is square to both axes.  Seen along the bar, the
  rod's unit direction ``w`` has the length ``sin phi``, ``phi`` the angle between the axes.  It changes by
  ``c = 2 e / L`` at most, with the rod's length ``L``, so that the normal turns by at most ``arcsin(c / sin phi)``.
  Along the rod the contact moves by ``z = (e + D c / sin phi) / (sin phi - c)`` at most, with the distance ``D`` of the
  axes, and along the bar by ``e + z``; both have to be farther from all ends.

The normal at the pose is known up to the accuracy of coal's distances.  The first bound has that in ``e``; the others
add the angle to the face's or the axes' own normal.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from service.verify.forces.rounded import RoundedBody


def bound_turns(
    cores: Float[np.ndarray, "I K 3"],
    solid: RoundedBody,
    normals: Float[np.ndarray, "I 3"],
    apart: Float[np.ndarray, "I"],
    e: Float[np.ndarray, "I"],
) -> Float[np.ndarray, "I"]:
    """Bound the turn of a normal from each of several poses [rad].

    Args:
        cores: corners of the hand's core in the frame of the body's joint [m].
        solid: the body.
        normals: (I, 3) unit, from the hand's core to the body's.
        apart: their distances [m].
        e: largest displacements of a point of the hand's core [m].
    """
    change = np.sqrt(e * (2.0 * apart + e)) / apart
    turns = np.where(change < 1.0, np.arcsin(np.minimum(change, 1.0)), np.pi)
    near = np.flatnonzero(apart > e)
    if len(near):
        parts = cores[near], solid, normals[near], e[near]
        turns[near] = np.minimum(turns[near], np.minimum(_bound_over_faces(*parts), _bound_across_bar(*parts)))
    return np.asarray(turns)


def _bound_over_faces(
    cores: Float[np.ndarray, "I K 3"], solid: RoundedBody, normals: Float[np.ndarray, "I 3"], e: Float[np.ndarray, "I"]
) -> Float[np.ndarray, "I"]:
    """Return the angles between normals and the face's that they stay; half a turn where a core is over no face."""
    faces, turns = solid.list_faces(), np.full(len(cores), np.pi)
    if not len(faces):
        return turns
    nearest = (normals @ -faces[:, :3].T).argmax(axis=1)
    for index in np.unique(nearest):
        face = faces[index]
        heights = cores @ face[:3] + face[3]
        rows = np.flatnonzero((nearest == index) & (heights.min(axis=1) > e))
        if not len(rows):
            continue
        low = _clip_below(cores[rows], heights[rows], heights[rows].min(axis=1) + 2.0 * e[rows])
        inside = solid.measure_inside(low.reshape(-1, 3), face).reshape(low.shape[:2]).min(axis=1)
        rows = rows[inside >= e[rows]]
        turns[rows] = _measure_angles(normals[rows], -face[:3])
    return turns


def _clip_below(
    points: Float[np.ndarray, "I K 3"], heights: Float[np.ndarray, "I K"], limits: Float[np.ndarray, "I"]
) -> Float[np.ndarray, "I N 3"]:
    """Return points whose hull has all of a hull's that are no higher than a limit, some of them twice."""
    n = points.shape[1]
    lowest = np.take_along_axis(points, heights.argmin(axis=1)[:, None, None], axis=1)
    low = np.where((heights <= limits[:, None])[..., None], points, lowest)
    if n == 1:
        return low
    first, second = np.triu_indices(n, 1)
    rise = heights[:, second] - heights[:, first]
    share = (limits[:, None] - heights[:, first]) / np.where(rise == 0.0, np.inf, rise)
    crosses = (heights[:, first] <= limits[:, None]) != (heights[:, second] <= limits[:, None])
    between = points[:, first] + share[..., None] * (points[:, second] - points[:, first])
    return np.concatenate([low, np.where(crosses[..., None], between, lowest)], axis=1)


def _bound_across_bar(
    cores: Float[np.ndarray, "I K 3"], solid: RoundedBody, normals: Float[np.ndarray, "I 3"], e: Float[np.ndarray, "I"]
) -> Float[np.ndarray, "I"]:
    """Return the bounds of a rod across a round bar; half a turn where the core is no rod, or an end may be nearest."""
    bar, turns = solid.find_bar(), np.full(len(cores), np.pi)
    if bar is None or cores.shape[1] != 2:
        return turns
    middle, axis, half = bar
    length = np.linalg.norm(cores[:, 1] - cores[:, 0], axis=1)
    w = (cores[:, 1] - cores[:, 0]) / length[:, None]
    across = np.linalg.norm(np.cross(axis, w), axis=1)
    chord = 2.0 * e / length
    rows = np.flatnonzero(across > 2.0 * chord)
    w, across, chord, length, e = w[rows], across[rows], chord[rows], length[rows], e[rows]
    # Feet of the common perpendicular, from the middle of the bar and the first end of the rod.
    between, slant = cores[rows, 0] - middle, w @ axis
    on_rod = (slant * (between @ axis) - (w * between).sum(axis=1)) / across**2
    on_bar = between @ axis + slant * on_rod
    towards = on_bar[:, None] * axis - between - on_rod[:, None] * w
    moved = (e + np.linalg.norm(towards, axis=1) * chord / across) / (across - chord)
    holds = (np.minimum(on_rod, length - on_rod) >= moved) & (half - np.abs(on_bar) >= e + moved)
    angles = np.arcsin(chord / across) + _measure_angles(normals[rows], towards)
    turns[rows[holds]] = angles[holds]
    return turns


def _measure_angles(first: Float[np.ndarray, "I 3"], second: Float[np.ndarray, "*I 3"]) -> Float[np.ndarray, "I"]:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), (first * second).sum(axis=1)))


def measure_angle(first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"]) -> float:
    """Return the angle between two vectors [rad]."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()  # numpy's cross product takes ten times as long
    return math.atan2(math.hypot(b * z - c * y, c * x - a * z, a * y - b * x), a * x + b * y + c * z)
