"""Doors: hinges left and right, pull and push side, shut and ajar, lever, knob and panic bar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from perception.simulate.mesh import box
from perception.simulate.objects.doors import Door
from perception.simulate.objects.placed import Placed, things
from perception.simulate.scenes.scene import Recipe, SimulatedScene, assemble, generator
from perception.simulate.scenes.surroundings import cartons, floor, side_walls


@dataclass(frozen=True)
class Doorway:
    """A door in a wall before the robot.

    Attributes:
        hinge_on: the side, as the robot sees it.
        side: the robot is on: "pull", the door opens towards it, or "push".
        ajar_deg: how far it is open, within 4 degrees; 0: shut.
        furniture: what opens it.
        width: of the leaf, within 3 cm [m].
        distance: of the doorway's middle, within 8 cm [m].
        turned_deg: of the wall about z, from square to the robot, within 3 degrees.
        corridor: half the width of the corridor the robot stands in [m]; None: no walls beside it.
    """

    hinge_on: Literal["left", "right"]
    side: Literal["pull", "push"] = "pull"
    ajar_deg: float = 0.0
    furniture: Literal["lever", "knob", "bar"] = "lever"
    width: float = 0.9
    distance: float = 0.85
    turned_deg: float = 0.0
    corridor: float | None = None

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        width = self.width + rng.uniform(-0.03, 0.03)
        turned = np.radians(self.turned_deg + rng.uniform(-3.0, 3.0))
        # From hinge to latch: to the robot's right when the hinges are on its left.
        along = (-0.5 if self.hinge_on == "left" else 0.5) * np.pi + turned
        middle = np.array([self.distance, 0.0]) + rng.uniform(-0.08, 0.08, 2)
        hinge = middle - 0.5 * width * np.array([np.cos(along), np.sin(along)])
        ajar = np.radians(self.ajar_deg + rng.uniform(-4.0, 4.0)) if self.ajar_deg else 0.0
        place = ((hinge[0], hinge[1]), along, self.hinge_on, self.side, ajar, width)
        door = Door(*place, furniture=self.furniture, handle_z=rng.uniform(0.95, 1.1))
        parts: list[Placed] = [door.build(), floor(), things(box((3.5, -4.0, 0.0), (3.6, 4.0, 2.6)))]
        if self.corridor is not None:
            parts.append(side_walls(self.corridor, middle[0] - 0.1))
        else:
            parts += cartons(rng, 2, (0.35, -1.5 if self.hinge_on == "left" else 1.5), 0.2)
        return assemble(name, seed, parts, (middle[0], middle[1], 1.1))


SCENES: Mapping[str, Recipe] = {
    "door_left_shut": Doorway("left"),
    "door_right_shut": Doorway("right"),
    "door_left_ajar": Doorway("left", ajar_deg=20.0, distance=1.0),
    "door_right_half_open": Doorway("right", ajar_deg=45.0, distance=1.15),
    "door_left_wide_open": Doorway("left", ajar_deg=75.0, distance=1.45),
    "door_left_push_shut": Doorway("left", "push"),
    "door_right_push_ajar_knob": Doorway("right", "push", 25.0, "knob"),
    "door_left_push_half_open": Doorway("left", "push", 50.0),
    "door_right_bar": Doorway("right", "push", furniture="bar"),
    "door_left_bar_ajar": Doorway("left", "push", 15.0, "bar", width=1.0),
    "door_right_knob": Doorway("right", furniture="knob", width=0.82),
    "door_oblique": Doorway("left", distance=1.1, turned_deg=25.0),
    "door_oblique_ajar": Doorway("right", "push", 12.0, distance=1.1, turned_deg=-30.0),
    "door_corridor": Doorway("left", distance=1.2, corridor=0.8, width=0.85),
    "door_far": Doorway("right", distance=1.8, width=0.95),
}
