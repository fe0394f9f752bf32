"""Objects fixed to walls: button panels, levers on boxes, and standpipes with their open ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.simulate.mesh import bent_bar, box, cylinder, lathe, pipe
from perception.simulate.objects.placed import Placed, Truth, frame, pose_of


@dataclass(frozen=True)
class Panel:
    """A box on a wall with round buttons that stand out.

    Attributes:
        centre: of the front face [m].
        normal: of the front face, out.
        width: [m].
        height: [m].
        depth: from the front face to the wall [m].
        buttons: x, y, radius of each, in the panel's frame [m].
        proud: how far a button stands out [m].
    """

    centre: tuple[float, float, float]
    normal: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    width: float = 0.22
    height: float = 0.3
    depth: float = 0.1
    buttons: tuple[tuple[float, float, float], ...] = ((0.0, 0.06, 0.03), (0.0, -0.06, 0.03))
    proud: float = 0.025

    def build(self) -> Placed:
        """Build it; z of its frame is the normal, y is up."""
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
            sizes |= {f"button_{i}_x": x, f"button_{i}_y": y, f"button_{i}_radius": radius}
        return Placed(tuple(mesh.placed(pose) for mesh in meshes), (Truth("panel", pose, sizes),))


@dataclass(frozen=True)
class BoxLever:
    """A switch box with a lever on its front, as on breakers and emergency shut-offs.

    Attributes:
        pivot: where the lever's middle line meets its pivot axis [m].
        normal: of the box's front, the pivot axis.
        angle: of the lever about the pivot axis, from the horizontal x of the box [rad].
        length: from the pivot to the lever's end [m].
        radius: of the lever [m].
        stand_off: of the lever's middle line over the front [m].
        width: of the box [m].
        height: of the box [m].
        depth: of the box [m].
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

    def build(self) -> Placed:
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
        return Placed(tuple(mesh.placed(front) for mesh in meshes), (truth,))


@dataclass(frozen=True)
class Standpipe:
    """A pipe with an elbow and an open threaded end, or a hose's coupling held the same way.

    Attributes:
        mouth: centre of the opening [m].
        direction: out of the opening, unit.
        radius: outer, of the end [m].
        wall: thickness at the end [m].
        straight: length of the end piece before the elbow [m].
        foot: where the pipe comes from: 0 the floor, otherwise a height [m].
        collar: whether a wider coupling ring sits behind the end.
    """

    mouth: tuple[float, float, float]
    direction: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    radius: float = 0.035
    wall: float = 0.004
    straight: float = 0.15
    foot: float = 0.0
    collar: bool = True

    def build(self) -> Placed:
        """Build it; z of its frame points out; ``radius`` is the outer one at the mouth."""
        out = np.asarray(self.direction, dtype=float) / np.linalg.norm(self.direction)
        mouth = np.array(self.mouth)
        back = mouth - self.straight * out
        meshes = [
            pipe(back.tolist(), mouth.tolist(), self.radius, self.wall),
            bent_bar([back.tolist(), [back[0], back[1], self.foot]], self.radius),
        ]
        if self.collar:
            ring = mouth - 0.4 * self.straight * out
            meshes.append(
                pipe((ring - 0.03 * out).tolist(), ring.tolist(), 1.3 * self.radius, 0.3 * self.radius + self.wall)
            )
        sideways = np.cross([0.0, 0.0, 1.0], out) if abs(out[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
        truth = Truth("hose", frame(self.mouth, sideways.tolist(), out.tolist()), {"radius": self.radius})
        return Placed(tuple(meshes), (truth,))
