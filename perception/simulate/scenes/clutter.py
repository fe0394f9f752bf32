"""Scenes without detectable objects, but with objects that look similar."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from perception.simulate.scenes.loose import bucket, can, cart, chair, cupboard, pot, radiator, shelf, table, tyre
from perception.simulate.scenes.scene import (
    PlacedObjects,
    Recipe,
    SimulatedScene,
    assemble,
    carton,
    cartons,
    floor,
    generator,
    make_room,
    things,
    upright_pipe,
    wall,
)
from perception.solids.primitives import box, cylinder, torus


@dataclass(frozen=True)
class Clutter:
    """Scene of objects arranged by a function.

    Attributes:
        arrange: makes the objects, with a random generator for their details.
    """

    arrange: Callable[[np.random.Generator], list[PlacedObjects]]
    look_at: tuple[float, float, float] = (0.9, 0.0, 1.0)

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        return assemble(name, seed, [floor(), *self.arrange(generator(name, seed))], self.look_at)


def kitchen(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make a rack of pots, buckets and tins, a cart beside it, a picture and a round frame on the wall."""
    parts = [wall(1.25), shelf((0.75, -0.6, 0.0), 1.2, 0.42, (0.1, 0.45, 0.9, 1.35), 1.8)]
    for level in (0.1, 0.45, 0.9, 1.35):
        for y in (-0.42, -0.1, 0.22, 0.46):
            kind = (pot, bucket, can)[rng.integers(3)]
            parts.append(kind((0.95 + rng.uniform(-0.03, 0.03), y, level), radius=rng.uniform(0.06, 0.12)))
    parts.append(cart((0.9, 1.5, 0.0), rng.uniform(0.0, np.pi)))
    frame = torus((1.24, -1.5, 1.6), (1.0, 0.0, 0.0), 0.14, 0.012)
    return [*parts, things(box((1.22, -1.2, 1.2), (1.25, -0.75, 1.6)), frame)]


def pipes(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make vertical and horizontal pipes with flanges and elbows, without a valve."""
    parts = [wall(1.1)]
    for y in (-0.7, -0.4, 0.1, 0.5):
        radius = rng.uniform(0.025, 0.08)
        parts.append(upright_pipe(0.95 + rng.uniform(-0.1, 0.03), y + rng.uniform(-0.05, 0.05), radius))
    for z in (0.5, 1.2, 1.9):
        radius, x = rng.uniform(0.03, 0.06), rng.uniform(0.75, 0.9)
        flange = rng.uniform(-0.4, 0.4)
        level = cylinder((x, -1.5, z), (x, 1.5, z), radius)
        parts.append(things(level, cylinder((x, flange, z), (x, flange + 0.04, z), 1.8 * radius)))
    return parts


def workshop(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make two carts, tyres on the floor and against the wall, buckets, a plain cupboard."""
    parts = [
        wall(1.9),
        cart((1.0, 0.35, 0.0), 1.57 + rng.uniform(-0.3, 0.3)),
        cart((1.1, -1.3, 0.0), rng.uniform(0.0, 3.0)),
    ]
    parts += [tyre((1.5, -0.35, 0.1 + 0.2 * k), (0.0, 0.0, 1.0)) for k in range(2)]
    parts += [tyre((1.73, -1.0, 0.31), (1.0, 0.0, 0.3)), bucket((0.75, -0.5, 0.0)), cupboard((1.5, 0.9, 0.0))]
    return parts


def office(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make a closed room: desk with screen, chairs, pictures, cupboard, radiator."""
    parts = [make_room(1.9, -2.2, 1.8), table((1.0, -0.8, 0.0), 1.5, 0.7, 0.74)]
    parts += [chair((0.75, 0.2, 0.0), rng.uniform(-0.5, 0.5)), chair((0.3, -1.2, 0.0), rng.uniform(0.0, 6.0))]
    screen = [box((1.45, -0.3, 0.85), (1.48, 0.3, 1.2)), box((1.47, -0.04, 0.74), (1.5, 0.04, 0.9))]
    pictures = [box((1.88, y, 1.4), (1.9, y + 0.5, 1.75)) for y in (-1.2, -0.2)]
    parts += [things(*screen, *pictures), can((1.15, 0.45, 0.74), 0.04, 0.1)]
    return [*parts, cupboard((1.4, 0.95, 0.0), 0.8, 0.45), radiator((-0.4, 1.72, 0.12))]


def corridor(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make a bare corridor with a niche, a pillar and a skirting board."""
    width = rng.uniform(0.75, 0.95)
    parts = [make_room(3.5, -4.0, width), carton(1.8, -0.45, (0.3, 0.35, 0.25), 0.3)]
    skirting = [box((-4.0, side * width - 0.02, 0.0), (3.5, side * width + 0.02, 0.09)) for side in (-1.0, 1.0)]
    return [*parts, things(*skirting, box((1.2, width - 0.12, 0.0), (1.6, width, 2.6)))]


def boxes(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make stacks of cartons in front of a wall."""
    parts = [wall(1.6)]
    for y in (-0.7, -0.15, 0.4):
        z = 0.0
        for _ in range(int(rng.integers(2, 5))):
            size = (rng.uniform(0.3, 0.45), rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.4))
            parts.append(carton(1.05 + rng.uniform(-0.06, 0.06), y, size, rng.uniform(-0.3, 0.3), z))
            z += size[2]
    return [*parts, *cartons(rng, 3, (1.0, 1.3), 0.3)]


def rounds(rng: np.random.Generator) -> list[PlacedObjects]:
    """Make a clock, a porthole, a round sign on a post, a coil of hose on a hook, plates in a rack."""
    parts = [wall(1.0), upright_pipe(0.9, 0.62, 0.03, 1.2)]
    clock = [cylinder((0.96, -0.55, 1.5), (1.0, -0.55, 1.5), 0.15), torus((0.965, -0.55, 1.5), (1, 0, 0), 0.15, 0.012)]
    porthole = [torus((0.985, 0.05, 1.35), (1, 0, 0), 0.2, 0.025)]
    sign = [cylinder((0.87, 0.62, 1.2), (0.875, 0.62, 1.2), 0.2)]
    coil = [
        torus((0.93 - 0.012 * k, -0.05 + rng.normal(0.0, 0.01), 0.8 + rng.normal(0.0, 0.01)), (1, 0, 0), 0.17, 0.012)
        for k in range(4)
    ]
    hook = [cylinder((1.0, -0.05, 0.96), (0.86, -0.05, 0.96), 0.012, 16)]
    plates = [cylinder((0.8, -0.9 + 0.06 * k, 0.63), (0.8, -0.885 + 0.06 * k, 0.63), 0.13) for k in range(5)]
    return [*parts, things(*clock, *porthole, *sign, *coil, *hook, *plates), table((0.6, -1.1, 0.0), 0.6, 0.4, 0.5)]


SCENES: Mapping[str, Recipe] = {
    "empty_kitchen": Clutter(kitchen),
    "empty_pipes": Clutter(pipes),
    "empty_workshop": Clutter(workshop, (1.0, 0.0, 0.5)),
    "empty_office": Clutter(office, (1.2, 0.0, 0.8)),
    "empty_corridor": Clutter(corridor, (2.0, 0.1, 1.2)),
    "empty_boxes": Clutter(boxes, (1.0, 0.0, 0.7)),
    "empty_rounds": Clutter(rounds, (0.9, 0.0, 1.2)),
}
