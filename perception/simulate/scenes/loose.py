"""Loose objects: drills, beams, pots, buckets, carts, tables, shelves and the like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.simulate.scenes.scene import PlacedObjects, Truth, pose_of, things
from perception.solids.primitives import Mesh, bent_bar, box, capsule, cylinder, lathe, torus


@dataclass(frozen=True)
class Drill:
    """A cordless drill standing on its battery.

    Attributes:
        foot: point below the middle of the grip, on the supporting surface [m].
        yaw: direction of the chuck about z [rad].
        grip_length: length from battery to body [m].
        body_length: length from the motor's back to the chuck's tip [m].
        lean: roll about the chuck's direction [rad].
    """

    foot: tuple[float, float, float]
    yaw: float = 0.0
    grip_length: float = 0.13
    body_length: float = 0.2
    lean: float = 0.0

    def build(self) -> PlacedObjects:
        """Build the drill; its frame has its origin in the middle of the grip, z up along it, x along the chuck."""
        half, battery = 0.5 * self.grip_length, 0.055
        top = half + 0.03
        back = -0.07
        tip = back + self.body_length
        profile = [
            (0.0, 0.0),
            (0.027, 0.004),
            (0.032, 0.02),
            (0.032, 0.6),
            (0.026, 0.66),
            (0.021, 0.7),
            (0.02, 0.86),
            (0.013, 0.97),
            (0.0, 1.0),
        ]
        body = [(r, h if h < 0.03 else h * self.body_length) for r, h in profile]
        meshes = [
            lathe(body, (back, 0.0, top), (1.0, 0.0, 0.0)),
            capsule((0.0, 0.0, -half), (-0.008, 0.0, half), 0.02),
            capsule((0.008, 0.0, -half), (0.004, 0.0, half), 0.017),
            box((-0.05, -0.035, -half - battery), (0.07, 0.035, -half)),
            cylinder((tip - 0.01, 0.0, top), (tip + 0.04, 0.0, top), 0.004, 12),
        ]
        foot = pose_of(self.foot, yaw=self.yaw, roll=self.lean)
        pose = foot @ pose_of((0.0, 0.0, half + battery))
        truth = Truth("drill", pose, {"grip_length": self.grip_length, "body_length": self.body_length})
        return PlacedObjects(tuple(mesh.place(pose) for mesh in meshes), (truth,))


@dataclass(frozen=True)
class Beam:
    """A sawn timber.

    Attributes:
        pose: (4, 4) pose of its centre, x along its length, z along its smallest side.
    """

    pose: np.ndarray
    length: float = 1.22
    width: float = 0.089
    thickness: float = 0.038

    def build(self) -> PlacedObjects:
        """Make a box."""
        half = 0.5 * np.array([self.length, self.width, self.thickness])
        sizes = {"length": self.length, "width": self.width, "thickness": self.thickness}
        mesh = box((-half).tolist(), half.tolist()).place(self.pose)
        return PlacedObjects((mesh,), (Truth("beam", self.pose, sizes),))


def pot(place: Sequence[float], radius: float = 0.12, height: float = 0.14) -> PlacedObjects:
    """Make a cooking pot without its lid, two handles."""
    x, y, z = place
    section = [
        (0.0, 0.0),
        (radius, 0.0),
        (radius, height),
        (radius - 0.004, height),
        (radius - 0.004, 0.004),
        (0.0, 0.004),
    ]
    ears = [
        torus((x, y + side * (radius + 0.02), z + 0.8 * height), (0, 0, 1), 0.025, 0.005, 32, 12) for side in (-1, 1)
    ]
    return things(lathe(section, place), *ears)


def bucket(place: Sequence[float], radius: float = 0.14, height: float = 0.28) -> PlacedObjects:
    """Make a bucket with a rolled rim and its bail down."""
    x, y, z = place
    section = [
        (0.0, 0.0),
        (0.75 * radius, 0.0),
        (radius, height),
        (radius - 0.004, height),
        (0.75 * radius - 0.004, 0.004),
        (0.0, 0.004),
    ]
    angle = np.linspace(0.0, np.pi, 9)
    bail = [
        (x - np.sin(a) * radius * 0.7 - 0.02, y + radius * np.cos(a), z + height - 0.6 * radius * np.sin(a))
        for a in angle
    ]
    return things(
        lathe(section, place), torus((x, y, z + height), (0, 0, 1), radius, 0.006, 64, 12), bent_bar(bail, 0.003)
    )


def can(place: Sequence[float], radius: float = 0.05, height: float = 0.16) -> PlacedObjects:
    """Make a closed tin."""
    x, y, z = place
    return things(cylinder((x, y, z), (x, y, z + height), radius, 32))


def shelf(corner: Sequence[float], width: float, depth: float, levels: Sequence[float], height: float) -> PlacedObjects:
    """Make an open rack of four posts and boards; ``corner`` is its front right foot, x its depth, y its width."""
    x, y, z = corner
    post = 0.03
    posts = [
        box((x + dx, y + dy, z), (x + dx + post, y + dy + post, z + height))
        for dx in (0.0, depth - post)
        for dy in (0.0, width - post)
    ]
    boards = [box((x, y, z + level - 0.02), (x + depth, y + width, z + level)) for level in levels]
    return things(*posts, *boards)


def table(corner: Sequence[float], length: float = 1.2, depth: float = 0.7, height: float = 0.75) -> PlacedObjects:
    """Make four legs and a top; ``corner`` is its front right foot, x its depth, y its length."""
    x, y, z = corner
    leg = 0.05
    legs = [
        box((x + dx, y + dy, z), (x + dx + leg, y + dy + leg, z + height - 0.03))
        for dx in (0.02, depth - leg - 0.02)
        for dy in (0.02, length - leg - 0.02)
    ]
    return things(*legs, box((x, y, z + height - 0.03), (x + depth, y + length, z + height)))


def chair(place: Sequence[float], yaw: float = 0.0) -> PlacedObjects:
    """Make a chair with four legs, a seat board and a back."""
    parts: list[Mesh] = [box((x, y, 0.0), (x + 0.035, y + 0.035, 0.44)) for x in (-0.2, 0.165) for y in (-0.2, 0.165)]
    parts += [box((-0.21, -0.21, 0.44), (0.21, 0.21, 0.465)), box((-0.21, -0.2, 0.6), (-0.19, 0.2, 0.9))]
    parts += [box((-0.21, y, 0.46), (-0.185, y + 0.03, 0.9)) for y in (-0.2, 0.17)]
    return PlacedObjects(tuple(mesh.place(pose_of(place, yaw=yaw)) for mesh in parts))


def cart(place: Sequence[float], yaw: float = 0.0, wheel: float = 0.15) -> PlacedObjects:
    """Make a flat cart with a push bar on four wheels, whose discs are recessed in their tyres."""
    parts: list[Mesh] = [box((-0.45, -0.28, wheel + 0.03), (0.45, 0.28, wheel + 0.07))]
    half = [(0.0, 0.015), (0.025, 0.015), (0.025, 0.006), (0.72 * wheel, 0.006), (0.75 * wheel, 0.025), (wheel, 0.025)]
    tyre = [*half, *((radius, -height) for radius, height in reversed(half))]
    for x in (-0.3, 0.3):
        parts += [lathe(tyre, (x, y, wheel), (0.0, 1.0, 0.0)) for y in (-0.32, 0.32)]
        parts.append(cylinder((x, -0.32, wheel), (x, 0.32, wheel), 0.012, 16))
    parts.append(
        bent_bar([(-0.44, -0.25, wheel), (-0.55, -0.25, 0.95), (-0.55, 0.25, 0.95), (-0.44, 0.25, wheel)], 0.015)
    )
    return PlacedObjects(tuple(mesh.place(pose_of(place, yaw=yaw)) for mesh in parts))


def tyre(place: Sequence[float], axis: Sequence[float], radius: float = 0.32, width: float = 0.2) -> PlacedObjects:
    """Make a car tyre without its wheel."""
    inner, half = 0.6 * radius, 0.5 * width
    section = [(inner, -0.8 * half), (0.95 * radius, -half), (radius, -0.7 * half), (radius, 0.7 * half)]
    section += [(0.95 * radius, half), (inner, 0.8 * half), (inner, 0.7 * half), (0.9 * radius, 0.85 * half)]
    section += [(0.93 * radius, 0.0), (0.9 * radius, -0.85 * half), (inner, -0.7 * half), (inner, -0.8 * half)]
    return things(lathe(section, place, axis))


def cupboard(corner: Sequence[float], width: float = 0.8, depth: float = 0.4, height: float = 1.9) -> PlacedObjects:
    """Make a cupboard with two flush fronts and a gap between; ``corner`` is its front right foot, x its depth."""
    x, y, z = corner
    middle = y + 0.5 * width
    fronts = [
        box((x, a, z + 0.08), (x + 0.02, b, z + height)) for a, b in ((y, middle - 0.003), (middle + 0.003, y + width))
    ]
    return things(box((x + 0.02, y, z), (x + depth, y + width, z + height)), *fronts)


def radiator(corner: Sequence[float], length: float = 1.0, height: float = 0.6) -> PlacedObjects:
    """Make a radiator of upright ribs, in a row along y, between two pipes; ``corner`` is its right foot."""
    x, y, z = corner
    ribs = [capsule((x, y + at, z), (x, y + at, z + height), 0.018) for at in np.arange(0.0, length, 0.055)]
    ends = [cylinder((x, y, h), (x, y + length, h), 0.02, 24) for h in (z + 0.04, z + height - 0.04)]
    return things(*ribs, *ends)
