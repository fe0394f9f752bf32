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

import numpy as np
from jaxtyping import Float

from service.verify.forces.rounded import RoundedBody


def bound_turn(
    core: Float[np.ndarray, "K 3"], solid: RoundedBody, normal: Float[np.ndarray, "3"], apart: float, e: float
) -> float:
    """Bound the turn of a normal [rad].

    Args:
        core: corners of the hand's core in the frame of the body's joint [m].
        solid: the body.
        normal: (3,) unit, from the hand's core to the body's.
        apart: their distance [m].
        e: largest displacement of a point of the hand's core [m].
    """
    change = np.sqrt(e * (2.0 * apart + e)) / apart
    turn = float(np.arcsin(change)) if change < 1.0 else np.pi
    if apart <= e:
        return turn
    return min(turn, _bound_over_face(core, solid, normal, e), _bound_across_bar(core, solid, normal, e))


def _bound_over_face(
    core: Float[np.ndarray, "K 3"], solid: RoundedBody, normal: Float[np.ndarray, "3"], e: float
) -> float:
    """Return the angle between a normal and the face's that it stays; half a turn where the core is over no face."""
    faces = solid.list_faces()
    if not len(faces):
        return np.pi
    face = faces[int((faces[:, :3] @ -normal).argmax())]
    heights = core @ face[:3] + face[3]
    if heights.min() <= e:
        return np.pi
    low = _clip_below(core, heights, float(heights.min()) + 2.0 * e)
    if solid.measure_inside(low, face).min() < e:
        return np.pi
    return _measure_angle(normal, -face[:3])


def _clip_below(
    points: Float[np.ndarray, "K 3"], heights: Float[np.ndarray, "K"], limit: float
) -> Float[np.ndarray, "N 3"]:
    """Return points whose hull has all of a hull's that are no higher than a limit."""
    is_low = heights <= limit
    low, high = points[is_low], points[~is_low]
    share = (limit - heights[is_low][:, None]) / (heights[~is_low] - heights[is_low][:, None])
    crossings = low[:, None] + share[..., None] * (high - low[:, None])
    return np.concatenate([low, crossings.reshape(-1, 3)])


def _bound_across_bar(
    core: Float[np.ndarray, "K 3"], solid: RoundedBody, normal: Float[np.ndarray, "3"], e: float
) -> float:
    """Return the bound of a rod across a round bar; half a turn where the core is no rod, or an end may be nearest."""
    bar = solid.find_bar()
    if bar is None or len(core) != 2:
        return np.pi
    middle, axis, half = bar
    length = float(np.linalg.norm(core[1] - core[0]))
    w = (core[1] - core[0]) / length
    across = float(np.linalg.norm(np.cross(axis, w)))
    chord = 2.0 * e / length
    if across <= 2.0 * chord:
        return np.pi
    # Feet of the common perpendicular, from the middle of the bar and the first end of the rod.
    between, slant = core[0] - middle, float(axis @ w)
    on_rod = (slant * float(axis @ between) - float(w @ between)) / across**2
    on_bar = float(axis @ between) + slant * on_rod
    towards = on_bar * axis - between - on_rod * w
    distance = float(np.linalg.norm(towards))
    moved = (e + distance * chord / across) / (across - chord)
    if min(on_rod, length - on_rod) < moved or half - abs(on_bar) < e + moved:
        return np.pi
    return float(np.arcsin(chord / across)) + _measure_angle(normal, towards)


def _measure_angle(first: Float[np.ndarray, "3"], second: Float[np.ndarray, "3"]) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))
