"""Valves as they stand in plants: wheel or lever on a bonnet, on a pipe with flanges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.valve.ring import wheel_basis
from perception.simulate.mesh import Mesh, bent_bar, cylinder, lathe
from perception.simulate.objects.placed import Placed, Truth, frame
from perception.simulate.valve_scene import Valve


@dataclass(frozen=True)
class PipedWheel:
    """A wheel valve whose stem leads into a body on a straight pipe.

    Attributes:
        wheel: rim, spokes, hub and stem.
        pipe_direction: of the pipe; made square to the wheel's axis.
        pipe_radius: outer [m].
        pipe_length: each way from the body [m].
    """

    wheel: Valve
    pipe_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    pipe_radius: float = 0.045
    pipe_length: float = 1.0

    def build(self) -> Placed:
        """Build it; the pipe runs ``stem_length`` behind the wheel."""
        axis = np.array(self.wheel.axis) / np.linalg.norm(self.wheel.axis)
        body = np.array(self.wheel.centre) - self.wheel.stem_length * axis
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = wheel_basis(axis).T, self.wheel.centre
        sizes = {
            "outer_radius": self.wheel.outer_radius,
            "rim_radius": self.wheel.rim_radius,
            "tube_radius": self.wheel.tube_radius,
        }
        fitting = valve_body(body, axis, self.pipe_direction, self.pipe_radius, self.pipe_length)
        bonnet = 0.6 * self.wheel.stem_length
        neck = lathe(
            [(0.0, bonnet), (0.018, bonnet), (0.022, 0.6 * bonnet), (0.7 * self.pipe_radius, 0.0)],
            body.tolist(),
            axis.tolist(),
        )
        return Placed((*self.wheel.meshes(), *fitting, neck), (Truth("valve", pose, sizes),))


@dataclass(frozen=True)
class LeverValve:
    """A ball valve: a lever on a short stem on a pipe.

    Attributes:
        pivot: where the stem's axis meets the lever's middle line [m].
        axis: unit, of the stem, from the pipe to the person who turns it.
        along: where the lever points; made square to the axis.
        length: of the lever, from the pivot [m].
        radius: of the lever [m].
        stem_length: from the pivot to the pipe's middle [m].
        pipe_direction: of the pipe.
        pipe_radius: outer [m].
        pipe_length: each way from the body [m].
    """

    pivot: tuple[float, float, float]
    axis: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    along: tuple[float, float, float] = (0.0, 0.0, 1.0)
    length: float = 0.25
    radius: float = 0.013
    stem_length: float = 0.11
    pipe_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    pipe_radius: float = 0.04
    pipe_length: float = 1.0

    def build(self) -> Placed:
        """Build it; the lever also looks like a lever."""
        pose = frame(self.pivot, self.along, self.axis)
        pivot, axis, along = pose[:3, 3], pose[:3, 2], pose[:3, 0]
        body = pivot - self.stem_length * axis
        end = pivot + (self.length - self.radius) * along
        meshes = (
            bent_bar([pivot.tolist(), end.tolist()], self.radius),
            cylinder((body).tolist(), (pivot + (self.radius + 0.004) * axis).tolist(), 0.014, 24),
            lathe(
                [(0.0, 0.7 * self.stem_length), (0.02, 0.7 * self.stem_length), (0.03, 0.0)],
                body.tolist(),
                axis.tolist(),
            ),
            *valve_body(body, axis, self.pipe_direction, self.pipe_radius, self.pipe_length),
        )
        sizes = {"lever_length": self.length, "lever_radius": self.radius}
        alike = (("lever", pivot), ("lever", 0.5 * (pivot + end)))
        return Placed(meshes, (Truth("valve", pose, sizes),), alike)


def valve_body(
    place: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    direction: tuple[float, float, float],
    radius: float,
    length: float,
) -> tuple[Mesh, ...]:
    """Return a swollen body between two flanges on a pipe whose direction is made square to the stem's axis."""
    along = np.asarray(direction) - (np.asarray(direction) @ axis) * axis
    along /= np.linalg.norm(along)
    half = 1.6 * radius
    profile = [
        (radius, -half),
        (1.25 * radius, -0.6 * half),
        (1.4 * radius, 0.0),
        (1.25 * radius, 0.6 * half),
        (radius, half),
    ]
    meshes = [lathe(profile, place.tolist(), along.tolist())]
    for side in (-1.0, 1.0):
        flange = place + side * half * along
        meshes.append(cylinder(flange.tolist(), (flange + side * 0.03 * along).tolist(), 1.7 * radius))
        meshes.append(cylinder(flange.tolist(), (place + side * length * along).tolist(), radius))
    return tuple(meshes)
