"""Scene parts for the simulator: a wheel valve with its ground truth, and a wall, pipes and boxes around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.valve.ring import wheel_basis
from perception.solids.primitives import Mesh, box, cylinder, hull, torus


@dataclass(frozen=True)
class Valve:
    """A wheel valve on a stem.

    Attributes:
        centre: centre of the rim [m].
        axis: unit vector from the wall towards the operator.
        rim_radius: radius of the rim's centre line [m].
        spin: angle of the first spoke about the axis, from ``wheel_basis(axis)[0]`` [rad].
        stem_length: distance from the rim's plane to the wall [m].
    """

    centre: tuple[float, float, float]
    axis: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    rim_radius: float = 0.12
    tube_radius: float = 0.015
    n_spokes: int = 4
    spin: float = 0.0
    spoke_radius: float = 0.008
    hub_radius: float = 0.03
    stem_radius: float = 0.015
    stem_length: float = 0.2

    @property
    def outer_radius(self) -> float:
        """Outer radius of the rim [m]."""
        return self.rim_radius + self.tube_radius

    @property
    def spoke_angles(self) -> tuple[float, ...]:
        """Angles of the spokes about the axis [rad]."""
        return tuple(self.spin + 2.0 * np.pi * k / self.n_spokes for k in range(self.n_spokes))

    def meshes(self) -> list[Mesh]:
        """Make rim, hub, stem and spokes."""
        centre = np.array(self.centre)
        basis = wheel_basis(np.array(self.axis) / np.linalg.norm(self.axis))
        axis = basis[2]
        parts = [
            torus(centre.tolist(), axis.tolist(), self.rim_radius, self.tube_radius),
            cylinder((centre - 0.015 * axis).tolist(), (centre + 0.015 * axis).tolist(), self.hub_radius),
            cylinder((centre - self.stem_length * axis).tolist(), centre.tolist(), self.stem_radius),
        ]
        for angle in self.spoke_angles:
            end = centre + self.rim_radius * (np.cos(angle) * basis[0] + np.sin(angle) * basis[1])
            parts.append(cylinder(centre.tolist(), end.tolist(), self.spoke_radius, 16))
        return parts

    def truth(self) -> dict[str, object]:
        """Return pose and dimensions, JSON-ready."""
        return asdict(self) | {"outer_radius": self.outer_radius, "spoke_angles": list(self.spoke_angles)}


@dataclass(frozen=True)
class Room:
    """Surroundings of a valve: a wall normal to x, a floor at z = 0, upright pipes, boxes, hulls (a robot's links)."""

    wall_x: float | None = 0.9
    floor: bool = True
    pipes: tuple[tuple[float, float, float], ...] = ()
    boxes: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = ()

    def meshes(self, hulls: Sequence[Float[np.ndarray, "V 3"]] = ()) -> list[Mesh]:
        """Make all meshes; pipes are (x, y, radius) from floor to 2.4 m; boxes are (lower, upper) corners."""
        parts = [hull(vertices) for vertices in hulls]
        if self.wall_x is not None:
            parts.append(box((self.wall_x, -3.0, 0.0), (self.wall_x + 0.1, 3.0, 2.5)))
        if self.floor:
            parts.append(box((-6.0, -6.0, -0.1), (6.0, 6.0, 0.0)))
        parts += [cylinder((x, y, 0.0), (x, y, 2.4), radius) for x, y, radius in self.pipes]
        return parts + [box(lower, upper) for lower, upper in self.boxes]
