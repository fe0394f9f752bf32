"""Regions that a frame reaches or keeps to, relative to the world or to another frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class RegionTarget:
    """A frame is in a region: at path parameter ``at``, or on a part of the motion.

    Each limit stands for itself; an infinite one frees.

    Attributes:
        frame: frame of the robot's model.
        reference: frame in which the region is given; None for the world.
        position: (3,) of the region's origin in the reference [m].
        rotation: (3, 3) axes of the region in the reference, and the wanted rotation_reference_frame.
        lower, upper: (3,) least and largest offset of the frame's origin along the region's axes [m].
        radius_m: largest distance of the origin from the region's z axis.
        distance_m: largest distance of the origin from the region's.
        turn_rad: largest angle of the rotation from the wanted one.
        turns_rad: (3,) largest absolute components of its rotation vector, in the region's axes.
        axis: (3,) unit axis in the frame that has a direction, or None.
        look: (3,) place in the region's axes from its origin to which ``axis`` points; None: ``axis`` has the direction
            that it has in the wanted orientation [m].
        lean_rad: largest angle of ``axis`` from its direction.
        during: (2,) shares of the motion's path between which it holds.
        at: path parameter, or None.
    """

    frame: str
    reference: str | None
    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    lower: Float[np.ndarray, "3"]
    upper: Float[np.ndarray, "3"]
    radius_m: float
    distance_m: float
    turn_rad: float
    turns_rad: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"] | None
    look: Float[np.ndarray, "3"] | None
    lean_rad: float
    during: Float[np.ndarray, "2"]
    at: float | None = None

    @property
    def place(self) -> Float[np.ndarray, "3"] | None:
        """(3,) place in the reference to which the axis points; None where it has a direction [m]."""
        return None if self.look is None else np.asarray(self.position + self.rotation @ self.look)

    @property
    def limits_position(self) -> bool:
        """Whether it limits the frame's position."""
        bounds = (*self.lower, *self.upper, self.radius_m, self.distance_m)
        return bool(np.any(np.isfinite(bounds)))
