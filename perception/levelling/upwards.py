"""Direction of gravity in a cloud, from its floors, tables, ceilings and walls and from how its sensor looked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import voxel_downsample
from perception.cloud import Cloud
from perception.levelling.look import Look, find_look
from perception.levelling.surfaces import Surfaces, find_surfaces

# Standard deviation of the angle by which patches of one surface differ.
_ALIKE_DEG = 5.0
# Directions within this angle are one answer.
APART_DEG = 12.0
_MOST_PEAKS = 12
_MOST_SEEDS = 300
# Least sine of the angle between two walls whose edge is a direction upwards.
_LEAST_TURN = 0.5
# Fits of a level: half-widths of its layer, in turn [m], and the standard deviation of its patches' normals [deg].
_FITS = (((0.15, 0.1, 0.05, 0.05, 0.03), 8.0), ((0.1, 0.05, 0.03), 5.0), ((0.05, 0.03, 0.03), 5.0))
_THIN = 0.01
# Half-widths of its points [m], in turn, and edge of their voxels [m].
_BANDS, _VOXEL = (0.06, 0.03, 0.02), 0.03
# Share of the seen surface that is level where a floor or a ceiling says where upwards is.
LEAST_FLOOR = 0.1
_LEAST_LEVEL = 0.05  # share of the level patches that makes a level
_OF_LEVELS = 0.1  # share of the surface that faces up of a level that counts as floor
_FEWEST_PATCHES = 3
# Standard deviations from level and upright of floors, walls and a camera that is held square [rad].
_OF_LEVEL, _OF_WALL, _OF_CAMERA = 0.03, 0.06, 0.5
# Cosines: downwards from which a sensor looks down, and up to which all the more; range of a close-up [m].
_DOWN, _NEAR = (0.6, 0.3), 1.0
_REFINEMENTS = 4
_MOST_REFINED = 6
# Standard deviation of a level's patches from its plane, and least half-width of one that is fitted [m].
_UNEVEN, _LEAST_WIDE = 0.008, 0.08
_TRIMS = 5


@dataclass(frozen=True)
class Evidence:
    """What speaks for a direction upwards.

    Attributes:
        floor: share of the seen surface that lies level and faces up.
        ceiling: share that lies level and faces down.
        wall: share that stands upright.
        below: share of the seen surface that is below the largest level.
        pitch: cosine between the direction and that in which the sensor looked; 0 for one that looked all around.
        roll: cosine between the direction and the nearer axis across the sensor's field; 0 if it has none.
        usual_deg: angle to the direction upwards of a usual frame.
        close_up: 0 to 1, how near and how squarely the sensor looked down on the surface that faces up.
        is_rare: whether fewer files have their direction upwards there.
        is_opposite: whether it is the direction downwards of a usual frame, within 30 degrees.
        n_walls: number of directions of walls, 0 to 2.
    """

    floor: float
    ceiling: float
    wall: float
    below: float
    pitch: float
    roll: float
    usual_deg: float
    close_up: float
    is_rare: bool
    is_opposite: bool
    n_walls: int

    @property
    def score(self) -> float:
        """Log odds of the direction, up to a constant."""
        corner = 0.05 if self.n_walls > 1 else 0.0
        support = 2.0 * np.log(0.1 + self.floor + 0.1 * self.ceiling + corner)
        upright = np.log(0.1 + self.wall + self.floor + self.ceiling)
        attitude = -0.5 * ((self.pitch + 0.3) / 0.4) ** 2 - 0.5 * min(self.roll / 0.25, 2.0) ** 2
        # A sensor is mounted upside down more often than on its side.
        usual = max(-0.5 * min(self.usual_deg / 25.0, 3.2) ** 2, -3.0 if self.is_opposite else -np.inf)
        # What fills the view from less than a metre is what a sensor was held to, a door say, more often than a floor.
        against = 4.0 * self.below + 4.0 * self.close_up + 2.0 * self.is_rare
        return float(support + upright + attitude + usual - against)


@dataclass(frozen=True)
class Upwards:
    """Direction upwards in a cloud.

    Attributes:
        direction: (3,) unit, in the frame of the cloud.
        evidence: what speaks for it.
        margin: its log odds against the best direction at least 12 degrees away.
    """

    direction: Float[np.ndarray, "3"]
    evidence: Evidence
    margin: float


def find_upwards(cloud: Cloud) -> Upwards | None:
    """Return the most likely direction upwards of a cloud in any orientation; None if it shows no flat surface."""
    surfaces, look = find_surfaces(cloud.points, cloud.starts), find_look(cloud)
    if not len(surfaces):
        return None
    found = [_rate(direction, surfaces, look) for direction in _list_candidates(surfaces, look)]
    found.sort(key=lambda upwards: -upwards.evidence.score)
    likely = [_rate(_refine(upwards.direction, surfaces, look), surfaces, look) for upwards in _tell_apart(found)]
    likely.sort(key=lambda upwards: -upwards.evidence.score)
    best = likely[0]
    rival = next((other.evidence.score for other in likely if _is_other(other, best)), -np.inf)
    points = voxel_downsample(cloud.points, _VOXEL)[0]
    is_level = best.evidence.floor + best.evidence.ceiling > LEAST_FLOOR
    direction = (_settle if is_level else _settle_on_walls)(best.direction, surfaces, points)
    return Upwards(direction, _rate(direction, surfaces, look).evidence, best.evidence.score - rival)


def find_floor_height(surfaces: Surfaces, up: Float[np.ndarray, "3"]) -> float | None:
    """Return the height along ``up`` of the lowest large level that faces up [m]; None without one."""
    votes = _kernel(surfaces.normal @ up) * surfaces.weight
    if not len(surfaces) or votes.sum() < _LEAST_LEVEL * surfaces.weight.sum():
        return None
    height = surfaces.centre @ up
    levels = [
        group for group in _group(height, votes, 0.5 * _BANDS[0]) if votes[group].sum() > _OF_LEVELS * votes.sum()
    ]
    known = votes / surfaces.range**2  # depth is known by the square of the range
    return min((float(np.average(height[group], weights=known[group])) for group in levels), default=None)


def _tell_apart(found: list[Upwards]) -> list[Upwards]:
    """Return the best few directions that are at least 12 degrees apart."""
    kept: list[Upwards] = []
    for upwards in found:
        if all(_is_other(upwards, other) for other in kept):
            kept.append(upwards)
        if len(kept) == _MOST_REFINED:
            break
    return kept


def _is_other(upwards: Upwards, other: Upwards) -> bool:
    return bool(upwards.direction @ other.direction < np.cos(np.radians(APART_DEG)))


def _list_candidates(surfaces: Surfaces, look: Look) -> Float[np.ndarray, "C 3"]:
    """Return directions that may be upwards: normals of surfaces, edges of walls, axes of the sensor and the frame."""
    peaks = _find_peaks(surfaces)
    axes = np.array([axis for axis in (look.wide, look.narrow) if axis.any()]).reshape(-1, 3)
    sides = np.concatenate([peaks, axes])
    first, second = np.triu_indices(len(sides), 1)
    edges = np.cross(sides[first], sides[second])
    turn = np.linalg.norm(edges, axis=1)
    edges = edges[turn > _LEAST_TURN] / turn[turn > _LEAST_TURN, None]
    half = np.concatenate([sides, edges, np.eye(3)])
    return np.concatenate([half, -half])


def _find_peaks(surfaces: Surfaces) -> Float[np.ndarray, "K 3"]:
    """Return the directions towards which most of the surface looks, most first."""
    seeds = surfaces.normal[:: -(-len(surfaces) // _MOST_SEEDS)]
    votes = _kernel(seeds @ surfaces.normal.T) @ surfaces.weight
    peaks: list[Float[np.ndarray, "3"]] = []
    for seed in seeds[np.argsort(-votes, kind="stable")]:
        if all(seed @ peak < np.cos(np.radians(APART_DEG)) for peak in peaks):
            mean = (_kernel(surfaces.normal @ seed) * surfaces.weight) @ surfaces.normal
            peaks.append(np.asarray(mean / np.linalg.norm(mean)))
        if len(peaks) == _MOST_PEAKS:
            break
    return np.array(peaks)


def _kernel(cosine: Float[np.ndarray, "*P"], sigma_deg: float = _ALIKE_DEG) -> Float[np.ndarray, "*P"]:
    """Return the weight of patches by the cosine of their angle to a direction."""
    return np.asarray(np.exp(-0.5 * (np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) / sigma_deg) ** 2))


def _rate(direction: Float[np.ndarray, "3"], surfaces: Surfaces, look: Look) -> Upwards:
    """Return the direction with its evidence."""
    poll()
    cosine, weight = surfaces.normal @ direction, surfaces.weight / surfaces.weight.sum()
    upright = _kernel(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)))
    floor = float(_kernel(cosine) @ weight)
    height = surfaces.centre @ direction
    below = 0.0
    if floor > LEAST_FLOOR:
        levels = _group(height, _kernel(cosine) * weight, 0.1)
        main = max(levels, key=lambda level: float((_kernel(cosine) * weight)[level].sum()))
        low = np.average(height[main], weights=(_kernel(cosine) * weight)[main] + 1e-12)
        steep = np.abs(cosine) < np.cos(np.radians(20.0))
        below = float(weight[(height < low - 0.1) & steep].sum())
    n_walls = _count_walls(direction, surfaces, upright)
    pitch, near = float(look.ahead @ direction), np.inf
    if floor > 0.0:
        near = float(np.average(surfaces.range, weights=_kernel(cosine) * weight))
    across = [abs(float(axis @ direction)) for axis in (look.wide, look.narrow) if axis.any()]
    evidence = Evidence(
        floor=floor,
        ceiling=float(_kernel(-cosine) @ weight),
        wall=float(upright @ weight),
        below=below,
        pitch=pitch,
        roll=min(across, default=0.0),
        usual_deg=look.angle_to_usual(direction),
        close_up=float(
            np.clip((-pitch - _DOWN[0]) / _DOWN[1], 0.0, 1.0) * np.clip((_NEAR - near) / _NEAR, 0.0, 0.5) * 2.0
        ),
        is_rare=look.is_rare(direction),
        is_opposite=look.is_opposite(direction),
        n_walls=n_walls,
    )
    return Upwards(direction, evidence, np.inf)


def _count_walls(direction: Float[np.ndarray, "3"], surfaces: Surfaces, upright: Float[np.ndarray, "P"]) -> int:
    """Return in how many different directions walls of some size look: 0, 1 or 2."""
    weight = upright * surfaces.weight
    scatter = (surfaces.normal * weight[:, None]).T @ surfaces.normal
    spread = np.linalg.eigvalsh(scatter) / surfaces.weight.sum()
    return int((spread[1:] > 0.03).sum())


def _refine(direction: Float[np.ndarray, "3"], surfaces: Surfaces, look: Look) -> Float[np.ndarray, "3"]:
    """Return the direction that agrees best with level and upright patches and, without them, a camera held square."""
    for _ in range(_REFINEMENTS):
        normal, weight = surfaces.normal, surfaces.weight / surfaces.weight.sum()
        cosine = normal @ direction
        level = _kernel(np.abs(cosine)) * weight
        axis = look.across(direction)
        # Largest eigenvector: along the normals of levels, across those of walls.
        scatter = (normal * (level / _OF_LEVEL**2)[:, None]).T @ normal - np.outer(axis, axis) / _OF_CAMERA**2
        wall = _kernel(np.sqrt(np.maximum(1.0 - cosine**2, 0.0))) * weight
        scatter -= (normal * (wall / _OF_WALL**2)[:, None]).T @ normal
        refined = np.linalg.eigh(scatter)[1][:, 2]
        refined = refined if refined @ direction > 0.0 else -refined
        if refined @ direction < np.cos(np.radians(APART_DEG)):
            break
        direction = np.asarray(refined)
    return direction


def _settle(
    direction: Float[np.ndarray, "3"], surfaces: Surfaces, points: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "3"]:
    """Return the normal of the largest level's plane, of several fits that with most points on it.

    A floor that a camera shows bent has several planes that fit parts of it.
    """
    starts = [direction, *(_fit_level(direction, surfaces, bands, sigma_deg) for bands, sigma_deg in _FITS)]
    return max((_fit_points(start, surfaces, points) for start in starts), key=lambda fit: fit[1])[0]


def _settle_on_walls(
    direction: Float[np.ndarray, "3"], surfaces: Surfaces, points: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction refitted to the planes of two walls; the direction itself without them."""
    upright = surfaces.select(np.abs(surfaces.normal @ direction) < np.sin(np.radians(APART_DEG)))
    if not len(upright):
        return direction
    walls = [wall for peak in _find_peaks(upright) for wall, n_on in [_fit_points(peak, surfaces, points)] if n_on]
    edges = [np.cross(walls[0], wall) for wall in walls[1:] if np.linalg.norm(np.cross(walls[0], wall)) > _LEAST_TURN]
    if not edges:
        return direction
    edge = edges[0] / np.linalg.norm(edges[0])
    edge = edge if edge @ direction > 0.0 else -edge
    return np.asarray(edge if edge @ direction > np.cos(np.radians(APART_DEG)) else direction)


def _fit_level(
    direction: Float[np.ndarray, "3"], surfaces: Surfaces, bands: tuple[float, ...], sigma_deg: float
) -> Float[np.ndarray, "3"]:
    """Return the normal of the plane of the largest level across a direction; the direction itself without one."""
    first = direction
    for band in bands:
        level = _kernel(np.abs(surfaces.normal @ direction), sigma_deg)
        votes = level * surfaces.weight
        members = max(_group(surfaces.centre @ direction, votes, band), key=lambda group: float(votes[group].sum()))
        plane = _fit_plane(surfaces.centre[members], (level * surfaces.area)[members])
        if votes[members].sum() < _LEAST_LEVEL * surfaces.weight.sum() or plane is None:
            return first
        plane = plane if plane @ first > 0.0 else -plane
        if plane @ first < np.cos(np.radians(APART_DEG)):
            return first
        direction = plane
    return direction


def _fit_points(
    direction: Float[np.ndarray, "3"], surfaces: Surfaces, points: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "3"], int]:
    """Return the direction refitted to the points of the largest level, and how many are on its plane."""
    votes = _kernel(np.abs(surfaces.normal @ direction)) * surfaces.weight
    members = max(_group(surfaces.centre @ direction, votes, _BANDS[0]), key=lambda group: float(votes[group].sum()))
    if votes[members].sum() < _LEAST_LEVEL * surfaces.weight.sum():
        return direction, 0
    reach = float(np.median(surfaces.edge[members]))
    apart = cKDTree(surfaces.centre[members]).query(points, distance_upper_bound=reach)[0]
    points = points[np.isfinite(apart)]
    height = float(np.average(surfaces.centre[members] @ direction, weights=votes[members]))
    fitted, n_on = direction, 0
    for band in _BANDS:
        near = points[np.abs(points @ fitted - height) < band]
        plane = _fit_plane(near, np.ones(len(near)))
        if plane is None or abs(float(plane @ direction)) < np.cos(np.radians(APART_DEG)):
            return direction, 0
        fitted = plane if plane @ direction > 0.0 else -plane
        height = float(np.median(near @ fitted))
        n_on = int((np.abs(points @ fitted - height) < _THIN).sum())
    return fitted, n_on


def _fit_plane(places: Float[np.ndarray, "K 3"], weight: Float[np.ndarray, "K"]) -> Float[np.ndarray, "3"] | None:
    """Return the normal of the plane through most of the places; None if they are too few or too narrow."""
    if len(places) < _FEWEST_PATCHES:
        return None
    trimmed = weight
    for _ in range(_TRIMS):
        apart = places - np.average(places, axis=0, weights=trimmed)
        spread, axes = np.linalg.eigh((apart * trimmed[:, None]).T @ apart / trimmed.sum())
        trimmed = weight / (1.0 + (apart @ axes[:, 0] / _UNEVEN) ** 2)
    return np.asarray(axes[:, 0]) if spread[1] > _LEAST_WIDE**2 else None


def _group(height: Float[np.ndarray, "P"], weight: Float[np.ndarray, "P"], band: float) -> list[Int[np.ndarray, "K"]]:
    """Return the patches of each level: the fullest layer of twice the band first, without those taken before."""
    open_ones = np.flatnonzero(weight > 1e-3 * weight.max())
    whole, groups = weight[open_ones].sum(), []
    while len(open_ones) >= _FEWEST_PATCHES:
        order = open_ones[np.argsort(height[open_ones], kind="stable")]
        total = np.concatenate([[0.0], np.cumsum(weight[order])])
        last = np.searchsorted(height[order], height[order] + 2.0 * band, side="right")
        held = total[last] - total[:-1]
        best = int(np.argmax(held))
        members = order[best : last[best]]
        if held[best] < _LEAST_LEVEL * whole:
            break
        groups.append(members)
        open_ones = np.setdiff1d(open_ones, members, assume_unique=True)
    return groups or [np.flatnonzero(weight > 0.0)]
