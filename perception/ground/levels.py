"""Search for the floor levels of a scan (ground, ramps, steps), the level under the robot, and their extents."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import nearest
from perception.ground.extent import convex_patches, pierced_cells
from perception.ground.floor import FloorPlane
from perception.ground.outlines import is_unbroken, outlines_of
from perception.ground.patches import MAX_SLOPE_DEG, PATCH, Patches, candidates, least_squares, patches_of, plane_of

_BAND = 0.025
_AROUND = np.ones((3, 3), dtype=bool)
_CELL = 0.1
_SAME_WAY_DEG = 5.0
_LARGE = 0.25
_SMALL = 0.12
_TRIES = 24
_ALIKE = 0.7
_MOST_BELOW = 0.05
_NEAREST = 0.05
# Thickest slab whose underside may be seen [m], and share of an underside that is under its top.
_SLAB, _BOTH_SEEN = 0.08, 0.6
# Points of a top against those of its underside.
_OF_TOP = 0.3
_MOST_BEFORE = 0.2
_HIGHEST = 0.4
_STEP = 0.36
_GAP = 0.35
_AS_NEAR = 0.5
_FOOTHOLD = 0.3
_GOES_ON = 0.35
_LEVEL_DEG = 2.0
_NO_WORSE = 1.1
_FEWEST_POINTS = 50
_MOST_POINTS = 80_000
_UPRIGHT_SHARE = 0.06
_ROUGH = 0.0125
_ROUGHER = 1.3


@dataclass(frozen=True)
class _Level:
    """A plane, its seen ``cells`` (C, 2) in a 10 cm grid of the world, and the indices ``members`` (K,) of its points.

    Ground below the robot's level (``is_ground_below``) counts even if objects break it into parts.
    """

    plane: FloorPlane
    cells: Int[np.ndarray, "C 2"]
    members: Int[np.ndarray, "K"]
    is_ground_below: bool = False

    @property
    def places(self) -> Float[np.ndarray, "C 3"]:
        """Centres (C, 3) of the cells, on the plane [m]."""
        xy = (self.cells + 0.5) * _CELL
        return np.column_stack([xy, self.plane.height(xy)])


def find_floors(
    points: Float[np.ndarray, "N 3"],
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]] | None = None,
    *,
    stand: Float[np.ndarray, "3"] | None = None,
    extent: float = 4.0,
    seed: int = 0,
) -> tuple[FloorPlane, ...]:
    """Return floor levels that slope by at most 15 degrees and are connected by steps, the one under the robot first.

    A plane higher than 0.4 m above the robot's feet, or with objects under it, is a table and not a floor.  Treads,
    ramps and platforms must be reached by steps of at most 36 cm from level to level; large ground below counts at
    any depth.

    Args:
        points: (N, 3) points in reach, without those on the robot [m].
        stand: (3,) position of the robot's feet, the world's origin by default [m].
        extent: half side of the square around ``stand`` in which rays can cut the first level [m].

    Returns:
        The first level has no outlines if no ray went through it; all others have outlines.
    """
    stand = np.zeros(3) if stand is None else stand
    if len(points) < _FEWEST_POINTS:
        return ()
    points = points[:: -(-len(points) // _MOST_POINTS)]
    patches = patches_of(points)
    found = list(_levels(points, patches, np.random.default_rng(seed)))
    levels = _drop_undersides([_raise_to_top(points, level) for level in found])
    main = _under_robot(points, levels, stand)
    if main is None:
        return ()
    kept = [main, *_reach(points, main, [level for level in levels if level is not main])]
    first = main.plane if rays is None else _bound(points, main, rays, stand, extent)
    return (first, *(_outline(points, level, rays) for level in kept[1:]))


def _raise_to_top(points: Float[np.ndarray, "N 3"], level: _Level) -> _Level:
    """Return the top of the slab whose underside a level is; the level itself if there is no such layer above it."""
    above = level.plane.above(points)
    members = np.flatnonzero((above > _BAND) & (above <= _SLAB))
    if len(members) < _OF_TOP * len(level.members):
        return level
    cells = np.unique(np.floor(points[members, :2] / _CELL).astype(int), axis=0)
    normal, offset = plane_of(points[members])
    rms = float(np.std(points[members] @ normal - offset))
    plane = FloorPlane(normal, offset, rms, float(len(cells) * _CELL**2))
    top = _Level(plane, cells, members)
    is_flat = rms < _ROUGH / 2 and normal[2] >= np.cos(np.radians(MAX_SLOPE_DEG))
    return top if is_flat and _is_underside(level, top) else level


def _drop_undersides(levels: list[_Level]) -> list[_Level]:
    """Return the levels without those that lie close below another one where that is seen, too.

    No ray from above reaches them: a merged map shows a slab from both sides.
    """
    return [level for level in levels if not any(_is_underside(level, other) for other in levels)]


def _is_underside(level: _Level, other: _Level) -> bool:
    depth = other.plane.height(level.places[:, :2]) - level.places[:, 2]
    if level is other or not _BAND < float(np.median(depth)) <= _SLAB:
        return False
    above = {tuple(cell) for cell in other.cells.tolist()}
    shared = sum(tuple(cell) in above for cell in level.cells.tolist())
    return shared > _BOTH_SEEN * len(level.cells)


def _levels(points: Float[np.ndarray, "N 3"], patches: Patches, rng: np.random.Generator) -> Iterator[_Level]:
    """Yield planes through the patches, the largest first, each without the points of earlier ones."""
    poll()
    free = patches.is_upright | patches.is_bare
    normals, offsets = candidates(patches, rng)
    if not len(normals):
        return
    ground = np.flatnonzero(free)
    # Patches near the plane weigh more than those at the band's border, or a plane between two low steps would win.
    near = 1.0 - ((patches.centre[ground] @ normals.T - offsets) / _BAND) ** 2
    np.maximum(near, 0.0, out=near)
    weight = np.where(patches.is_upright[ground], 1.0, 0.3)
    whole = weight @ near
    for _ in range(_TRIES):
        score = (weight * free[ground]) @ near
        best = int(np.argmax(score))
        if score[best] * PATCH**2 < 0.4 * _SMALL:
            return
        fitted = _fit(points, patches, free, normals[best], float(offsets[best]))
        level = None if fitted is None else _find_parts(points, patches, *fitted)
        if level is not None:
            free[patches.of_point[level.members]] = False
            yield level
        # Whether accepted or not, similar candidates give no new level.
        shared = np.flatnonzero(near[:, best] > 0.0)
        unlike = weight[shared] @ near[shared] <= _ALIKE * whole
        if not unlike.any():
            return
        near, normals, offsets, whole = near[:, unlike], normals[unlike], offsets[unlike], whole[unlike]


def _fit(
    points: Float[np.ndarray, "N 3"],
    patches: Patches,
    free: Bool[np.ndarray, "P"],
    normal: Float[np.ndarray, "3"],
    offset: float,
) -> tuple[Float[np.ndarray, "3"], float, Int[np.ndarray, "K"]] | None:
    """Return the better of two least-squares planes (normal, offset) near a candidate, and its inliers' indices."""
    poll()
    beside = np.abs(patches.centre @ normal - offset) < 2 * _BAND + PATCH
    usable = np.flatnonzero((free & beside)[patches.of_point])
    mine = points[usable]
    best: tuple[float, Float[np.ndarray, "3"], float] | None = None
    # A rough candidate needs a wide band first; in that band, an exact one would be biased by the next step.
    for bands in ((2 * _BAND, _BAND, _BAND), (0.8 * _BAND, 0.8 * _BAND)):
        plane = least_squares(mine, normal, offset, bands)
        if plane is not None and plane[0][2] >= np.cos(np.radians(MAX_SLOPE_DEG)):
            score = float(np.maximum(1.0 - ((mine @ plane[0] - plane[1]) / _BAND) ** 2, 0.0).sum())
            best = (score, *plane) if best is None or score > best[0] else best
    if best is None:
        return None
    return best[1], best[2], usable[np.abs(mine @ best[1] - best[2]) < _BAND]


def _find_parts(
    points: Float[np.ndarray, "N 3"],
    patches: Patches,
    normal: Float[np.ndarray, "3"],
    offset: float,
    members: Int[np.ndarray, "K"],
) -> _Level | None:
    """Return the level made of a plane's large parts (0.12 m^2); None without any, or if its patches are tilted."""
    poll()
    cells = np.floor(points[members, :2] / _CELL).astype(int)
    lower = cells.min(axis=0) - 2
    picture = np.zeros(cells.max(axis=0) - lower + 3, dtype=bool)
    picture[tuple((cells - lower).T)] = True
    # Scan lines are about 10 cm apart where the floor is seen at a grazing angle.
    closed = ndimage.binary_closing(picture, structure=_AROUND, iterations=2)
    broad = ndimage.binary_opening(closed, structure=_AROUND[:2, :2])
    label, n_parts = ndimage.label(broad, structure=_AROUND)
    sizes = np.bincount(label.ravel(), weights=(picture & broad).ravel(), minlength=n_parts + 1) * _CELL**2
    large = sizes >= _SMALL
    large[0] = False
    inside = large[label[tuple((cells - lower).T)]]
    if not inside.any():
        return None
    members, cells = members[inside], cells[inside]
    held = np.flatnonzero(np.bincount(patches.of_point[members]))
    tilts = patches.normal[held[patches.is_upright[held]]]
    if len(tilts) < _UPRIGHT_SHARE * len(held):
        return None
    usual = np.median(tilts, axis=0)  # the median ignores patches tilted by an edge
    if normal @ usual < np.cos(np.radians(_SAME_WAY_DEG)) * np.linalg.norm(usual):
        return None
    normal, offset = _from_within(points[members], normal, offset)
    own = np.unique(cells, axis=0)
    rms = float(np.std(points[members] @ normal - offset))
    return _Level(FloorPlane(normal, offset, rms, float(len(own) * _CELL**2)), own, members)


def _from_within(
    points: Float[np.ndarray, "K 3"], normal: Float[np.ndarray, "3"], offset: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the plane refitted without its border, which may contain points of rising or falling ground."""
    fine = np.floor(points[:, :2] / (_CELL / 2)).astype(int)
    lower = fine.min(axis=0) - 2
    picture = np.zeros(fine.max(axis=0) - lower + 3, dtype=bool)
    picture[tuple((fine - lower).T)] = True
    closed = ndimage.binary_closing(picture, structure=_AROUND)
    inner = points[ndimage.binary_erosion(closed, structure=_AROUND)[tuple((fine - lower).T)]]
    if len(inner) < 30:
        return normal, offset
    fitted, height = plane_of(inner)
    if fitted[2] < np.cos(np.radians(MAX_SLOPE_DEG)):
        return normal, offset
    # The tilt of a small tread is uncertain: it is level unless a tilted plane fits clearly better.
    if np.std(inner[:, 2]) <= _NO_WORSE * np.std(inner @ fitted - height):
        return np.array([0.0, 0.0, 1.0]), float(inner[:, 2].mean())
    return fitted, height


def _under_robot(
    points: Float[np.ndarray, "N 3"], levels: list[_Level], stand: Float[np.ndarray, "3"]
) -> _Level | None:
    """Return the largest of the levels about nearest (within 0.5 m) to the robot; None without any."""
    able = [
        level
        for level in levels
        if level.plane.area >= _LARGE
        and float(level.plane.height(stand[None, :2])[0]) <= stand[2] + _HIGHEST
        and not _has_things_below(points, level)
        and not _is_raised(points, level, stand)
    ]
    if not able:
        return None
    apart = [float(np.linalg.norm((level.cells + 0.5) * _CELL - stand[:2], axis=1).min()) for level in able]
    near = [level for level, distance in zip(able, apart, strict=True) if distance <= min(apart) + _AS_NEAR]
    return max(near, key=lambda level: level.plane.area)


def _has_things_below(points: Float[np.ndarray, "N 3"], level: _Level) -> bool:
    """Return whether over 5 % of the points in the plane's inner cells lie below it and a slab, as under a table."""
    lower = level.cells.min(axis=0) - 1
    picture = np.zeros(level.cells.max(axis=0) - lower + 2, dtype=bool)
    picture[tuple((level.cells - lower).T)] = True
    inner = ndimage.binary_erosion(ndimage.binary_closing(picture, structure=_AROUND), structure=_AROUND)
    cells = np.floor(points[:, :2] / _CELL).astype(int) - lower
    valid = ((cells >= 0) & (cells < picture.shape)).all(axis=1)
    here = np.flatnonzero(valid)[inner[tuple(cells[valid].T)]]
    return bool(len(here)) and float((level.plane.above(points[here]) < -_SLAB).mean()) > _MOST_BELOW


def _is_raised(points: Float[np.ndarray, "N 3"], level: _Level, stand: Float[np.ndarray, "3"]) -> bool:
    """Return whether the plane is off the feet's height and many points between it and the robot lie below it."""
    if abs(float(level.plane.height(stand[None, :2])[0]) - stand[2]) <= 2 * _BAND:
        return False
    apart = np.linalg.norm(points[:, :2] - stand[:2], axis=1)
    is_before = apart < np.quantile(apart[level.members], _NEAREST)
    below = int((level.plane.above(points[is_before]) < -2 * _BAND).sum())
    return below > _MOST_BEFORE * len(level.members)


def _reach(points: Float[np.ndarray, "N 3"], main: _Level, others: list[_Level]) -> Iterator[_Level]:
    """Yield the levels reached by steps from level to level, without broken parts, and large ground below."""
    open_ends = [main]
    lowest = main.places[:, 2].min()
    # Rougher planes are cuts through heaps, or two low steps at once.
    roughest = max(_ROUGH, _ROUGHER * main.plane.rms)
    waiting = [level for level in others if level.plane.rms <= roughest]
    while open_ends:
        here = open_ends.pop(0)
        tree = cKDTree(here.places[:, :2])
        for level in waiting:
            apart, index = nearest(tree, level.places[:, :2], 1, within=_GAP)
            meet = np.isfinite(apart)
            rise = np.abs(level.places[meet, 2] - here.places[index[meet], 2])
            is_ground = level.plane.area >= 4 * _LARGE and level.places[:, 2].max() < lowest
            if is_ground or (meet.any() and float(rise.min()) <= _STEP):
                waiting = [other for other in waiting if other is not level]
                part = replace(level, is_ground_below=True) if is_ground else _unbroken(points, level)
                if part is not None:
                    open_ends.append(part)
                    yield part


def _unbroken(points: Float[np.ndarray, "N 3"], level: _Level) -> _Level | None:
    """Return the level without its broken parts; None when too little is left to stand on."""
    members = level.members[is_unbroken(points, points[level.members], level.plane)]
    cells = np.unique(np.floor(points[members, :2] / _CELL).astype(int), axis=0)
    area = float(len(cells) * _CELL**2)
    return _Level(replace(level.plane, area=area), cells, members) if area >= _SMALL else None


def _outline(
    points: Float[np.ndarray, "N 3"],
    level: _Level,
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]] | None,
) -> FloorPlane:
    """Return the plane with its outlines, extended by up to 0.35 m where it meets another level, as ramps do.

    A slope is extended up and down, but not sideways.
    """
    beside = np.flatnonzero(np.abs(level.plane.above(points)) < _BAND)
    near = points[beside]
    is_member = np.zeros(len(points), dtype=bool)
    is_member[level.members] = True
    belongs = is_member[beside]
    apart, _ = nearest(cKDTree((level.cells + 0.5) * _CELL), near[~belongs, :2], 1, within=_GOES_ON)
    goes_on = np.isfinite(apart)
    if level.plane.slope_deg > _LEVEL_DEG:
        across = np.array([-level.plane.normal[1], level.plane.normal[0]])
        across /= np.linalg.norm(across)
        aside, own = near[~belongs, :2] @ across, points[level.members, :2] @ across
        goes_on &= (aside >= own.min()) & (aside <= own.max())
    belongs[~belongs] = goes_on
    if not level.is_ground_below:
        belongs[belongs] = is_unbroken(points, near[belongs], level.plane) | is_member[beside][belongs]
    rays = (near[:0], near[:0]) if rays is None else rays
    return replace(level.plane, outlines=outlines_of(level.plane, near[belongs], level.places[:, :2], rays))


def _bound(
    points: Float[np.ndarray, "N 3"],
    main: _Level,
    rays: tuple[Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"]],
    stand: Float[np.ndarray, "3"],
    extent: float,
) -> FloorPlane:
    """Return the first level's plane, with outlines if rays went through it, as at a hole or a step down."""
    plane = main.plane
    foothold = stand[:2] + np.linspace(-_FOOTHOLD, _FOOTHOLD, 7)[:, None] * np.array([[1.0, 0.0]])
    foothold = (foothold[:, None, :] + np.linspace(-_FOOTHOLD, _FOOTHOLD, 7)[:, None] * np.array([0.0, 1.0])).reshape(
        -1, 2
    )
    seen = np.concatenate([points[main.members, :2], foothold])
    holes = pierced_cells(plane.normal, plane.offset, rays, seen, stand[:2], extent)
    return replace(plane, outlines=convex_patches(seen, 0.1, holes)) if len(holes) else plane
