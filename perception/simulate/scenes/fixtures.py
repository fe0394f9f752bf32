"""Button panels, levers on boxes, standpipes and hose ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perception.simulate.objects.fixtures import BoxLever, Panel, Standpipe
from perception.simulate.objects.placed import Placed
from perception.simulate.scenes.scene import Recipe, SimulatedScene, assemble, generator
from perception.simulate.scenes.surroundings import cartons, floor, upright_pipe, wall
from perception.simulate.scenes.valves import Vector, tilt_axis


@dataclass(frozen=True)
class ButtonPanel:
    """A panel on a wall.

    Attributes:
        buttons: x, y, radius of each in the panel's frame [m].
        size: width and height [m].
        turned_deg: of its face aside from the robot, within 3 degrees.
    """

    buttons: tuple[tuple[float, float, float], ...]
    size: tuple[float, float] = (0.22, 0.3)
    turned_deg: float = 0.0

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x, y, z = np.array([0.7, 0.05, 1.25]) + rng.uniform(-0.05, 0.05, 3)
        panel = Panel(
            (x, y, z), tilt_axis(self.turned_deg + rng.uniform(-3.0, 3.0), 0.0), *self.size, 0.1, self.buttons
        )
        behind = x + 0.08 + 0.5 * self.size[0] * abs(np.sin(np.radians(self.turned_deg)))
        parts: list[Placed] = [panel.build(), floor(), wall(behind), upright_pipe(x + 0.04, y + 0.6, 0.03)]
        parts += cartons(rng, 1, (0.5, -1.0), 0.1)
        return assemble(name, seed, parts, (x, y, z))


@dataclass(frozen=True)
class SwitchBox:
    """A lever on a box on a wall.

    Attributes:
        angle: of the lever from the horizontal, within 0.2 [rad].
        length: of the lever [m].
        turned_deg: of the box aside from the robot.
    """

    angle: float
    length: float = 0.2
    turned_deg: float = 0.0

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x, y, z = np.array([0.65, 0.0, 1.2]) + rng.uniform(-0.05, 0.05, 3)
        angle = self.angle + rng.uniform(-0.2, 0.2)
        lever = BoxLever((x, y, z), tilt_axis(self.turned_deg, 0.0), angle, self.length)
        behind = x + 0.2 + 0.15 * abs(np.sin(np.radians(self.turned_deg)))
        parts = [lever.build(), floor(), wall(behind), upright_pipe(x + 0.12, y - 0.5, 0.04)]
        return assemble(name, seed, parts, (x, y, z))


@dataclass(frozen=True)
class HoseEnd:
    """An open pipe end.

    Attributes:
        mouth: centre of the opening, within 5 cm [m].
        direction: out of it, within a few degrees.
        radius: outer [m].
        foot: height its pipe comes from [m].
        wall_x: of the wall behind [m].
    """

    mouth: Vector
    direction: Vector = (-1.0, 0.0, 0.0)
    radius: float = 0.035
    foot: float = 0.0
    wall_x: float = 1.2

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x, y, z = np.array(self.mouth) + rng.uniform(-0.05, 0.05, 3)
        out = np.array(self.direction) + rng.normal(0.0, 0.06, 3)
        a, b, c = out / np.linalg.norm(out)
        hose = Standpipe((x, y, z), (a, b, c), self.radius, foot=self.foot)
        parts = [hose.build(), floor(), wall(self.wall_x), upright_pipe(self.wall_x - 0.1, y + 0.6, 0.05)]
        return assemble(name, seed, parts, (x, y, z))


_GRID = tuple((x, y, 0.019) for y in (0.09, 0.0, -0.09) for x in (-0.05, 0.05))
SCENES: Mapping[str, Recipe] = {
    "panel_two": ButtonPanel(((0.0, 0.065, 0.032), (0.0, -0.065, 0.032))),
    "panel_grid": ButtonPanel(_GRID, (0.2, 0.3)),
    "panel_one": ButtonPanel(((0.0, 0.0, 0.045),), (0.15, 0.15)),
    "panel_oblique": ButtonPanel(((-0.09, 0.0, 0.028), (0.0, 0.0, 0.028), (0.09, 0.0, 0.028)), (0.34, 0.14), 35.0),
    "lever_box": SwitchBox(1.2),
    "lever_box_down": SwitchBox(-1.3, 0.16),
    "lever_box_across": SwitchBox(2.9, 0.24),
    "lever_box_oblique": SwitchBox(0.6, 0.2, -35.0),
    "hose_standpipe": HoseEnd((0.7, 0.1, 1.0)),
    "hose_tilted": HoseEnd((0.65, -0.1, 0.8), (-0.7, 0.0, 0.7)),
    "hose_aside": HoseEnd((0.75, 0.15, 1.0), (-0.8, -0.6, 0.0), 0.045),
    "hose_up": HoseEnd((0.65, 0.0, 0.7), (-0.2, 0.0, 1.0), 0.05),
    "hose_wide": HoseEnd((0.8, -0.05, 1.15), (-1.0, 0.1, 0.1), 0.06),
}
