"""Simulated objects in the world: meshes, and the truth about what a detector should find in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.simulate.mesh import Mesh


@dataclass(frozen=True)
class Truth:
    """An object as it is, in the words of :class:`perception.Detection`.

    Attributes:
        kind: what it is.
        pose_world_object: (4, 4); the frame of the detector of that kind.
        sizes: lengths [m] and angles [rad] by the names that detector uses.
    """

    kind: str
    pose_world_object: Float[np.ndarray, "4 4"]
    sizes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Placed:
    """Objects in the world.

    Attributes:
        meshes: of all of them.
        truth: what a detector should find.
        lookalikes: (kind, place) of what a detector may take for a kind without being wrong, as a door's handle is a
            lever and a steering wheel a wheel; a place is (3,) [m].
    """

    meshes: tuple[Mesh, ...]
    truth: tuple[Truth, ...] = ()
    lookalikes: tuple[tuple[str, Float[np.ndarray, "3"]], ...] = ()


def join_placed(parts: Sequence[Placed]) -> Placed:
    """Join several as one."""
    return Placed(
        tuple(mesh for part in parts for mesh in part.meshes),
        tuple(truth for part in parts for truth in part.truth),
        tuple(alike for part in parts for alike in part.lookalikes),
    )


def things(*meshes: Mesh) -> Placed:
    """Return meshes no detector should find anything in."""
    return Placed(meshes)


def pose_of(position: Sequence[float], yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Return a (4, 4) pose: turned by roll about x, pitch about y, yaw about z, then moved."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose[:3, 3] = position
    return pose


def frame(position: Sequence[float], x: Sequence[float], z: Sequence[float]) -> np.ndarray:
    """Return a (4, 4) pose with the given z axis, its x axis as near to ``x`` as it can be."""
    third = np.asarray(z, dtype=float) / np.linalg.norm(z)
    first = np.asarray(x, dtype=float) - (np.asarray(x) @ third) * third
    first /= np.linalg.norm(first)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([first, np.cross(third, first), third])
    pose[:3, 3] = position
    return pose
