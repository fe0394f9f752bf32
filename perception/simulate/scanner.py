"""A spinning line scanner: beams in a fan that turns about the sensor's forward axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.cloud import Cloud
from perception.simulate.mesh import Mesh, joined

_NEAREST = 0.1


@dataclass(frozen=True)
class Scanner:
    """What a scan looks like.

    Attributes:
        n_beams: beams of the fan.
        fan_deg: angle of the fan, about the forward axis.
        n_lines: positions of the fan over half a turn, which together see all around.
        sigma: standard deviation of the range [m].
        max_range: beams that meet nothing nearer give no point [m].
        footprint_deg: width of a beam; when it meets two surfaces the range can lie between.
        mixed_share: how often it then does.
    """

    n_beams: int = 1081
    fan_deg: float = 270.0
    n_lines: int = 90
    sigma: float = 0.01
    max_range: float = 30.0
    footprint_deg: float = 0.15
    mixed_share: float = 0.3

    def directions(self) -> Float[np.ndarray, "R 3"]:
        """Unit directions of all beams in the sensor's frame (x forward, z up)."""
        beam = np.radians(np.linspace(-self.fan_deg / 2, self.fan_deg / 2, self.n_beams))
        turn = np.pi * np.arange(self.n_lines) / self.n_lines
        beam, turn = (grid.ravel() for grid in np.meshgrid(beam, turn))
        return np.column_stack([np.cos(beam), np.sin(beam) * np.cos(turn), np.sin(beam) * np.sin(turn)])


@dataclass(frozen=True)
class Pose:
    """Where the sensor is: position [m], then yaw, pitch (down positive) and roll [rad]."""

    position: tuple[float, float, float] = (0.12, 0.0, 1.6)
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """World from sensor."""
        return np.asarray(Rotation.from_euler("ZYX", [self.yaw, self.pitch, self.roll]).as_matrix())

    @property
    def viewpoint(self) -> tuple[float, ...]:
        """x y z qw qx qy qz, as PCD files write it."""
        return (*self.position, *Rotation.from_matrix(self.rotation).as_quat(scalar_first=True).tolist())


def scan(meshes: Sequence[Mesh], pose: Pose | None = None, scanner: Scanner | None = None, seed: int = 0) -> Cloud:
    """The points a scanner would give of the meshes, in world coordinates.

    Every beam stops at the first surface (real occlusion).  A beam whose footprint meets two surfaces more than 3 cm
    apart gives, now and then, a mixed pixel: a range anywhere between them.

    Args:
        meshes: the world.
        pose: of the sensor.
        scanner: what it does.
        seed: of the noise.
    """
    pose, scanner = pose or Pose(), scanner or Scanner()
    rng = np.random.default_rng(seed)
    origin = np.array(pose.position)
    direction = scanner.directions() @ pose.rotation.T
    world = joined(meshes)
    first = cast(world, origin, direction)
    aside = rng.normal(size=direction.shape)
    aside -= (aside * direction).sum(axis=1, keepdims=True) * direction
    aside *= np.tan(np.radians(scanner.footprint_deg)) / np.linalg.norm(aside, axis=1, keepdims=True)
    second = cast(world, origin, (direction + aside) / np.linalg.norm(direction + aside, axis=1, keepdims=True))
    share = rng.random(len(first))
    both = np.isfinite(first) & np.isfinite(second)
    gap = np.where(both, second, 0.0) - np.where(both, first, 0.0)
    is_mixed = (np.abs(gap) > 0.03) & (rng.random(len(first)) < scanner.mixed_share)
    ranges = np.where(is_mixed, first + share * gap, first)
    ranges = ranges + rng.normal(0.0, scanner.sigma, len(ranges))
    seen = (ranges > _NEAREST) & (ranges < scanner.max_range)
    return Cloud(origin + ranges[seen, None] * direction[seen], origin)


def cast(world: Mesh, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "R 3"]) -> Float[np.ndarray, "R"]:
    """Distance to the first surface along each unit direction [m]; infinite where there is none."""
    # open3d takes 0.7 s to import; only those who simulate pay for it.
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(tensor(world.vertices.astype(np.float32)), tensor(world.triangles.astype(np.uint32)))
    rays = np.concatenate([np.broadcast_to(origin, direction.shape), direction], axis=1).astype(np.float32)
    return np.asarray(caster.cast_rays(tensor(rays))["t_hit"].numpy(), dtype=np.float64)
