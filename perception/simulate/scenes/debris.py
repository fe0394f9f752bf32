"""Beams on the ground: scattered and in heaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.simulate.scenes.loose import Beam
from perception.simulate.scenes.scene import (
    PlacedObjects,
    Recipe,
    SimulatedScene,
    assemble,
    cartons,
    floor,
    generator,
    wall,
)

_SECTIONS = ((0.089, 0.038), (0.089, 0.038), (0.14, 0.038), (0.089, 0.089))
_STEP = 0.004


@dataclass(frozen=True)
class Debris:
    """Scene with a heap of beams in front of the robot.

    Attributes:
        spread: largest offset of the beams' centres from ``middle`` in x and y before they fall [m].
    """

    n_beams: int
    middle: tuple[float, float] = (1.0, 0.0)
    spread: float = 0.3
    n_boxes: int = 0

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        parts = [floor(), wall(2.1), *heap(rng, self.n_beams, self.middle, self.spread)]
        parts += cartons(rng, self.n_boxes, (1.2, 1.3), 0.3)
        return assemble(name, seed, parts, (*self.middle, 0.2))


SCENES: Mapping[str, Recipe] = {
    "debris_one": Debris(1, (0.9, 0.1), 0.1),
    "debris_strewn": Debris(4, (1.0, 0.0), 0.5),
    "debris_heap": Debris(8),
    "debris_large_heap": Debris(14, (1.2, 0.0), 0.35, 2),
}


def heap(rng: np.random.Generator, n_beams: int, middle: tuple[float, float], spread: float) -> list[PlacedObjects]:
    """Drop beams one by one: each sinks to its first contact, then tips over to its second."""
    boxes: list[tuple[np.ndarray, np.ndarray]] = []
    placed = []
    for _ in range(n_beams):
        width, thickness = _SECTIONS[rng.integers(len(_SECTIONS))]
        length = float(rng.choice([0.6, 0.9, 1.2]))
        half = 0.5 * np.array([length, width, thickness])
        rotation = Rotation.from_euler("ZX", [rng.uniform(0.0, np.pi), rng.choice([0.0, 0.5 * np.pi], p=[0.8, 0.2])])
        pose = np.eye(4)
        pose[:3, :3] = rotation.as_matrix()
        pose[:2, 3] = np.array(middle) + rng.uniform(-spread, spread, 2)
        pose[2, 3] = 1.5 if not boxes else max(place[2, 3] + size[0] for place, size in boxes) + length
        pose = _tip(_sink(pose, half, boxes), half, boxes)
        boxes.append((pose, half))
        placed.append(Beam(pose, length, width, thickness).build())
    return placed


def _sink(pose: Float[np.ndarray, "4 4"], half: np.ndarray, others: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the (4, 4) pose of a box lowered until just before contact with the floor or other boxes."""
    pose = pose.copy()
    # Coarse steps, smaller than a beam's thickness, then fine ones.
    for step in (0.03, _STEP):
        while not _touches(pose, half, others):
            pose[2, 3] -= step
        pose[2, 3] += step
    return pose


def _tip(pose: Float[np.ndarray, "4 4"], half: np.ndarray, others: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the pose of a box rotated about its contact, its heavy end down, until that end touches; then lowered."""
    below = pose.copy()
    below[2, 3] -= _STEP
    along = np.linspace(-0.98, 0.98, 41)
    slices = [(below @ _shift(half[0] * s), half * (0.02, 1.0, 1.0)) for s in along]
    contact = [s for s, (place, part) in zip(along, slices, strict=True) if _touches(place, part, others)]
    if not contact or min(contact) < 0.0 < max(contact):
        return pose
    at = min(contact, key=abs) * half[0]
    # The heavy end is on the other side of the centre and moves down.
    axis = pose[:3, :3] @ np.array([0.0, 1.0, 0.0]) if abs(pose[2, 2]) > 0.5 else pose[:3, 2]
    direction = np.cross(axis, pose[:3, 0])[2]
    sign = np.sign(at) * np.sign(direction) if at else np.sign(direction)
    pivot = (pose @ np.array([at, 0.0, 0.0, 1.0]))[:3] + np.array([0.0, 0.0, _STEP])
    last, degree = pose, 0.0
    for step in (2.0, 0.25):
        while degree + step < 75.0:
            turn = Rotation.from_rotvec(sign * np.radians(degree + step) * axis).as_matrix()
            tried = pose.copy()
            tried[:3, :3] = turn @ pose[:3, :3]
            tried[:3, 3] = pivot + turn @ (pose[:3, 3] - pivot)
            if _touches(tried, half, others):
                break
            last, degree = tried, degree + step
    return _sink(last, half, others)


def _shift(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def _touches(pose: Float[np.ndarray, "4 4"], half: np.ndarray, others: list[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Return whether a box intersects the floor or another box (separating axis test)."""
    if pose[2, 3] - np.abs(pose[2, :3]) @ half < 0.0:
        return True
    return any(_overlap(pose, half, other, size) for other, size in others)


def _overlap(a: np.ndarray, half_a: np.ndarray, b: np.ndarray, half_b: np.ndarray) -> bool:
    apart = b[:3, 3] - a[:3, 3]
    if np.linalg.norm(apart) > np.linalg.norm(half_a) + np.linalg.norm(half_b):
        return False
    edges = np.cross(a[:3, :3].T[:, None, :], b[:3, :3].T[None, :, :]).reshape(-1, 3)
    axes = np.concatenate([a[:3, :3].T, b[:3, :3].T, edges])
    length = np.linalg.norm(axes, axis=1)
    axes = axes[length > 1e-6] / length[length > 1e-6, None]
    reach = np.abs(axes @ a[:3, :3]) @ half_a + np.abs(axes @ b[:3, :3]) @ half_b
    return bool((np.abs(axes @ apart) <= reach).all())
