"""An open utility vehicle without doors, seen from its passenger seat and from outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.simulate.scenes.scene import (
    PlacedObjects,
    Recipe,
    SimulatedScene,
    Truth,
    assemble,
    carton,
    floor,
    frame,
    generator,
    pose_of,
)
from perception.solids.primitives import Mesh, bent_bar, box, cylinder, hull, torus


@dataclass(frozen=True)
class Car:
    """A two-seater; its frame is x forward, y left, z up, with its origin on the ground midway between the seats.

    Attributes:
        place: x, y of its frame's origin in the world [m].
        floor: height of its floor above the ground [m].
        seat_height: height of the cushion's top above the car's floor [m].
        seat_y: lateral distance of the cushions' centres from the middle [m].
        opening: length from the body behind the seats to the front fender [m].
        roof: height of the roof's underside above the ground [m].
    """

    place: tuple[float, float] = (0.0, 0.0)
    yaw: float = 0.0
    floor: float = 0.4
    half_width: float = 0.72
    seat_width: float = 0.52
    seat_depth: float = 0.46
    seat_height: float = 0.42
    seat_y: float = 0.34
    opening: float = 0.95
    roof: float = 1.86

    @property
    def _rear(self) -> float:
        """x of the body's edge behind the opening [m]."""
        return -0.5 * self.seat_depth - 0.12

    def build(self) -> PlacedObjects:
        """Build the car; the steering wheel is a lookalike of a wheel valve."""
        world = pose_of((*self.place, 0.0), yaw=self.yaw)
        meshes = [*self._body(), *self._cabin(), *self._road_wheels()]
        truth = [Truth(kind, world @ pose, sizes) for kind, pose, sizes in (*self._seats(), *self._openings())]
        wheel = (world @ np.array([*self._steering, 1.0]))[:3]
        return PlacedObjects(tuple(mesh.place(world) for mesh in meshes), tuple(truth), (("valve", wheel),))

    @property
    def _steering(self) -> tuple[float, float, float]:
        return 0.44, self.seat_y, self.floor + 0.68

    def _seats(self) -> list[tuple[str, Float[np.ndarray, "4 4"], dict[str, float]]]:
        sizes = {"width": self.seat_width, "depth": self.seat_depth, "height": self.seat_height}
        top = self.floor + self.seat_height
        return [("seat", pose_of((0.0, side * self.seat_y, top)), sizes) for side in (1.0, -1.0)]

    def _openings(self) -> list[tuple[str, Float[np.ndarray, "4 4"], dict[str, float]]]:
        middle = self._rear + 0.5 * self.opening
        sizes = {"width": self.opening, "height": self.roof - self.floor, "sill": self.floor}
        return [
            ("opening", frame((middle, side * self.half_width, self.floor), (0.0, side, 0.0), (0.0, 0.0, 1.0)), sizes)
            for side in (1.0, -1.0)
        ]

    def _body(self) -> list[Mesh]:
        """Return floor pan, rear deck, hood, fenders, posts, roof."""
        w, z, rear = self.half_width, self.floor, self._rear
        front = rear + self.opening
        low = z - 0.12
        nose = [(front, z + 0.62), (front + 0.75, z + 0.45), (front + 0.8, z + 0.3), (front + 0.8, low), (front, low)]
        parts = [
            box((rear - 0.7, -w, low), (front, w, z)),
            box((rear - 0.8, -w, low), (rear - 0.02, w, z + 0.48)),
            hull(np.array([[x, side * (w - 0.05), h] for x, h in nose for side in (-1, 1)])),
            box((rear - 0.05, -w, self.roof), (front - 0.35, w, self.roof + 0.04)),
        ]
        for side in (-1.0, 1.0):
            y = side * (w - 0.03)
            inner, outer = sorted((y, side * w))
            parts += [
                box((rear - 0.8, inner, z), (rear, outer, z + 0.6)),
                box((front, inner, low), (front + 0.25, outer, z + 0.6)),
                bent_bar([(front + 0.12, y, z + 0.6), (front - 0.38, y, self.roof + 0.02)], 0.022),
                bent_bar([(rear - 0.03, y, z + 0.5), (rear - 0.03, y, self.roof + 0.02)], 0.022),
            ]
        return parts

    def _cabin(self) -> list[Mesh]:
        """Return seats with bases and backs, dashboard, steering wheel, pedals."""
        z, front = self.floor, self._rear + self.opening
        top, half = z + self.seat_height, 0.5 * self.seat_depth
        parts = [
            box((front - 0.12, -self.half_width + 0.06, z + 0.42), (front, self.half_width - 0.06, z + 0.68)),
            box((front + 0.02, -self.half_width + 0.06, z), (front + 0.05, self.half_width - 0.06, z + 0.5)),
        ]
        for side in (1.0, -1.0):
            y, w = side * self.seat_y, 0.5 * self.seat_width
            back = [
                (-half - 0.08, top - 0.1),
                (-half + 0.04, top - 0.1),
                (-half - 0.1, top + 0.55),
                (-half - 0.2, top + 0.55),
            ]
            parts += [
                box((-half + 0.04, y - w, top - 0.12), (half, y + w, top)),
                box((-half + 0.06, y - w + 0.06, z), (half - 0.08, y + w - 0.06, top - 0.12)),
                hull(np.array([[x, y + s * (w - 0.02), h] for x, h in back for s in (-1, 1)])),
            ]
        hub = np.array(self._steering)
        axis = np.array([-0.75, 0.0, 0.66])
        axis /= np.linalg.norm(axis)
        up = np.cross(axis, [0.0, 1.0, 0.0])
        parts.append(torus(hub.tolist(), axis.tolist(), 0.165, 0.014, 64, 16))
        column = hub - 0.3 * axis
        parts.append(cylinder(column.tolist(), (hub + 0.01 * axis).tolist(), 0.025, 24))
        for angle in (0.3, np.pi - 0.3, -0.5 * np.pi):
            end = hub + 0.165 * (np.cos(angle) * np.array([0.0, 1.0, 0.0]) - np.sin(angle) * up)
            parts.append(bent_bar([hub.tolist(), end.tolist()], 0.01))
        for y in (self.seat_y - 0.08, self.seat_y + 0.1):
            parts.append(box((front - 0.06, y - 0.04, z + 0.08), (front - 0.04, y + 0.04, z + 0.18)))
        return parts

    def _road_wheels(self) -> list[Mesh]:
        front = self._rear + self.opening + 0.45
        return [
            cylinder((x, side * (self.half_width - 0.18), 0.3), (x, side * (self.half_width + 0.03), 0.3), 0.3)
            for x in (self._rear - 0.42, front)
            for side in (-1.0, 1.0)
        ]


@dataclass(frozen=True)
class FromSeat:
    """Scene from the passenger's seat on the right; the origin is on the ground below it, forward is +x.

    Attributes:
        floor_height: height of the car's floor above the ground, varied by 3 cm [m].
    """

    floor_height: float = 0.4
    opening: float = 0.95
    look_at: tuple[float, float, float] = (0.7, -0.25, 0.6)

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        car = Car((0.0, 0.34), 0.0, self.floor_height + rng.uniform(-0.03, 0.03), opening=self.opening)
        eye = (0.05, 0.0, car.floor + car.seat_height + 0.72)
        parts = [car.build(), floor(9.0), carton(0.5, -2.2, (0.5, 0.4, 0.6), 0.4)]
        return assemble(name, seed, parts, self.look_at, eye)


@dataclass(frozen=True)
class FromOutside:
    """Scene from outside: the robot looks at an opening of the car.

    Attributes:
        yaw_deg: yaw of the car's forward direction, varied by 6 degrees.
        distance: distance of the car's centre, varied by 10 cm [m].
    """

    yaw_deg: float
    distance: float = 1.5

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        yaw = np.radians(self.yaw_deg + rng.uniform(-6.0, 6.0))
        place = (self.distance + rng.uniform(-0.1, 0.1), rng.uniform(-0.15, 0.15))
        car = Car(place, yaw, 0.4 + rng.uniform(-0.05, 0.03))
        parts = [car.build(), floor(9.0), carton(0.6, 2.4, (0.5, 0.4, 0.6), 0.4)]
        return assemble(name, seed, parts, (*place, 0.9))


SCENES: Mapping[str, Recipe] = {
    "car_inside": FromSeat(),
    "car_inside_narrow": FromSeat(0.45, 0.8, (0.4, -0.5, 0.4)),
    "car_outside": FromOutside(90.0),
    "car_outside_left": FromOutside(-90.0, 1.7),
    "car_outside_oblique": FromOutside(55.0, 1.8),
}
