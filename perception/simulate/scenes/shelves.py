"""Drills among other tools, on shelves and tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perception.simulate.scenes.loose import Drill, bucket, can, pot, shelf, table
from perception.simulate.scenes.scene import (
    PlacedObjects,
    Recipe,
    SimulatedScene,
    assemble,
    floor,
    generator,
    things,
    wall,
)
from perception.solids.primitives import bent_bar, box, cylinder


def tools(x: float, y: float, z: float) -> PlacedObjects:
    """Return a hammer and a screwdriver, lying on a board near the given position."""
    return things(
        bent_bar([(x - 0.1, y, z + 0.018), (x + 0.18, y + 0.05, z + 0.018)], 0.015),
        cylinder((x + 0.15, y - 0.02, z + 0.02), (x + 0.2, y + 0.13, z + 0.02), 0.02, 24),
        bent_bar([(x - 0.1, y - 0.08, z + 0.012), (x, y - 0.1, z + 0.012)], 0.011),
        bent_bar([(x, y - 0.1, z + 0.006), (x + 0.12, y - 0.12, z + 0.006)], 0.004),
    )


@dataclass(frozen=True)
class ToolRack:
    """Scene with a rack with boards at 0.1, 0.45, 0.9 and 1.35 m; on it drills, tools, tins, a pot and a bucket.

    Attributes:
        drills: y, board height [m] and yaw of the chuck [deg] of each, varied by 5 cm and 15 degrees.
    """

    drills: tuple[tuple[float, float, float], ...]

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x = 0.62 + rng.uniform(-0.04, 0.04)
        parts = [
            floor(),
            wall(x + 0.5),
            shelf((x, -0.6, 0.0), 1.2, 0.42, (0.1, 0.45, 0.9, 1.35), 1.8),
        ]
        for y, z, yaw in self.drills:
            place = (x + 0.16 + rng.uniform(-0.03, 0.03), y + rng.uniform(-0.05, 0.05), z)
            parts.append(Drill(place, np.radians(yaw + rng.uniform(-15.0, 15.0))).build())
        parts += [tools(x + 0.15, -0.4, 0.9), can((x + 0.2, 0.42, 0.9)), can((x + 0.25, 0.3, 0.9), 0.04, 0.2)]
        parts += [pot((x + 0.2, 0.3, 0.45)), bucket((x + 0.2, -0.35, 0.1), 0.13, 0.25)]
        parts.append(things(box((x + 0.08, 0.1, 1.35), (x + 0.34, 0.5, 1.55))))
        return assemble(name, seed, parts, (x + 0.16, self.drills[0][0], self.drills[0][1] + 0.1))


@dataclass(frozen=True)
class Workbench:
    """Scene with a table; on it a drill, tools, a tin and a box.

    Attributes:
        yaw: yaw of the chuck, varied by 20 degrees [deg].
    """

    yaw: float

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        parts = [floor(), wall(1.4), table((0.5, -0.7, 0.0), 1.4, 0.7, 0.8)]
        place = (0.7, 0.08 + rng.uniform(-0.1, 0.1), 0.8)
        parts.append(Drill(place, np.radians(self.yaw + rng.uniform(-20.0, 20.0))).build())
        parts += [tools(0.7, -0.3, 0.8), can((0.9, 0.4, 0.8)), things(box((0.95, -0.2, 0.8), (1.15, 0.2, 1.0)))]
        return assemble(name, seed, parts, (0.7, 0.0, 0.9))


SCENES: Mapping[str, Recipe] = {
    "drill_shelf": ToolRack(((0.02, 0.9, 70.0),)),
    "drill_shelf_away": ToolRack(((-0.1, 0.9, 20.0),)),
    "drill_shelf_two": ToolRack(((0.0, 0.9, -80.0), (-0.2, 1.35, 120.0))),
    "drill_bench": Workbench(100.0),
    "drill_bench_towards": Workbench(200.0),
}
