"""Scenes of things with the outline of an object, and of rooms with people: negatives for fitting confidences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.clouds.absent import Maker, Place
from perception.simulate.scenes.loose import can, chair, pot, table
from perception.simulate.scenes.scene import PlacedObjects, make_room, pose_of, things, wall
from perception.solids.primitives import Mesh, box, capsule, cylinder, hull, lathe

# Outline of a drill as a solid block: x forward, z up over the support [m].
_DRILL = ((-0.07, 0.055), (-0.05, 0.0), (0.07, 0.0), (0.13, 0.19), (0.11, 0.245), (-0.07, 0.245))


def make_blocks(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make solid blocks of a drill's outline, upright and lying, bottles, a mug and boxes on a table."""
    top = 0.8
    parts: list[Mesh] = []
    for y in (-0.5, -0.15, 0.2):
        outline = np.array(_DRILL) * rng.uniform(0.8, 1.1)
        block = hull(np.array([[x, side, z] for x, z in outline for side in (-0.03, 0.03)]))
        parts.append(block.place(pose_of((0.75 + rng.uniform(-0.1, 0.1), y, top), yaw=rng.uniform(0.0, 6.3))))
    flat = hull(np.array([[x, z, side] for x, z in _DRILL for side in (0.0, 0.06)]))
    parts.append(flat.place(pose_of((0.65, 0.45, top), yaw=rng.uniform(0.0, 6.3))))
    sprayer = [(0.0, 0.0), (0.04, 0.0), (0.045, 0.12), (0.015, 0.17), (0.015, 0.2), (0.0, 0.2)]
    parts.append(lathe(sprayer, (1.0, 0.0, top)))
    parts.append(box((0.94, -0.02, top + 0.2), (1.04, 0.02, top + 0.23)))
    stool = table((0.6, 1.0, 0.0), 0.5, 0.5, 0.45)
    loose = [pot((1.0, 0.3, top), 0.045, 0.12), can((1.0, -0.35, top), 0.035, 0.12)]
    return [things(*parts), *loose, table((0.5, -0.8, 0.0), 1.6, 0.7, top), stool, wall(1.6)], (0.8, 0.0, 0.85)


def make_people(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make three persons, standing with bent or stretched arms, and one sitting on a chair."""
    parts: list[PlacedObjects] = []
    for x, y in ((0.9, -0.8), (1.2, 0.0), (1.0, 0.8)):
        parts.append(things(*_person(rng, (x, y), float(rng.uniform(0.0, 6.3)), is_sitting=y > 0.5)))
    return [*parts, chair((1.0, 0.8, 0.0), rng.uniform(0.0, 6.3)), make_room(2.4, -2.0, 2.0)], (1.0, 0.0, 1.0)


def _person(rng: np.random.Generator, at: tuple[float, float], yaw: float, *, is_sitting: bool) -> list[Mesh]:
    """Return a person of capsules at a place on the floor, x forward before the yaw."""
    hip = 0.5 if is_sitting else 0.9
    parts = [capsule((0.0, 0.0, hip + 0.08), (0.0, 0.0, hip + 0.45), 0.15)]
    parts += [capsule((0.0, 0.0, hip + 0.58), (0.0, 0.0, hip + 0.65), 0.045)]
    parts += [capsule((0.01, 0.0, hip + 0.72), (0.01, 0.0, hip + 0.8), 0.09)]
    for side in (-1.0, 1.0):
        knee = (0.45, 0.11 * side, hip) if is_sitting else (0.03, 0.11 * side, 0.5)
        parts += [capsule((0.0, 0.1 * side, hip), knee, 0.075)]
        parts += [capsule(knee, (knee[0], 0.12 * side, 0.06), 0.055)]
        parts += [capsule((knee[0], 0.12 * side, 0.04), (knee[0] + 0.17, 0.13 * side, 0.04), 0.04)]
        lift, bend = rng.uniform(0.0, 1.4), rng.uniform(0.0, 1.6)
        shoulder = np.array([0.0, 0.2 * side, hip + 0.45])
        elbow = shoulder + 0.28 * np.array([np.sin(lift), 0.1 * side, -np.cos(lift)])
        hand = elbow + 0.26 * np.array([np.sin(lift + bend), -0.1 * side, -np.cos(lift + bend)])
        parts += [capsule(shoulder.tolist(), elbow.tolist(), 0.05), capsule(elbow.tolist(), hand.tolist(), 0.038)]
    return [mesh.place(pose_of((*at, 0.0), yaw=yaw)) for mesh in parts]


def make_steps(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make walls with pilasters, a niche, a cupboard front, a shelf of boxes before a wall, and a cut-off board."""
    depth = rng.uniform(0.04, 0.15)
    parts: list[Mesh] = [box((1.5 - depth, y, 0.0), (1.6, y + 0.9, 2.6)) for y in (-2.2, -0.7)]
    parts += [box((1.5 - depth, 0.8, 0.0), (1.6, 1.7, rng.uniform(1.9, 2.2)))]
    parts += [box((1.1, 0.9, z), (1.4, 1.6, z + 0.02)) for z in (0.5, 0.9, 1.3)]
    parts += [
        box((1.2, 0.95 + 0.2 * k, 0.92), (1.35, 1.08 + 0.2 * k, 0.92 + rng.uniform(0.08, 0.25))) for k in range(3)
    ]
    parts += [box((0.9, -1.8, 0.0), (1.45, -0.9, rng.uniform(0.8, 1.0)))]
    parts += [box((1.35, -0.5, 1.4), (1.5, 0.4, 2.1)), cylinder((1.4, 0.6, 0.0), (1.4, 0.6, 2.6), 0.04)]
    parts += [box((0.8, 0.2, 0.0), (0.83, 0.5, rng.uniform(0.6, 1.2)))]
    return [things(*parts), wall(1.6)], (1.1, 0.0, 1.0)


DECOYS: Mapping[str, Maker] = {"none_blocks": make_blocks, "none_people": make_people, "none_steps": make_steps}
