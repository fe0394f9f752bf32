"""Unseen space, behind and inside objects, as a small number of convex pieces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import HalfspaceIntersection, cKDTree

from costs.scene import ConvexPiece
from costs.stopping import poll
from perception.cleaning.clean import Reach, inside_hulls
from perception.convex.freespace import FreeSpace, carve
from perception.convex.hulls import MAX_VERTICES, Hull, make_hull

_CELL = 0.05
_MOST_CELLS = 1_500_000
_MOST_PIECES = 150
_MOST_FACES = 45
_DRAWN_IN = 0.7
_LEVEL = 1e-9
_FARTHEST = 6.0
_MOST_TRIES = 2_000
_LEAST_GAIN = 0.008
_CLEARANCE = 0.1
_OVER_SOLE = 0.15
_AT_SURFACE = 3.0  # cells from a measured point, whose surface is no end of what is seen
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


class Level(Protocol):
    """Height functions of a floor level that unseen space needs."""

    def height(self, xy: Float[np.ndarray, "N 2"], /) -> Float[np.ndarray, "N"]:
        """World z of the level at the given x and y [m]."""
        ...

    def above(self, points: Float[np.ndarray, "N 3"], /) -> Float[np.ndarray, "N"]:
        """Signed distance of points above the level [m]."""
        ...


def make_unknown_pieces(
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    reach: Reach,
    floors: Sequence[Level],
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
    soles: Sequence[Float[np.ndarray, "S 3"]] = (),
) -> tuple[ConvexPiece, ...]:
    """Return pieces ``unknown/i`` of the space in reach, above the floor, and more than a cell (5 cm) from every ray.

    The pieces contain no seen space.  Shadows narrower than three cells and the space within 10 cm of the robot are
    left out.

    Args:
        floors: levels; space below all of them is left out.
        soles: corners (S, 3) of each planted sole; the space just above it is left out [m].
    """
    over_soles = [
        np.asarray(sole) + np.array([0.0, 0.0, height]) for sole in soles for height in (-_CLEARANCE, _OVER_SOLE)
    ]
    own = [*robot_hulls, *(np.concatenate(over_soles[i : i + 2]) for i in range(0, len(over_soles), 2))]
    hidden, seen = _find_hidden(rays, reach, floors, own)
    return tuple(
        ConvexPiece(f"unknown/{i}", vertices, kind="unknown") for i, vertices in enumerate(_make_bodies(hidden, seen))
    )


def list_unseen(
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    points: Float[np.ndarray, "N 3"],
    reach: Reach,
    floors: Sequence[Level],
    robot_hulls: Sequence[Float[np.ndarray, "V 3"]] = (),
) -> Float[np.ndarray, "K 3"]:
    """Return where seen space ends without a surface: centres of unseen cells beside seen ones, off every point [m].

    Args:
        points: measured points, whose surfaces end seen space, too.
        floors: levels; space below all of them is left out.
        robot_hulls: (V, 3) vertices of the robot's links; the space within 10 cm of them is left out.
    """
    hidden, seen = _find_hidden(rays, reach, floors, robot_hulls)
    rim = hidden & ndimage.binary_dilation(seen.free)
    centres = np.asarray((np.argwhere(rim) + 0.5) * seen.size + seen.lower)
    if not len(points) or not len(centres):
        return centres
    distances, _ = cKDTree(points).query(centres, distance_upper_bound=_AT_SURFACE * seen.size)
    return np.asarray(centres[~np.isfinite(distances)])


def _find_hidden(
    rays: tuple[Float[np.ndarray, "*R 3"], Float[np.ndarray, "R 3"]],
    reach: Reach,
    floors: Sequence[Level],
    own: Sequence[Float[np.ndarray, "V 3"]],
) -> tuple[Bool[np.ndarray, "X Y Z"], FreeSpace]:
    """Return the unknown cells, and the cells that no piece may cover (seen or near the robot)."""
    lower = np.array([reach.x - reach.radius, reach.y - reach.radius, reach.bottom])
    upper = np.array([reach.x + reach.radius, reach.y + reach.radius, reach.top])
    rim = np.array([[x, y] for x in (lower[0], upper[0]) for y in (lower[1], upper[1])])
    if floors:
        lower[2] = max(lower[2], min(float(floor.height(rim).min()) for floor in floors))
    size = max(_CELL, float(np.cbrt(np.prod(upper - lower) / _MOST_CELLS)))
    passed = carve(*rays, np.zeros((0, 3)), lower, upper, size)
    # One more cell on all sides: marching misses cells that a ray only grazes.
    free = ndimage.binary_dilation(passed.free, structure=np.ones((3, 3, 3), dtype=bool))
    centres = (np.argwhere(~free) + 0.5) * passed.size + lower
    known = ~reach.contains(centres) | inside_hulls(centres, own, _CLEARANCE)
    if floors:
        known |= np.all([floor.above(centres) < 0.0 for floor in floors], axis=0)
    hidden = ~free
    hidden[hidden] = ~known
    avoided = free.copy()
    avoided[~free] = inside_hulls(centres, own, _CLEARANCE)
    return hidden, FreeSpace(lower, passed.size, avoided)


def _make_bodies(hidden: Bool[np.ndarray, "X Y Z"], seen: FreeSpace) -> list[Float[np.ndarray, "V 3"]]:
    """Return convex bodies (V, 3) in the hidden cells, thickest first; they may overlap [m]."""
    # The largest hidden cube around a cell has an edge of 2 d - 1 cells.
    poll()
    depth = ndimage.distance_transform_cdt(np.pad(hidden, 1), metric="chessboard")[1:-1, 1:-1, 1:-1].astype(np.int64)
    score = np.where(depth >= 2, depth, 0)
    left = hidden.copy()
    border = seen.free & ndimage.binary_dilation(~seen.free)
    walls = (np.argwhere(border) + 0.5) * seen.size + seen.lower
    bodies: list[Float[np.ndarray, "V 3"]] = []
    for _ in range(_MOST_TRIES):
        at = np.array(np.unravel_index(int(np.argmax(score)), score.shape))
        if len(bodies) == _MOST_PIECES or score[tuple(at)] == 0:
            break
        first, last = _grow_box(hidden, at - depth[tuple(at)] + 1, at + depth[tuple(at)] - 1)
        box = seen.lower + seen.size * np.where(_CORNERS == 0, first, last + 1)
        body = _inflate(make_hull(box), walls, seen)
        block, inside = _find_cells(body, seen)
        if (left[block] & inside).sum() * seen.size**3 >= _LEAST_GAIN:
            bodies.append(body.vertices)
            left[block] &= ~inside
            score[block][inside] = 0
        score[tuple(at)] = 0
    return bodies


def _inflate(box: Hull, walls: Float[np.ndarray, "W 3"], seen: FreeSpace) -> Hull:
    """Return a polytope around the box's inscribed ellipsoid without wall cell centres; the box if there is none.

    The nearest wall cell, in the ellipsoid's metric, gives a face; cells beyond that face are dropped, and so on: the
    inflation step of Deits and Tedrake, WAFR 2014, with a given ellipsoid.
    """
    poll()
    centre, half = 0.5 * (box.lower + box.upper), 0.5 * (box.upper - box.lower)
    lower, upper = seen.lower, seen.lower + seen.size * np.array(seen.free.shape)
    scaled = (walls - centre) / half
    ahead = np.concatenate([(upper - centre) / half, (centre - lower) / half])
    normals, offsets = [*np.eye(3), *-np.eye(3)], list(ahead)
    # Farther wall cells do not count: six faces bound the polytope there.
    scaled = scaled[(np.abs(scaled) <= _FARTHEST).all(axis=1)]
    normals += [*np.eye(3), *-np.eye(3)]
    offsets += [_FARTHEST] * 6
    while len(scaled) and len(normals) < _MOST_FACES:
        distance = np.einsum("wi,wi->w", scaled, scaled)
        nearest = int(np.argmin(distance))
        length = float(np.sqrt(distance[nearest]))
        normal = scaled[nearest] / length
        # Moved inwards by most of a cell, so that one face serves all cells along an oblique border.
        offset = length - _DRAWN_IN * seen.size * float(np.linalg.norm(normal / half))
        normals.append(normal)
        offsets.append(offset)
        scaled = scaled[scaled @ normal < offset]
    if len(scaled):
        return box
    faces = np.column_stack([np.array(normals), -np.array(offsets)])
    corners = HalfspaceIntersection(faces, np.zeros(3)).intersections
    body = make_hull(centre + half * corners, box.members)
    is_fit = len(body.vertices) <= MAX_VERTICES and seen.count_inside(body, 0, margin=0.0) == 0
    return body if is_fit else box


def _find_cells(body: Hull, seen: FreeSpace) -> tuple[tuple[slice, ...], Bool[np.ndarray, "A B C"]]:
    """Return a block of the grid and a mask of the cells in it whose centre is in the body."""
    poll()
    first = np.maximum(np.floor((body.lower - seen.lower) / seen.size).astype(int), 0)
    last = np.minimum(np.ceil((body.upper - seen.lower) / seen.size).astype(int), seen.free.shape)
    x, y, z = (seen.lower[i] + (np.arange(first[i], last[i]) + 0.5) * seen.size for i in range(3))
    # Heights at which each vertical column of cells enters and leaves the body.
    low, high = np.full((len(x), len(y)), -np.inf), np.full((len(x), len(y)), np.inf)
    for nx, ny, nz, offset in body.faces:
        rest = nx * x[:, None] + ny * y + offset
        if nz > _LEVEL:
            np.minimum(high, -rest / nz, out=high)
        elif nz < -_LEVEL:
            np.maximum(low, -rest / nz, out=low)
        else:
            high[rest > _LEVEL] = -np.inf
    mask = (z >= low[:, :, None] - _LEVEL) & (z <= high[:, :, None] + _LEVEL)
    return tuple(slice(a, b) for a, b in zip(first, last, strict=True)), mask


def _grow_box(
    hidden: Bool[np.ndarray, "X Y Z"], first: Int[np.ndarray, "3"], last: Int[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"]]:
    """Grow a box of cells on all sides, one layer at a time, while the layer is hidden; return its first and last."""
    poll()
    first, last = first.copy(), last.copy()
    growing = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
    while growing:
        for axis, sign in list(growing):
            at = first[axis] - 1 if sign < 0 else last[axis] + 1
            layer = [slice(a, b + 1) for a, b in zip(first, last, strict=True)]
            layer[axis] = slice(at, at + 1)
            if 0 <= at < hidden.shape[axis] and hidden[tuple(layer)].all():
                (first if sign < 0 else last)[axis] = at
            else:
                growing.remove((axis, sign))
    return first, last
