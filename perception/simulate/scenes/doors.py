"""Doors in frames in walls: hinges left and right, pull and push side, shut and ajar, with handles of every kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry, HandleKind
from perception.simulate.scenes.handles import (
    BAR_HALF_DEPTH,
    BAR_HALF_HEIGHT,
    BAR_INSET,
    KNOB_DEPTH,
    KNOB_RADIUS,
    STANDOFFS,
    knob,
    lever,
    pull,
    push_bar,
    push_plate,
)
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
from perception.solids.primitives import Mesh, box, cylinder

Furniture = Literal["lever", "knob", "bar", "pull", "plate", "none"]
FarFurniture = Literal["lever", "knob", "pull", "plate", "none"]

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
        furniture: handle on the visible face.
        lever_length: distance from the spindle to the lever's end [m].
        lever_turn: angle by which the levers are turned down [rad].
        handle_radius: of a lever's or pull handle's bar [m].
        pull_length: of a pull handle's bar [m].
        standoff: distance of the handle's centre line from the face [m]; None: usual for its kind.
        recess: distance by which a leaf on its pull side stands back behind the wall's face [m].
        gap: between leaf and lining [m].
        reveal: width of the lining's edge between opening and casing [m].
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
    furniture: Furniture = "lever"
    handle_z: float = 1.02
    backset: float = 0.07
    lever_length: float = 0.125
    lever_turn: float = 0.0
    handle_radius: float = 0.01
    pull_length: float = 0.35
    standoff: float | None = None
    recess: float = 0.0
    gap: float = _GAP
    reveal: float = 0.01
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
        face = self._face
        pin = np.array([0.0, face - (0.0 if self.side == "pull" else self.thickness), 0.0])
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = pin + turn @ (np.array([0.0, face, 0.0]) - pin)
        return pose

    def _surround(self) -> list[Mesh]:
        """Return the wall around the opening, the lining with stops, and the casing on the visible side."""
        left, right, top = -self.gap, self.width + self.gap, self.height + self.gap
        back = -self.wall_thickness
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
                box((low - 0.03, y, 0.0), (left - self.reveal, outer, top + _CASING)),
                box((right + self.reveal, y, 0.0), (high + 0.03, outer, top + _CASING)),
                box((low - 0.03, y, top + self.reveal), (high + 0.03, outer, top + _CASING)),
            ]
        # Stop of the closed leaf.
        stop = self._face - self.thickness - 0.002 if self.side == "pull" else self._face + 0.002
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

    def shut_meshes(self) -> list[Mesh]:
        """Return the slab and its furniture on the visible side in the world, leaf shut and lever at rest."""
        place = self._wall_frame()
        place[:3, 3] += self._face * place[:3, 1]
        slab = box((0.0, -self.thickness, _OVER_FLOOR), (self.width, 0.0, self.height))
        return [mesh.place(place) for mesh in (slab, *self._furniture(0.0, 1.0, at_rest=True))]

    @property
    def _face(self) -> float:
        """Position of the shut leaf's visible face out of the wall's visible face [m]."""
        return -self.recess if self.side == "pull" else -(self.wall_thickness - self.thickness)

    @property
    def _spindle_x(self) -> float:
        return self.width - self.backset

    @property
    def _far_kind(self) -> FarFurniture:
        """Furniture of the face away from the viewer."""
        if self.furniture == "bar":
            return "lever"
        if self.furniture == "pull":
            return "plate" if self.side == "pull" else "pull"
        return "pull" if self.furniture == "plate" else self.furniture

    def _turned(self, mesh: Mesh) -> Mesh:
        """Return a lever's mesh turned down about its spindle."""
        c, s = np.cos(self.lever_turn), np.sin(self.lever_turn)
        turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
        spindle = np.array([self._spindle_x, 0.0, self.handle_z])
        return mesh.move(turn, spindle - turn @ spindle)

    def _furniture(self, face: float, out: float, *, at_rest: bool = False) -> list[Mesh]:
        """Return the meshes on one face, at y = ``face`` with outward direction ``out`` along y, -1 or 1."""
        place = (self._spindle_x, face, self.handle_z)
        match self.furniture if out > 0.0 else self._far_kind:
            case "knob":
                return [knob(place, out)]
            case "bar":
                return push_bar(self.width, face, self.handle_z, self._standoff)
            case "pull":
                return pull(place, out, self._standoff, self.pull_length, self.handle_radius)
            case "plate":
                return [push_plate(place, out)]
            case "lever":
                rose, bar = lever(place, out, self._lever_standoff, self.lever_length, self.handle_radius)
                return [rose, bar if at_rest else self._turned(bar)]
            case _:
                return []

    @property
    def _lever_standoff(self) -> float:
        return self._standoff if self.furniture == "lever" else STANDOFFS["lever"]

    @property
    def _standoff(self) -> float:
        """Distance of the handle's centre line from the leaf's face [m]."""
        return self.standoff if self.standoff is not None else STANDOFFS.get(self.furniture, 0.0)

    def _handle(self) -> tuple[float, float, float] | None:
        """Return x, distance from the visible face, and z of the lever's pivot or another handle's centre [m]."""
        if self.furniture in ("plate", "none"):
            return None
        return 0.5 * self.width if self.furniture == "bar" else self._spindle_x, self._standoff, self.handle_z

    def _truth(self, leaf_frame: Float[np.ndarray, "4 4"]) -> Truth:
        """Return the truth in the leaf's right-handed frame; y is the normal of the visible side or its opposite."""
        side = 1.0 if np.linalg.det(leaf_frame[:3, :3]) > 0.0 else -1.0
        pose = leaf_frame.copy()
        pose[:3, 1] *= side
        sizes = {
            "width": self.width,
            "height": self.height,
            "ajar": self.ajar,
            "lever_direction": -1.0 if self.furniture == "lever" else 0.0,
            "side": side,
        }
        handle = self._handle()
        if handle is not None:
            x, depth, z = handle
            sizes |= {"handle_x": x, "handle_y": side * depth, "handle_z": z}
        return Truth("door", pose, sizes)

    def _lookalikes(self, leaf_frame: Float[np.ndarray, "4 4"]) -> tuple[tuple[str, Float[np.ndarray, "3"]], ...]:
        """Return positions on a lever handle, which the lever detector may find; empty for other handles."""
        handle = self._handle()
        if self.furniture != "lever" or handle is None:
            return ()
        x, depth, z = handle
        half = 0.5 * self.lever_length
        middle = (x - half * np.cos(self.lever_turn), depth, z - half * np.sin(self.lever_turn), 1.0)
        places = [(x, depth, z, 1.0), middle]
        return tuple(("lever", (leaf_frame @ np.array(place))[:3]) for place in places)


def truth_geometry(door: Door) -> DoorGeometry:
    """Return the true geometry of a simulated door, its handle the one on the visible side of the wall."""
    frame = door._wall_frame()
    along, normal, origin = frame[:3, 0], frame[:3, 1], frame[:3, 3]
    face = 0.0 if door.side == "pull" else door.thickness
    hinge = origin + (door._face - face) * normal + _OVER_FLOOR * UP
    return DoorGeometry(
        hinge,
        along,
        normal,
        face,
        door.width,
        door.height - _OVER_FLOOR,
        door.thickness,
        door.side,
        door.ajar,
        _true_handle(door, origin + door._face * normal, along, normal),
        door.lever_turn if door.furniture == "lever" else 0.0,
    )


def _true_handle(
    door: Door, corner: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]
) -> HandleGeometry | None:
    """Return the handle on the face whose hinge edge meets the floor at ``corner``; None without one."""
    place = door._handle()
    if place is None:
        return None
    centre = corner + place[0] * along + place[1] * normal + place[2] * UP
    kinds: dict[str, tuple[HandleKind, Float[np.ndarray, "3"], float, float, float | None]] = {
        "lever": ("lever", -along, door.lever_length, door.handle_radius, None),
        "pull": ("pull", UP, door.pull_length, door.handle_radius, None),
        "bar": ("push_bar", along, door.width - 2.0 * BAR_INSET, BAR_HALF_DEPTH, 2.0 * BAR_HALF_HEIGHT),
        "knob": ("knob", normal, KNOB_DEPTH, KNOB_RADIUS, None),
    }
    kind, direction, length, radius, height = kinds[door.furniture]
    return HandleGeometry(kind, centre, direction, length, radius, height)


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
        lever_turn_deg: angle by which the levers are turned down.
        corridor: half the width of the corridor around the robot [m]; None: no side walls.
    """

    hinge_on: Literal["left", "right"]
    side: Literal["pull", "push"] = "pull"
    ajar_deg: float = 0.0
    furniture: Furniture = "lever"
    width: float = 0.9
    distance: float = 0.85
    turned_deg: float = 0.0
    corridor: float | None = None
    lever_turn_deg: float = 0.0

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
        height, lever_turn = rng.uniform(0.95, 1.1), float(np.radians(self.lever_turn_deg))
        door = Door(*place, furniture=self.furniture, handle_z=height, lever_turn=lever_turn)
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
    "door_left_pull": Doorway("left", furniture="pull"),
    "door_right_lever_turned": Doorway("right", lever_turn_deg=25.0),
    "door_oblique": Doorway("left", distance=1.1, turned_deg=25.0),
    "door_oblique_ajar": Doorway("right", "push", 12.0, distance=1.1, turned_deg=-30.0),
    "door_corridor": Doorway("left", distance=1.2, corridor=0.8, width=0.85),
    "door_far": Doorway("right", distance=1.8, width=0.95),
}
