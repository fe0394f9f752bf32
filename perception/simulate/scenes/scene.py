"""A simulated scene: meshes, truth, and where sensors look from."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from perception.cloud import Cloud
from perception.simulate.mesh import Mesh
from perception.simulate.objects.placed import Placed, Truth, join_placed
from perception.simulate.scanning import scan
from perception.simulate.sensor import DepthCamera, Pose, Scanner, Sensor, SolidState

VARIANTS: Mapping[str, Sensor] = {
    "dense": Scanner(),
    "sparse": Scanner(n_lines=44, sigma=0.015),
    "solid": SolidState(),
    "solid_sparse": SolidState(n_points=30_000, sigma=0.012),
    "camera": DepthCamera(),
    "camera_sparse": DepthCamera(width=212, height=120, field_deg=86.0),
}


@dataclass(frozen=True)
class SimulatedScene:
    """A world with its truth; the robot stands at the origin on the floor z = 0 and faces +x.

    Attributes:
        name: of the scene.
        seed: its details were drawn from.
        meshes: all there is.
        truth: what detectors should find.
        lookalikes: (kind, place) of what a detector may take for a kind without being wrong.
        poses: of the sensor; the first is where the scan is taken from, others judge it.
    """

    name: str
    seed: int
    meshes: tuple[Mesh, ...]
    truth: tuple[Truth, ...]
    lookalikes: tuple[tuple[str, Float[np.ndarray, "3"]], ...]
    poses: tuple[Pose, ...]

    def scan(self, variant: str = "dense", pose: int = 0, *, misses: bool = False) -> Cloud:
        """Return what a sensor gives of it; the same arguments give the same scan."""
        noise = zlib.crc32(f"{self.name}/{self.seed}/{variant}/{pose}".encode())
        return scan(self.meshes, self.poses[pose], VARIANTS[variant], noise, misses=misses)


class Recipe(Protocol):
    """Maker of a kind of scene."""

    def make(self, name: str, seed: int) -> SimulatedScene:
        """Return the scene; its details are drawn from name and seed."""
        ...


def generator(name: str, seed: int) -> np.random.Generator:
    """Make the generator of a scene's details."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed])


def assemble(
    name: str,
    seed: int,
    parts: Sequence[Placed],
    look_at: Sequence[float],
    position: tuple[float, float, float] = (0.12, 0.0, 1.62),
) -> SimulatedScene:
    """Return the parts with two sensor poses, both looking nearly at ``look_at``; the second one is 40 cm aside."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed, 1])
    whole = join_placed(parts)
    poses = []
    for shift in ((0.0, 0.0, 0.0), (-0.1, 0.4, -0.12)):
        place = tuple((np.array(position) + shift + rng.normal(0.0, 0.02, 3)).tolist())
        target = np.array(look_at) + rng.normal(0.0, 0.05, 3)
        poses.append(Pose.looking((place[0], place[1], place[2]), target.tolist(), float(rng.normal(0.0, 0.02))))
    return SimulatedScene(name, seed, whole.meshes, whole.truth, whole.lookalikes, tuple(poses))
