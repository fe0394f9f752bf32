"""Button panels, levers on boxes, standpipes and hose ends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perception.simulate.scenes.scene import (
    PlacedObjects,
    Recipe,
    SimulatedScene,
    Truth,
    assemble,
    cartons,
    floor,
    frame,
    generator,
    pose_of,
    upright_pipe,
    wall,
)
from perception.simulate.scenes.valves import Vector, tilt_axis
from perception.solids.primitives import bent_bar, box, cylinder, lathe, pipe

_PIPE_WALL = 0.004
_STRAIGHT = 0.15  # length from the mouth to the elbow [m]


@dataclass(frozen=True)
class Panel:
    """A box on a wall with protruding round buttons.

    Attributes:
        centre: centre of the front face [m].
        normal: outward normal of the front face.
        depth: distance from the front face to the wall [m].
        buttons: x, y, radius of each, in the panel's frame [m].
        proud: height of a button above the front face [m].
    """

    centre: tuple[float, float, float]
    normal: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    width: float = 0.22
    height: float = 0.3
    depth: float = 0.1
    buttons: tuple[tuple[float, float, float], ...] = ((0.0, 0.06, 0.03), (0.0, -0.06, 0.03))
    proud: float = 0.025

    def build(self) -> PlacedObjects:
        """Build the panel; z of its frame is the normal, y is up."""
        z = np.asarray(self.normal, dtype=float) / np.linalg.norm(self.normal)
        pose = frame(self.centre, np.cross([0.0, 0.0, 1.0], z).tolist(), z.tolist())
        w, h = 0.5 * self.width, 0.5 * self.height
        meshes = [box((-w, -h, -self.depth), (w, h, 0.0))]
        sizes = {"width": self.width, "height": self.height, "n_buttons": float(len(self.buttons))}
        for i, (x, y, radius) in enumerate(self.buttons):
            head = [
                (0.0, self.proud),
                (0.8 * radius, self.proud - 0.001),
                (radius, self.proud - 0.006),
                (radius, 0.004),
            ]
            meshes.append(lathe([*head, (1.2 * radius, 0.004), (1.2 * radius, 0.0)], (x, y, 0.0)))
            sizes |= {f"button_{i}_x": x, f"button_{i}_y": y}
            sizes |= {f"button_{i}_radius": radius, f"button_{i}_height": self.proud}
        return PlacedObjects(tuple(mesh.place(pose) for mesh in meshes), (Truth("panel", pose, sizes),))


@dataclass(frozen=True)
class BoxLever:
    """A switch box with a lever on its front, as on breakers and emergency shut-offs.

    Attributes:
        pivot: intersection of the lever's centre line with its pivot axis [m].
        normal: normal of the box's front; also the pivot axis.
        angle: angle of the lever about the pivot axis, from the horizontal x of the box [rad].
        length: distance from the pivot to the lever's end [m].
        stand_off: distance of the lever's centre line from the front [m].
    """

    pivot: tuple[float, float, float]
    normal: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    angle: float = 1.2
    length: float = 0.2
    radius: float = 0.012
    stand_off: float = 0.055
    width: float = 0.3
    height: float = 0.4
    depth: float = 0.15

    def build(self) -> PlacedObjects:
        """Return box, hub and lever."""
        z = np.asarray(self.normal, dtype=float) / np.linalg.norm(self.normal)
        front = frame(self.pivot, np.cross([0.0, 0.0, 1.0], z).tolist(), z.tolist())
        w, h, off = 0.5 * self.width, 0.5 * self.height, self.stand_off
        end = (self.length - self.radius) * np.array([np.cos(self.angle), np.sin(self.angle), 0.0])
        meshes = [
            box((-w, -h, -off - self.depth), (w, h, -off)),
            cylinder((0.0, 0.0, -off), (0.0, 0.0, 0.5 * self.radius), 1.6 * self.radius, 24),
            bent_bar([(0.0, 0.0, 0.0), end.tolist()], self.radius),
        ]
        pose = front @ pose_of((0.0, 0.0, 0.0), yaw=self.angle)
        truth = Truth("lever", pose, {"length": self.length, "radius": self.radius})
        return PlacedObjects(tuple(mesh.place(front) for mesh in meshes), (truth,))


@dataclass(frozen=True)
class Standpipe:
    """A pipe from the floor with an elbow, a coupling ring and an open end.

    Attributes:
        direction: unit vector out of the opening.
        radius: outer radius of the end [m].
    """

    mouth: tuple[float, float, float]
    direction: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    radius: float = 0.035

    def build(self) -> PlacedObjects:
        """Build the pipe; z of its frame points out of the mouth; the truth's ``radius`` is the outer one there."""
        out = np.asarray(self.direction, dtype=float) / np.linalg.norm(self.direction)
        mouth = np.array(self.mouth)
        back = mouth - _STRAIGHT * out
        meshes = [
            pipe(back.tolist(), mouth.tolist(), self.radius, _PIPE_WALL),
            bent_bar([back.tolist(), [back[0], back[1], 0.0]], self.radius),
        ]
        ring = mouth - 0.4 * _STRAIGHT * out
        wall_of_ring = 0.3 * self.radius + _PIPE_WALL
        meshes.append(pipe((ring - 0.03 * out).tolist(), ring.tolist(), 1.3 * self.radius, wall_of_ring))
        sideways = np.cross([0.0, 0.0, 1.0], out) if abs(out[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
        truth = Truth("hose", frame(self.mouth, sideways.tolist(), out.tolist()), {"radius": self.radius})
        return PlacedObjects(tuple(meshes), (truth,))


@dataclass(frozen=True)
class ButtonPanel:
    """Scene with a button panel on a wall.

    Attributes:
        buttons: x, y, radius of each in the panel's frame [m].
        turned_deg: yaw of its face away from the robot, varied by 3 degrees.
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
        parts = [panel.build(), floor(), wall(behind), upright_pipe(x + 0.04, y + 0.6, 0.03)]
        parts += cartons(rng, 1, (0.5, -1.0), 0.1)
        return assemble(name, seed, parts, (x, y, z))


@dataclass(frozen=True)
class SwitchBox:
    """Scene with a lever on a box on a wall.

    Attributes:
        angle: angle of the lever from the horizontal, varied by 0.2 [rad].
        turned_deg: yaw of the box away from the robot.
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
    """Scene with an open pipe end.

    Attributes:
        mouth: centre of the opening, varied by 5 cm [m].
        direction: direction out of the opening, varied by a few degrees.
        radius: outer radius [m].
    """

    mouth: Vector
    direction: Vector = (-1.0, 0.0, 0.0)
    radius: float = 0.035

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x, y, z = np.array(self.mouth) + rng.uniform(-0.05, 0.05, 3)
        out = np.array(self.direction) + rng.normal(0.0, 0.06, 3)
        a, b, c = out / np.linalg.norm(out)
        hose = Standpipe((x, y, z), (a, b, c), self.radius)
        parts = [hose.build(), floor(), wall(1.2), upright_pipe(1.2 - 0.1, y + 0.6, 0.05)]
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
