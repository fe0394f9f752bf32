"""A simulated scene: objects with their ground truth, surroundings, and sensor poses."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.cloud import Cloud
from perception.simulate.sensor import DepthCamera, Pose, Scanner, Sensor, SolidState, TimeOfFlight, scan
from perception.solids.primitives import Mesh, box, cylinder

VARIANTS: Mapping[str, Sensor] = {
    "dense": Scanner(),
    "sparse": Scanner(n_lines=44, sigma=0.015),
    "solid": SolidState(),
    "solid_sparse": SolidState(n_points=30_000, sigma=0.012),
    "camera": DepthCamera(),
    "camera_sparse": DepthCamera(width=212, height=120, field_deg=86.0),
    "tof": TimeOfFlight(),
    "survey": Scanner(n_lines=180, sigma=0.002, footprint_deg=0.02, mixed_share=0.1),
}


@dataclass(frozen=True)
class Truth:
    """Ground truth of an object, with the fields of :class:`perception.Detection`.

    Attributes:
        pose_world_object: (4, 4) pose, in the convention of that kind's detector.
        sizes: lengths [m] and angles [rad], by that detector's names.
    """

    kind: str
    pose_world_object: Float[np.ndarray, "4 4"]
    sizes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PlacedObjects:
    """Objects in the world.

    Attributes:
        lookalikes: (kind, position) of parts that a detector may report as that kind without error, such as a door
            handle as a lever or a steering wheel as a wheel; positions are (3,) [m].
    """

    meshes: tuple[Mesh, ...]
    truth: tuple[Truth, ...] = ()
    lookalikes: tuple[tuple[str, Float[np.ndarray, "3"]], ...] = ()


def join_objects(parts: Sequence[PlacedObjects]) -> PlacedObjects:
    """Join the meshes, truths and lookalikes of several parts."""
    return PlacedObjects(
        tuple(mesh for part in parts for mesh in part.meshes),
        tuple(truth for part in parts for truth in part.truth),
        tuple(alike for part in parts for alike in part.lookalikes),
    )


def things(*meshes: Mesh) -> PlacedObjects:
    """Return meshes in which no detector should find an object."""
    return PlacedObjects(meshes)


def pose_of(position: Sequence[float], yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Return a (4, 4) pose: rotated by roll about x, pitch about y, yaw about z, then translated."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose[:3, 3] = position
    return pose


def frame(position: Sequence[float], x: Sequence[float], z: Sequence[float]) -> np.ndarray:
    """Return a (4, 4) pose with the given z axis, and with ``x`` projected normal to z as its x axis."""
    third = np.asarray(z, dtype=float) / np.linalg.norm(z)
    first = np.asarray(x, dtype=float) - (np.asarray(x) @ third) * third
    first /= np.linalg.norm(first)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([first, np.cross(third, first), third])
    pose[:3, 3] = position
    return pose


def floor(half: float = 6.0) -> PlacedObjects:
    """Return a square floor at z = 0 with half its side given [m]."""
    return things(box((-half, -half, -0.1), (half, half, 0.0)))


def wall(x: float, low: float = -3.0, high: float = 3.0, height: float = 2.6, yaw: float = 0.0) -> PlacedObjects:
    """Return a wall with its visible face at ``x``, normal to x, from y ``low`` to ``high``, yawed about the origin."""
    return PlacedObjects((box((x, low, 0.0), (x + 0.12, high, height)).place(pose_of((0.0, 0.0, 0.0), yaw=yaw)),))


def side_walls(y: float, front: float, back: float = -3.0, height: float = 2.6) -> PlacedObjects:
    """Return walls to the left and right."""
    return things(box((back, y, 0.0), (front, y + 0.12, height)), box((back, -y - 0.12, 0.0), (front, -y, height)))


def make_room(front: float, back: float, half: float, height: float = 2.6) -> PlacedObjects:
    """Make four walls and a ceiling."""
    return PlacedObjects(
        (
            *wall(front, -half, half, height).meshes,
            *side_walls(half, front, back, height).meshes,
            box((back - 0.12, -half, 0.0), (back, half, height)),
            box((back, -half, height), (front, half, height + 0.1)),
        )
    )


def upright_pipe(x: float, y: float, radius: float, height: float = 2.6) -> PlacedObjects:
    """Make a pipe from the floor up."""
    return things(cylinder((x, y, 0.0), (x, y, height), radius))


def carton(x: float, y: float, size: tuple[float, float, float], yaw: float = 0.0, z: float = 0.0) -> PlacedObjects:
    """Return a box with the centre of its bottom face at ``x``, ``y``, ``z`` [m]."""
    a, b, c = size
    mesh = box((-0.5 * a, -0.5 * b, 0.0), (0.5 * a, 0.5 * b, c))
    return PlacedObjects((mesh.place(pose_of((x, y, z), yaw=yaw)),))


def cartons(rng: np.random.Generator, n: int, near: tuple[float, float], spread: float) -> list[PlacedObjects]:
    """Return ``n`` boxes on the floor around a position; they may touch."""
    parts = []
    for _ in range(n):
        x, y = np.array(near) + rng.uniform(-spread, spread, 2)
        size = rng.uniform(0.2, 0.5, 3)
        parts.append(carton(x, y, (size[0], size[1], size[2]), rng.uniform(0.0, np.pi)))
    return parts


@dataclass(frozen=True)
class SimulatedScene:
    """A scene with its ground truth; the robot stands at the origin on the floor z = 0 and faces +x.

    Attributes:
        lookalikes: (kind, position) of parts that a detector may report as that kind without error.
        poses: sensor poses; the scan is taken from the first, the others are used to evaluate it.
    """

    name: str
    seed: int
    meshes: tuple[Mesh, ...]
    truth: tuple[Truth, ...]
    lookalikes: tuple[tuple[str, Float[np.ndarray, "3"]], ...]
    poses: tuple[Pose, ...]

    def scan(self, variant: str = "dense", pose: int = 0, *, misses: bool = False) -> Cloud:
        """Return a simulated scan of the scene; the same arguments give the same scan."""
        noise = zlib.crc32(f"{self.name}/{self.seed}/{variant}/{pose}".encode())
        return scan(self.meshes, self.poses[pose], VARIANTS[variant], noise, misses=misses)


class Recipe(Protocol):
    """Recipe for one type of scene."""

    def make(self, name: str, seed: int) -> SimulatedScene:
        """Return the scene; name and seed determine its random details."""
        ...


def generator(name: str, seed: int) -> np.random.Generator:
    """Return the random generator of a scene's details."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed])


def assemble(
    name: str,
    seed: int,
    parts: Sequence[PlacedObjects],
    look_at: Sequence[float],
    position: tuple[float, float, float] = (0.12, 0.0, 1.62),
) -> SimulatedScene:
    """Make a scene of the parts with two sensor poses, both directed near ``look_at``; the second is 40 cm aside."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed, 1])
    whole = join_objects(parts)
    poses = []
    for shift in ((0.0, 0.0, 0.0), (-0.1, 0.4, -0.12)):
        place = tuple((np.array(position) + shift + rng.normal(0.0, 0.02, 3)).tolist())
        target = np.array(look_at) + rng.normal(0.0, 0.05, 3)
        poses.append(Pose.looking((place[0], place[1], place[2]), target.tolist(), float(rng.normal(0.0, 0.02))))
    return SimulatedScene(name, seed, whole.meshes, whole.truth, whole.lookalikes, tuple(poses))
