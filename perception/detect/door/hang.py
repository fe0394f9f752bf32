"""Hinge edge and free edge of a leaf, from its own edges, its wall and the opening in it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.door.edges import Edge
from perception.detect.door.frame import Frame
from perception.detect.door.leaf import Leaf
from perception.detect.door.profile import BAND, Rays
from perception.detect.door.upright import Upright

GAP = 0.004
_REVEAL = 0.008  # usual distance of a casing from the leaf
_STEP_REACH = 0.03
# From a leaf's edge to the step to its casing as it is seen: gap and reveal, less half of the step's own width.
_TO_CASING = 0.004
_CASING = (0.006, 0.05)  # height of a casing over a leaf flush with the wall
_RECESSED = 0.025
_FLUSH = 0.012
_ASIDE = 0.07
_CLEAR = 0.03
_FEWEST = 8
_FEWEST_ON_SIDE = 15
_SCATTER = 0.01
_WIDE_GAP, _OPEN_GAP = 0.015, 0.25
_OFF_WALL, _BEFORE_LEAF = 0.015, 0.6
_MOST_ON_WALL = 0.04
_FARTHEST = 0.08
_SIGMA_CASING, _SIGMA_FLUSH = 0.008, 0.002
_LEAST_STEEP = np.radians(5.0)


def find_ends(
    leaf: Leaf, frame: Frame | None, hinge: int, rays: Rays, ground: float, thickness: float
) -> tuple[float, float]:
    """Return the positions of the leaf's hinge edge and free edge along its plane [m].

    Args:
        hinge: side of the hinges, -1 low or 1 high.
        thickness: of the leaf [m].
    """
    edges = (leaf.low, leaf.high) if hinge < 0 else (leaf.high, leaf.low)
    at, free = edges[0].at, edges[1].at
    if frame is None:
        return at, free
    is_ajar = frame.hinge != 0
    if frame.opens_away or (not is_ajar and frame.depth > _RECESSED):
        return _ends_in_opening(leaf, frame, hinge, rays, ground, thickness if is_ajar else 0.0)
    if not is_ajar:
        ends = [
            _inside_casing(leaf, edge, side, rays, ground) if _CASING[0] < edge.jump < _CASING[1] else edge.at
            for edge, side in zip(edges, (hinge, -hinge), strict=True)
        ]
        return ends[0], ends[1]
    seen = find_step(leaf.plane, rays, free, -hinge, ground, 2.5 * leaf.rms)
    return _hinge_in_wall(leaf, frame, at, hinge), free if np.isnan(seen) else seen


def _inside_casing(leaf: Leaf, edge: Edge, side: int, rays: Rays, ground: float) -> float:
    """Return the usual end of a leaf inside of its casing, whose step is fitted by least squares [m].

    Args:
        side: direction along the plane out of the face, -1 or 1.
    """
    local = leaf.plane.local(rays.ends)
    place = (local[:, 0] - edge.at) * side
    mine = (np.abs(place) < _STEP_REACH) & (np.abs(local[:, 2]) < _CASING[1])
    mine &= (local[:, 1] > ground + BAND[0]) & (local[:, 1] < ground + BAND[1])
    order = np.argsort(place[mine], kind="stable")
    place, out = place[mine][order], local[mine, 2][order]
    if len(out) < 2 * _FEWEST:
        return edge.at - side * _REVEAL
    # The sum of squares that a step at each point explains: the face is at zero, the casing at its own mean.
    beyond = np.cumsum(out[::-1])[::-1]
    explained = np.where(beyond > 0.0, beyond**2 / np.arange(len(out), 0, -1), 0.0)[_FEWEST:-_FEWEST]
    return edge.at + side * (float(place[_FEWEST + int(np.argmax(explained))]) - _REVEAL)


def _hinge_in_wall(leaf: Leaf, frame: Frame, at: float, hinge: int) -> float:
    """Return the position of the hinge edge of a leaf that opens towards the sensor [m].

    A casing continues the leaf beyond its edge.  Where the leaf, when shut, is flush with the wall, its face meets the
    wall's face at the hinge.
    """
    usual = at - hinge * _TO_CASING
    wall = frame.plane.local(np.stack([leaf.plane.place(usual), leaf.plane.place(usual - hinge * 0.1)]))[:, 2]
    rise = float(wall[1] - wall[0]) / 0.1
    if frame.ajar < _LEAST_STEEP:
        return usual
    shift = float(wall[0]) / rise
    # A hinge edge behind the wall's face may stand back in its frame; one before it was cut off too early.
    if not -_FLUSH / abs(rise) < shift < _FARTHEST:
        return usual
    # Weights by the variances: where the edge was seen, and by how much the shut leaf is not flush.
    weight = (max(_SIGMA_CASING, 0.5 * shift) / _SIGMA_FLUSH * rise) ** 2
    return float(usual + hinge * shift * weight / (1.0 + weight))


def _ends_in_opening(
    leaf: Leaf, frame: Frame, hinge: int, rays: Rays, ground: float, behind: float
) -> tuple[float, float]:
    """Return the ends of a leaf behind its wall's face, from the jambs that limit the opening [m].

    Args:
        behind: distance of the hinge axis behind the leaf's face [m].
    """
    edges = (leaf.low, leaf.high) if hinge < 0 else (leaf.high, leaf.low)
    ends = [_own_edge(leaf, frame, edge, side, rays, ground) for edge, side in zip(edges, (hinge, -hinge), strict=True)]
    places = np.stack([leaf.plane.place(edge.at, 0.0, -behind) for edge in edges])
    wall = frame.plane.local(places)[:, 0]
    outwards = 1 if wall[0] > wall[1] else -1
    depth = max(frame.depth, 0.0)
    hinge_jamb = _find_jamb(frame.plane, rays, float(wall[0]), outwards, ground, depth)
    if np.isnan(hinge_jamb):
        return edges[0].at, edges[1].at
    # Along the leaf per length along the wall.
    scale = (edges[1].at - edges[0].at) / float(wall[1] - wall[0])
    at = _choose(edges[0].at + scale * (hinge_jamb - outwards * GAP - float(wall[0])), ends[0])
    near = float(wall[0]) + (at - edges[0].at) / scale - outwards * leaf.width
    free_jamb = _find_jamb(frame.plane, rays, near, -outwards, ground, depth)
    if np.isnan(free_jamb):
        return at, edges[1].at
    width = abs(free_jamb - near - outwards * leaf.width) - GAP
    return at, _choose(at - hinge * width, ends[1])


def _own_edge(leaf: Leaf, frame: Frame, edge: Edge, side: int, rays: Rays, ground: float) -> float:
    """Return the end of a shut leaf beside which rays went on [m]; NaN where its jamb limits what is seen."""
    if frame.hinge or edge.open_share < _OPEN_GAP:
        return float("nan")
    return find_step(leaf.plane, rays, edge.at, side, ground, 2.5 * leaf.rms)


def _choose(by_jamb: float, own: float) -> float:
    """Return the end by the jamb, or the leaf's own where it was seen well inside of that."""
    return own if abs(own - by_jamb) > _WIDE_GAP else by_jamb


def _find_jamb(plane: Upright, rays: Rays, near: float, outwards: int, ground: float, depth: float) -> float:
    """Return the position along a wall of an opening's jamb near ``near`` [m]; NaN where it was not seen.

    Args:
        outwards: direction along the wall out of the opening, -1 or 1.
        depth: of the leaf behind the wall [m].
    """
    level = -min(_CLEAR, 0.5 * depth)
    # From inside of the opening the jamb's side is seen: what lies behind the wall's face ends there.
    sees_side = (float(np.median(rays.starts @ plane.along)) - near) * outwards < 0.0
    step = find_step(plane, rays, near, outwards, ground, level, is_wall=True, by_end=sees_side)
    if not sees_side:
        return step
    # In a deep opening the points on that side alone show it best.
    local = plane.local(rays.ends)
    on_side = (local[:, 2] < -_OFF_WALL) & (local[:, 2] > -_BEFORE_LEAF * depth) & (np.abs(local[:, 0] - near) < _ASIDE)
    on_side &= (local[:, 1] > ground + BAND[0]) & (local[:, 1] < ground + BAND[1])
    if on_side.sum() < _FEWEST_ON_SIDE:
        return step
    middle = float(np.median(local[on_side, 0]))
    is_side = 1.4826 * float(np.median(np.abs(local[on_side, 0] - middle))) < _SCATTER
    return middle if is_side else step


def find_step(
    plane: Upright,
    rays: Rays,
    near: float,
    outwards: int,
    ground: float,
    limit: float,
    *,
    is_wall: bool = False,
    by_end: bool = False,
) -> float:
    """Return the position along a plane, near ``near``, where rays change from ending on it to passing it [m].

    NaN where too few rays show it.

    Args:
        outwards: direction along the plane out of the face, or out of the opening in a wall, -1 or 1.
        limit: rays that end further behind the plane pass it; of a wall, the height of its face over that end [m].
        is_wall: whether the plane lies outside of the step, not inside.
        by_end: whether rays are placed by their ends; else by their crossing with the plane.
    """
    at, out, heading = rays.crossing(plane)
    if by_end:
        at = plane.local(rays.ends)[:, :2]
    mine = heading & (np.abs(at[:, 0] - near) < _ASIDE) & (out < _MOST_ON_WALL)
    mine &= (at[:, 1] > ground + BAND[0]) & (at[:, 1] < ground + BAND[1])
    on = out[mine] > (limit if is_wall else -limit)
    if min(on.sum(), (~on).sum()) < _FEWEST:
        return float("nan")
    place = (at[mine, 0] - near) * outwards
    order = np.argsort(place, kind="stable")
    place, inside = place[order], (on ^ is_wall)[order]
    total = np.cumsum(np.where(inside, 1.0, -1.0))
    best = int(np.argmax(total))
    if best + 1 >= len(place) or best == 0:
        return float("nan")
    return near + outwards * float(_middle(place, total, best))


def _middle(place: Float[np.ndarray, "K"], total: Float[np.ndarray, "K"], best: int) -> float:
    """Return the middle of the stretch over which the step is about equally likely."""
    likely = np.flatnonzero(total > total[best] - 0.5)
    return 0.5 * float(place[likely[0]] + place[min(likely[-1] + 1, len(place) - 1)])
