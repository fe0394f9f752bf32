"""Floors and walls around a scene, and the things that stand about in it."""

from __future__ import annotations

import numpy as np

from perception.simulate.mesh import box, cylinder
from perception.simulate.objects.placed import Placed, pose_of, things


def floor(half: float = 6.0) -> Placed:
    """Return a floor at zero."""
    return things(box((-half, -half, -0.1), (half, half, 0.0)))


def wall(x: float, low: float = -3.0, high: float = 3.0, height: float = 2.6, yaw: float = 0.0) -> Placed:
    """Return a wall whose seen face is square to x at ``x``, from y ``low`` to ``high``, turned about the origin."""
    return Placed((box((x, low, 0.0), (x + 0.12, high, height)).placed(pose_of((0.0, 0.0, 0.0), yaw=yaw)),))


def side_walls(y: float, front: float, back: float = -3.0, height: float = 2.6) -> Placed:
    """Return walls left and right."""
    return things(box((back, y, 0.0), (front, y + 0.12, height)), box((back, -y - 0.12, 0.0), (front, -y, height)))


def make_room(front: float, back: float, half: float, height: float = 2.6) -> Placed:
    """Make four walls and a ceiling."""
    return Placed(
        (
            *wall(front, -half, half, height).meshes,
            *side_walls(half, front, back, height).meshes,
            box((back - 0.12, -half, 0.0), (back, half, height)),
            box((back, -half, height), (front, half, height + 0.1)),
        )
    )


def upright_pipe(x: float, y: float, radius: float, height: float = 2.6) -> Placed:
    """Make a pipe from the floor up."""
    return things(cylinder((x, y, 0.0), (x, y, height), radius))


def carton(x: float, y: float, size: tuple[float, float, float], yaw: float = 0.0, z: float = 0.0) -> Placed:
    """Return a box on the floor or on another, by the middle of its foot."""
    a, b, c = size
    mesh = box((-0.5 * a, -0.5 * b, 0.0), (0.5 * a, 0.5 * b, c))
    return Placed((mesh.placed(pose_of((x, y, z), yaw=yaw)),))


def cartons(rng: np.random.Generator, n: int, near: tuple[float, float], spread: float) -> list[Placed]:
    """Return a few boxes on the floor around a place; they may touch."""
    parts = []
    for _ in range(n):
        x, y = np.array(near) + rng.uniform(-spread, spread, 2)
        size = rng.uniform(0.2, 0.5, 3)
        parts.append(carton(x, y, (size[0], size[1], size[2]), rng.uniform(0.0, np.pi)))
    return parts
