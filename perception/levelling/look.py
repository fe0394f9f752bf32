"""How a sensor looked: the middle and the sides of its field, and the frame that its file is likely in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.cloud import Cloud

_MOST_RAYS = 20_000
_FEWEST_RAYS = 10
# Length of the mean of unit rays: a sensor above it looked one way.
_ONE_WAY = 0.6
# Variance along the wide side of a field over that along the narrow one.
_WIDER = 1.3
_ALONG = np.cos(np.radians(60.0))
_OPPOSITE = -np.cos(np.radians(30.0))
_AT_ORIGIN = 0.3  # of a camera from the origin of its frame, which may be another camera's beside it [m]

# Frames in use: direction in which the sensor looks (zero: any), direction upwards.
FRAMES = {
    "z up": ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "y up": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "camera (x right, y down, z forward)": ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    "OpenGL camera (x right, y up, z backward)": ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
}


@dataclass(frozen=True)
class Look:
    """How the sensor looked.

    Attributes:
        ahead: (3,) unit, middle of its field; zero for one that looked all around, or from several places.
        wide: (3,) unit, across ``ahead`` along the longer side of its field; zero if no side is longer.
        is_at_origin: whether it stood at the origin, as a camera does in a frame of its own.
    """

    ahead: Float[np.ndarray, "3"]
    wide: Float[np.ndarray, "3"]
    is_at_origin: bool = True

    @property
    def narrow(self) -> Float[np.ndarray, "3"]:
        """(3,) unit, along the shorter side of its field; zero if no side is longer."""
        return np.cross(self.ahead, self.wide)

    def across(self, up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return the side of the field that is level if the sensor was held square; zero if there is none."""
        return min((self.wide, self.narrow), key=lambda axis: abs(float(axis @ up)))

    def list_frames(self) -> dict[str, Float[np.ndarray, "3"]]:
        """Return the direction upwards of the frames in which a sensor looks as this one does, by name."""
        return {
            name: np.array(up)
            for name, (ahead, up) in FRAMES.items()
            if not any(ahead) or (self.is_at_origin and float(np.dot(ahead, self.ahead)) > _ALONG)
        }

    def is_opposite(self, up: Float[np.ndarray, "3"]) -> bool:
        """Return whether a direction is that downwards of such a frame whose sensor stands upside down."""
        return any(float(usual @ up) < _OPPOSITE for name, usual in self.list_frames().items() if name != "y up")

    def is_rare(self, up: Float[np.ndarray, "3"]) -> bool:
        """Return whether a direction is upwards only in frames with y up, whatever their sensor looks at."""
        usual = self.list_frames()
        y_up = usual.pop("y up")
        return bool(y_up @ up > max(_ALONG, *(float(other @ up) for other in usual.values())))

    def angle_to_usual(self, up: Float[np.ndarray, "3"]) -> float:
        """Return the least angle between a direction and those upwards in such frames [deg]."""
        cosine = max(float(usual @ up) for usual in self.list_frames().values())
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def find_look(cloud: Cloud) -> Look:
    """Return how the sensor looked, from the directions of its rays."""
    step = -(-len(cloud.points) // _MOST_RAYS)
    offset = cloud.points[::step] - cloud.starts[::step]
    length = np.linalg.norm(offset, axis=1)
    along = offset[length > 1e-6] / length[length > 1e-6, None]
    nothing = np.zeros(3)
    is_at_origin = bool(np.abs(cloud.starts[::step]).max(initial=0.0) < _AT_ORIGIN)
    mean = along.mean(axis=0) if len(along) >= _FEWEST_RAYS else nothing
    if np.linalg.norm(mean) < _ONE_WAY:
        return Look(nothing, nothing, is_at_origin)
    ahead = mean / np.linalg.norm(mean)
    across = along - np.outer(along @ ahead, ahead)
    spread, axes = np.linalg.eigh(across.T @ across)
    wide = axes[:, 2] - (axes[:, 2] @ ahead) * ahead
    wide = wide / np.linalg.norm(wide) if spread[2] > _WIDER * spread[1] else nothing
    return Look(ahead, wide, is_at_origin)
