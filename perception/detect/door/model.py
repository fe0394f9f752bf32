"""Detected door: its geometry with the leaf shut, and its own points, which a task moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from costs.scene import ConvexPiece
from perception.cleaning.clean import nearest
from perception.detect.door.bodies import HOUSING_HALF_HEIGHT, HOUSING_HALF_WIDTH
from perception.detect.door.geometry import UP, DoorGeometry, Opens
from perception.detect.shared.detection import Detection
from perception.errors import PerceptionError

USUAL_THICKNESS = 0.045
_BESIDE = 0.012
_INSIDE = 0.015
_NOISE = 0.03
_FRINGE = 0.06  # distance from the leaf at which a lone point may be a stray [m]
_ALONE = 0.03  # of a stray from the next point that is not the door's own [m]
_CROWD = 10  # points that the leaf shows within that distance, so that a surface would show several
_ABOUT_HANDLE = 0.03


@dataclass(frozen=True)
class DoorModel:
    """Detected door.

    Attributes:
        noise: distance from the leaf at which points may still be its own [m].
    """

    geometry: DoorGeometry
    noise: float = _NOISE

    def split_off(self, points: Float[np.ndarray, "N 3"], /) -> tuple[Bool[np.ndarray, "N"], tuple[ConvexPiece, ...]]:
        """Return (N,) points on leaf and handle where they were seen, with the strays just off the leaf.

        No part of a door stays in the scene.
        """
        own = door_points(self.geometry, points, self.noise)
        return own | _find_strays(self.geometry, points, own), ()

    def see_past(
        self, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"], /
    ) -> Float[np.ndarray, "R 3"]:
        """Return the ends, those on leaf and handle moved to the back of the leaf, both as seen and shut.

        Otherwise a wall whose face is flush with the leaf would continue through the doorway.
        """
        own = door_points(self.geometry, ends, self.noise)
        begin, end = np.broadcast_to(starts, ends.shape)[own], ends[own]
        share = np.ones(len(end))
        for geometry in (self.geometry, replace(self.geometry, ajar=0.0)):
            share = np.maximum(share, _leaving(geometry, begin, end))
        moved = ends.copy()
        moved[own] = begin + share[:, None] * (end - begin)
        return moved

    def list_sides(self) -> Float[np.ndarray, "F 4"]:
        """Return the half-spaces of the leaf where it was seen, with its noise before and behind it."""
        geometry = self.geometry
        along, normal = find_leaf_axes(geometry)
        back, front = geometry.face - geometry.thickness - self.noise, geometry.face + self.noise
        limits = ((along, 0.0, geometry.width), (normal, back, front), (UP, 0.0, geometry.height))
        sides = []
        for axis, low, high in limits:
            at = float(axis @ geometry.hinge)
            sides += [[*-axis, low + at], [*axis, -(high + at)]]
        return np.array(sides)


def read_door(detection: Detection) -> DoorGeometry:
    """Return the geometry of a detected door, its leaf shut and its lever at rest.

    Its ``opens`` is None where the scan does not show it; ``choose_opening`` then sets what a person says.  Among the
    detection's residuals, ``opens_share`` is the certainty of the opening direction, ``hinge_share`` is 0 where the
    hinge side is a guess (a shut leaf with a bar across it), and ``thickness_share`` is 0 since no scan has shown the
    thickness, which is then the usual 45 mm.

    Raises:
        PerceptionError: the detection is no door.
    """
    if not isinstance(detection.model, DoorModel):
        raise PerceptionError(f"a detected {detection.kind} has no geometry of a door; expected a detected door")
    return detection.model.geometry


def choose_opening(geometry: DoorGeometry, opens: Opens) -> DoorGeometry:
    """Return the door with its opening direction, and with its hinge axis on the face to which the leaf turns."""
    face = 0.0 if opens == "pull" else geometry.thickness
    hinge = geometry.hinge + (geometry.face - face) * geometry.normal
    return replace(geometry, hinge=hinge, face=face, opens=opens)


def door_points(
    geometry: DoorGeometry, points: Float[np.ndarray, "N 3"], noise: float = _NOISE
) -> Bool[np.ndarray, "N"]:
    """Return (N,) points within ``noise`` of leaf and handle, in the pose in which the leaf was seen [m]."""
    x, out, up = _in_leaf(geometry, points).T
    back = geometry.face - geometry.thickness
    # Points beside the leaf are its frame, which may stand out of it.
    beside = np.where(out > geometry.face + _BESIDE, 0.0, _BESIDE)
    own = (x > -beside) & (x < geometry.width + beside) & (up < geometry.height + beside)
    own &= (out > back - noise) & (out < geometry.face + noise)
    handle = geometry.handle
    if handle is None:
        return np.asarray(own)
    # The box of a lever holds every angle of it.
    centre = _in_leaf(replace(geometry, ajar=0.0), handle.centre[None])[0]
    reach = handle.length if handle.kind == "lever" else 0.5 * handle.length
    reach += HOUSING_HALF_WIDTH if handle.kind == "push_bar" else 0.0
    half = np.abs([handle.direction @ geometry.along, 0.0, handle.direction @ UP]) * reach
    half = np.maximum(half, max(handle.radius, HOUSING_HALF_HEIGHT))
    half[2] = max(half[2], reach if handle.kind == "lever" else 0.0)
    at = np.stack([x - centre[0], up - centre[2]])
    near = (np.abs(at) < half[[0, 2]][:, None] + _ABOUT_HANDLE).all(axis=0)
    near &= (out > geometry.face) & (out < centre[1] + handle.radius + _ABOUT_HANDLE)
    return np.asarray(own | near)


def _find_strays(
    geometry: DoorGeometry, points: Float[np.ndarray, "N 3"], own: Bool[np.ndarray, "N"]
) -> Bool[np.ndarray, "N"]:
    """Return (N,) points just off a leaf that are alone although the leaf shows so many that a surface showed several.

    The leaf hid from the cleaning of the scan that they are alone.

    Args:
        points: (N, 3) of the scan, without the floor [m].
        own: (N,) points on leaf and handle.
    """
    strays = np.zeros(len(points), dtype=bool)
    about = own.sum() / (geometry.width * geometry.height) * np.pi * _ALONE**2
    near = np.flatnonzero(door_points(geometry, points, _FRINGE) & ~own)
    if about >= _CROWD and len(near):
        apart = nearest(cKDTree(points[~own]), points[near], [2], _ALONE)[0][:, 0]
        strays[near[np.isinf(apart)]] = True
    return strays


def _leaving(
    geometry: DoorGeometry, starts: Float[np.ndarray, "R 3"], ends: Float[np.ndarray, "R 3"]
) -> Float[np.ndarray, "R"]:
    """Return the share of each ray's length at which it leaves the leaf at its back; 1 if it does not cross it."""
    begin, end = (_in_leaf(geometry, points) for points in (starts, ends))
    sign = np.sign(begin[:, 1] - geometry.face)
    back = np.where(sign < 0.0, geometry.face, geometry.face - geometry.thickness)
    fall = begin[:, 1] - end[:, 1]
    crosses = fall * sign > 1e-6
    share = np.where(crosses, (begin[:, 1] - back) / np.where(crosses, fall, 1.0), 1.0)
    x, _, up = (begin + share[:, None] * (end - begin)).T
    inside = (x > _INSIDE) & (x < geometry.width - _INSIDE) & (up > _INSIDE) & (up < geometry.height - _INSIDE)
    return np.asarray(np.where(crosses & inside, share, 1.0))


def _in_leaf(geometry: DoorGeometry, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Return (N, 3) coordinates from the hinge along the leaf, along its normal, and up, in the seen leaf's frame."""
    away = points - geometry.hinge
    along, normal = find_leaf_axes(geometry)
    return np.column_stack([away @ along, away @ normal, away @ UP])


def find_leaf_axes(geometry: DoorGeometry) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the directions along the leaf, from the hinge, and of its normal, where the leaf was seen."""
    c, s = np.cos(geometry.ajar), np.sin(geometry.ajar)
    outwards = -1.0 if geometry.opens == "push" else 1.0
    along = c * geometry.along + outwards * s * geometry.normal
    normal = c * geometry.normal - outwards * s * geometry.along
    return along, normal
