"""Errors of a frame's pose: distances and offsets from a target's position, angles between orientations.

The angle ``a`` of a rotation ``R``, from 0 to pi, has ``2 cos a = trace R - 1``, and ``2 sin a`` is the length of the
axial vector of ``R - R^T``.  ``R`` moves the tip of no unit vector by more than that of one across its axis, hence
``|R - 1| = 2 sin(a / 2)`` in the spectral norm; the tip of a unit vector at an angle ``a`` is as far off its place.
Being a norm, this chord is convex along straight lines between matrices or tips, which the angle is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from service.verify.motion import PoseTarget

AXIS_NAMES = ("x", "y", "z")


@dataclass(frozen=True)
class PositionDemand:
    """What a target demands of the position of its frame: a distance, or an offset along one axis.

    Attributes:
        axis: index of the axis of the target's orientation (of the world, if any will do); None for the distance.
        tolerance_m: largest absolute value [m].
    """

    axis: int | None
    tolerance_m: float

    def measure(self, offset: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "S"]:
        """Return the errors of positions, given in the axes of the target from its position [m]."""
        return np.asarray(np.linalg.norm(offset, axis=1) if self.axis is None else np.abs(offset[:, self.axis]))


def list_position_demands(target: PoseTarget) -> tuple[PositionDemand, ...]:
    """Return what a target demands of the position: one distance where no axis has a tolerance of its own."""
    tolerances = target.position_tolerance_m
    if np.isfinite(tolerances[0]) and np.all(tolerances == tolerances[0]):
        return (PositionDemand(None, float(tolerances[0])),)
    return tuple(PositionDemand(axis, float(most)) for axis, most in enumerate(tolerances) if np.isfinite(most))


def offset_from_target(target: PoseTarget, position: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "S 3"]:
    """Return positions from the target's, in the axes of its orientation (of the world, if any will do) [m]."""
    offset = position - target.position
    return np.asarray(offset if target.rotation is None else offset @ target.rotation)


def limits_rotation(target: PoseTarget) -> bool:
    """Return whether a target demands an orientation."""
    return target.rotation is not None and bool(np.isfinite(target.rotation_tolerance[0]))


def measure_angle(rotation: Float[np.ndarray, "S 3 3"]) -> Float[np.ndarray, "S"]:
    """Return the angles of rotations, 0 to pi [rad]."""
    axial = np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    return np.asarray(np.arctan2(np.linalg.norm(axial, axis=1), np.trace(rotation, axis1=1, axis2=2) - 1.0))


def measure_rotation_vector(rotation: Float[np.ndarray, "S 3 3"]) -> Float[np.ndarray, "S 3"]:
    """Return the rotation vectors of rotations, at most pi long [rad]."""
    from scipy.spatial.transform import Rotation  # slow to import

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def measure_lean(direction: Float[np.ndarray, "S 3"], wanted: Float[np.ndarray, "3"]) -> Float[np.ndarray, "S"]:
    """Return the angles between unit vectors and a wanted one, 0 to pi [rad]."""
    along = direction @ wanted
    return np.asarray(np.arctan2(np.linalg.norm(direction - along[:, None] * wanted, axis=1), along))


def chord_of(angle: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the distance of the tips of unit vectors at these angles [-]."""
    return np.asarray(2.0 * np.sin(0.5 * angle))


def angle_of(chord: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the angle between unit vectors whose tips are ``chord`` apart [rad]; beyond the diameter more than pi."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) + np.maximum(chord - 2.0, 0.0))
