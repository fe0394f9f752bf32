"""Doors in frames in walls: hinges left and right, pull and push side, shut and ajar, lever, knob and panic bar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from perception.simulate.mesh import Mesh, bent_bar, box, cylinder, lathe
from perception.simulate.scenes.scene import (
    PlacedObjects,
    Recipe,
    SimulatedScene,
    Truth,
    assemble,
    cartons,
    floor,
    generator,
    side_walls,
    things,
)

_GAP = 0.004
_OVER_FLOOR = 0.008
_CASING = 0.065
_CASING_DEPTH = 0.016
_BEHIND = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Door:
    """A door in a wall.

    Attributes:
        hinge: intersection of the hinge axis with the floor, on the wall's visible face: x, y [m].
        along: horizontal direction of the wall from hinge to latch, as an angle about z from x [rad].
        hinge_on: side of the hinges as seen by the viewer.
        side: "pull": it opens towards the viewer; "push": away, with the leaf recessed in its frame.
        ajar: opening angle [rad].
        height: height of the leaf's top above the floor [m].
        handle_z: height of the handle above the floor [m].
        backset: distance from the leaf's free edge to the handle's spindle [m].
        lever_length: distance from the spindle to the lever's end [m].
        wall_reach: width of the wall beside the frame, on hinge side and latch side [m].
        eye: x, y of the viewer, which decides which face of an open leaf is visible [m].
    """

    hinge: tuple[float, float] = (0.9, 0.45)
    along: float = -np.pi / 2.0
    hinge_on: Literal["left", "right"] = "left"
    side: Literal["pull", "push"] = "pull"
    ajar: float = 0.0
    width: float = 0.9
    height: float = 2.03
    thickness: float = 0.045
    furniture: Literal["lever", "knob", "bar"] = "lever"
    handle_z: float = 1.02
    backset: float = 0.07
    lever_length: float = 0.125
    wall_thickness: float = 0.12
    wall_reach: tuple[float, float] = (1.2, 1.2)
    wall_height: float = 2.6
    eye: tuple[float, float] = (0.1, 0.0)

    def build(self) -> PlacedObjects:
        """Return wall, frame, leaf and handles on both sides, with the truth in the detector's frame."""
        to_world = self._wall_frame()
        leaf_frame = to_world @ self._leaf_in_wall()
        meshes = [mesh.place(to_world) for mesh in self._surround()]
        meshes += [mesh.place(leaf_frame) for mesh in self._leaf()]
        seen = leaf_frame
        if (np.linalg.inv(leaf_frame) @ [*self.eye, 0.0, 1.0])[1] < -0.5 * self.thickness:
            seen = leaf_frame @ _BEHIND
            seen[:3, 3] -= self.thickness * leaf_frame[:3, 1]
        return PlacedObjects(tuple(meshes), (self._truth(seen),), self._lookalikes(seen))

    def _wall_frame(self) -> Float[np.ndarray, "4 4"]:
        """Return the wall's (4, 4) frame: x from hinge to latch, y towards the viewer, z up; may be left-handed."""
        u = np.array([np.cos(self.along), np.sin(self.along), 0.0])
        out = np.cross([0.0, 0.0, 1.0], u) * (1.0 if self.hinge_on == "right" else -1.0)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([u, out, [0.0, 0.0, 1.0]])
        pose[:2, 3] = self.hinge
        return pose

    def _leaf_in_wall(self) -> Float[np.ndarray, "4 4"]:
        """Return the leaf's pose in the wall's frame: x along it, y out of the visible face, origin on its hinge."""
        opening = self.ajar if self.side == "pull" else -self.ajar
        c, s = np.cos(opening), np.sin(opening)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        # The hinge pin is on the face towards which the door opens: the visible one, or the one behind it.
        face = 0.0 if self.side == "pull" else -(self.wall_thickness - self.thickness)
        pin = np.array([0.0, face - (0.0 if self.side == "pull" else self.thickness), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = pin + turn @ (np.array([0.0, face, 0.0]) - pin)
        return pose

    def _surround(self) -> list[Mesh]:
        """Return the wall around the opening, the lining with stops, and the casing on the visible side."""
        left, right, top = -_GAP, self.width + _GAP, self.height + _GAP
        back, depth = -self.wall_thickness, self.wall_thickness
        lining = 0.035
        low, high = left - lining, right + lining
        parts = [
            box((low - self.wall_reach[0], back, 0.0), (low, 0.0, self.wall_height)),
            box((high, back, 0.0), (high + self.wall_reach[1], 0.0, self.wall_height)),
            box((low, back, top + lining), (high, 0.0, self.wall_height)),
            box((low, back, 0.0), (left, 0.002, top + lining)),
            box((right, back, 0.0), (high, 0.002, top + lining)),
            box((low, back, top), (high, 0.002, top + lining)),
        ]
        for y in (0.002, back - _CASING_DEPTH):
            outer = y + _CASING_DEPTH
            parts += [
                box((low - 0.03, y, 0.0), (left - 0.01, outer, top + _CASING)),
                box((right + 0.01, y, 0.0), (high + 0.03, outer, top + _CASING)),
                box((low - 0.03, y, top + 0.01), (high + 0.03, outer, top + _CASING)),
            ]
        # Stop of the closed leaf.
        stop = -self.thickness - 0.002 if self.side == "pull" else -(depth - self.thickness) + 0.002
        ends = (stop - 0.015, stop) if self.side == "pull" else (stop, stop + 0.015)
        parts += [
            box((left, ends[0], 0.0), (left + 0.012, ends[1], top)),
            box((right - 0.012, ends[0], 0.0), (right, ends[1], top)),
            box((left, ends[0], top - 0.012), (right, ends[1], top)),
        ]
        return parts

    def _leaf(self) -> list[Mesh]:
        """Return leaf, hinges and handles; y = 0 is the visible face."""
        parts = [box((0.0, -self.thickness, _OVER_FLOOR), (self.width, 0.0, self.height))]
        pin = 0.006 if self.side == "pull" else -self.thickness - 0.006
        for z in (0.22, 0.5 * self.height, self.height - 0.2):
            parts.append(cylinder((-0.002, pin, z - 0.05), (-0.002, pin, z + 0.05), 0.007, 16))
        parts += self._furniture(0.0, 1.0) + self._furniture(-self.thickness, -1.0)
        return parts

    @property
    def _spindle_x(self) -> float:
        return self.width - self.backset

    def _furniture(self, face: float, out: float) -> list[Mesh]:
        x, z = self._spindle_x, self.handle_z
        place = (x, face, z)
        axis = (0.0, out, 0.0)
        if self.furniture == "knob":
            profile = [
                (0.0, 0.068),
                (0.016, 0.066),
                (0.026, 0.056),
                (0.027, 0.046),
                (0.02, 0.036),
                (0.011, 0.028),
                (0.011, 0.008),
                (0.032, 0.006),
                (0.032, 0.0),
            ]
            return [lathe(profile, place, axis)]
        if self.furniture == "bar" and out > 0.0:
            y = face + 0.055
            ends = [
                box((end - 0.04, face, z - 0.03), (end + 0.04, face + 0.07, z + 0.03))
                for end in (0.09, self.width - 0.09)
            ]
            return [*ends, box((0.09, y - 0.012, z - 0.02), (self.width - 0.09, y + 0.012, z + 0.02))]
        rose = lathe([(0.0, 0.01), (0.026, 0.009), (0.027, 0.0)], place, axis)
        depth = face + out * self._lever_depth
        lever = bent_bar([(x, face, z), (x, depth, z), (x - self.lever_length + 0.01, depth, z)], 0.01)
        return [rose, lever]

    @property
    def _lever_depth(self) -> float:
        """Distance of the lever's centre line from the leaf's face [m]."""
        return 0.052

    def _handle(self) -> tuple[float, float, float]:
        """Return x, distance from the visible face, and z of the lever's pivot or the knob's or bar's centre [m]."""
        if self.furniture == "lever":
            return self._spindle_x, self._lever_depth, self.handle_z
        if self.furniture == "knob":
            return self._spindle_x, 0.05, self.handle_z
        return 0.5 * self.width, 0.055, self.handle_z

    def _truth(self, leaf_frame: Float[np.ndarray, "4 4"]) -> Truth:
        """Return the truth in the leaf's right-handed frame; y is the normal of the visible side or its opposite."""
        side = 1.0 if np.linalg.det(leaf_frame[:3, :3]) > 0.0 else -1.0
        pose = leaf_frame.copy()
        pose[:3, 1] *= side
        x, depth, z = self._handle()
        sizes = {
            "width": self.width,
            "height": self.height,
            "ajar": self.ajar,
            "handle_x": x,
            "handle_y": side * depth,
            "handle_z": z,
            "lever_direction": -1.0 if self.furniture == "lever" else 0.0,
            "side": side,
        }
        return Truth("door", pose, sizes)

    def _lookalikes(self, leaf_frame: Float[np.ndarray, "4 4"]) -> tuple[tuple[str, Float[np.ndarray, "3"]], ...]:
        """Return positions on a lever handle, which the lever detector may find; empty for other handles."""
        if self.furniture != "lever":
            return ()
        x, depth, z = self._handle()
        places = [(x, depth, z, 1.0), (x - 0.5 * self.lever_length, depth, z, 1.0)]
        return tuple(("lever", (leaf_frame @ np.array(place))[:3]) for place in places)


@dataclass(frozen=True)
class Doorway:
    """Scene with a door in a wall in front of the robot.

    Attributes:
        hinge_on: side of the hinges as seen by the robot.
        side: the robot's side: "pull" if the door opens towards it, or "push".
        ajar_deg: opening angle, varied by 4 degrees; 0: closed.
        width: width of the leaf, varied by 3 cm [m].
        distance: distance of the doorway's centre, varied by 8 cm [m].
        turned_deg: rotation of the wall about z, from normal to the robot's view, varied by 3 degrees.
        corridor: half the width of the corridor around the robot [m]; None: no side walls.
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
        # Direction from hinge to latch: to the robot's right if the hinges are on its left.
        along = (-0.5 if self.hinge_on == "left" else 0.5) * np.pi + turned
        middle = np.array([self.distance, 0.0]) + rng.uniform(-0.08, 0.08, 2)
        hinge = middle - 0.5 * width * np.array([np.cos(along), np.sin(along)])
        ajar = np.radians(self.ajar_deg + rng.uniform(-4.0, 4.0)) if self.ajar_deg else 0.0
        place = ((hinge[0], hinge[1]), along, self.hinge_on, self.side, ajar, width)
        door = Door(*place, furniture=self.furniture, handle_z=rng.uniform(0.95, 1.1))
        parts = [door.build(), floor(), things(box((3.5, -4.0, 0.0), (3.6, 4.0, 2.6)))]
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
