"""A utility vehicle, from its passenger seat and from outside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perception.simulate.objects.car import Car
from perception.simulate.objects.placed import Placed
from perception.simulate.scenes.scene import Recipe, SimulatedScene, assemble, generator
from perception.simulate.scenes.surroundings import carton, floor


@dataclass(frozen=True)
class FromSeat:
    """The origin is on the ground under the passenger's seat, on the right; forward is +x.

    Attributes:
        floor_height: of the car over the ground, within 3 cm [m].
        opening: width of the openings [m].
        look_at: what the robot looks at [m].
    """

    floor_height: float = 0.4
    opening: float = 0.95
    look_at: tuple[float, float, float] = (0.7, -0.25, 0.6)

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        car = Car((0.0, 0.34), 0.0, self.floor_height + rng.uniform(-0.03, 0.03), opening=self.opening)
        eye = (0.05, 0.0, car.floor + car.seat_height + 0.72)
        parts: list[Placed] = [car.build(), floor(9.0), carton(0.5, -2.2, (0.5, 0.4, 0.6), 0.4)]
        return assemble(name, seed, parts, self.look_at, eye)


@dataclass(frozen=True)
class FromOutside:
    """The robot looks at an opening of the car.

    Attributes:
        yaw_deg: of the car's forward direction, within 6 degrees.
        distance: of the car's middle, within 10 cm [m].
    """

    yaw_deg: float
    distance: float = 1.5

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        yaw = np.radians(self.yaw_deg + rng.uniform(-6.0, 6.0))
        place = (self.distance + rng.uniform(-0.1, 0.1), rng.uniform(-0.15, 0.15))
        car = Car(place, yaw, 0.4 + rng.uniform(-0.05, 0.03))
        parts: list[Placed] = [car.build(), floor(9.0), carton(0.6, 2.4, (0.5, 0.4, 0.6), 0.4)]
        return assemble(name, seed, parts, (*place, 0.9))


SCENES: Mapping[str, Recipe] = {
    "car_inside": FromSeat(),
    "car_inside_narrow": FromSeat(0.45, 0.8, (0.4, -0.5, 0.4)),
    "car_outside": FromOutside(90.0),
    "car_outside_left": FromOutside(-90.0, 1.7),
    "car_outside_oblique": FromOutside(55.0, 1.8),
}
