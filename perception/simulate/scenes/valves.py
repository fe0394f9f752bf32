"""Scenes with wheel and lever valves on pipes: several sizes and tilts, partly hidden, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.valve.ring import wheel_basis
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
    upright_pipe,
    wall,
)
from perception.simulate.valve_scene import Valve
from perception.solids.primitives import Mesh, bent_bar, cylinder, lathe

Vector = tuple[float, float, float]
# y, z, outer radius [m] and number of spokes of each wheel of a manifold.
_MANIFOLD = ((0.28, 1.05, 0.15, 5), (-0.2, 1.1, 0.09, 3), (0.05, 1.5, 0.11, 4))
_STEM, _LEVER_PIPE_RADIUS, _PIPE_LENGTH = 0.11, 0.04, 1.0  # of lever valves [m]
_GRIP_RADIUS = 0.014  # of a crank [m]
_UP, _ACROSS = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class PipedWheel:
    """A wheel valve whose stem leads into a body on a straight pipe.

    Attributes:
        pipe_direction: direction of the pipe; made perpendicular to the wheel's axis.
        pipe_radius: outer radius [m].
        pipe_length: length to each side of the body [m].
    """

    wheel: Valve
    pipe_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    pipe_radius: float = 0.045
    pipe_length: float = 1.0

    def build(self) -> PlacedObjects:
        """Build the valve; the pipe is ``stem_length`` behind the wheel."""
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
        return PlacedObjects((*self.wheel.meshes(), *fitting, neck), (Truth("valve", pose, sizes),))


@dataclass(frozen=True)
class LeverValve:
    """A ball valve: a lever on a short stem on a pipe; with a grip at its end, a crank.

    Attributes:
        pivot: intersection of the stem's axis with the lever's centre line [m].
        axis: unit vector along the stem, from the pipe towards the operator.
        along: direction of the lever; made perpendicular to the axis.
        length: length of the lever from the pivot, of a crank to the axis of its grip [m].
        grip: length of a crank's grip along the axis, from the lever's centre line; 0 for a lever [m].
    """

    pivot: tuple[float, float, float]
    axis: tuple[float, float, float] = (-1.0, 0.0, 0.0)
    along: tuple[float, float, float] = (0.0, 0.0, 1.0)
    length: float = 0.25
    radius: float = 0.013
    pipe_direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    grip: float = 0.0

    def build(self) -> PlacedObjects:
        """Build the valve; its lever is also a lookalike of kind ``lever``."""
        pose = frame(self.pivot, self.along, self.axis)
        pivot, axis, along = pose[:3, 3], pose[:3, 2], pose[:3, 0]
        body = pivot - _STEM * axis
        end = pivot + (self.length - (0.0 if self.grip > 0.0 else self.radius)) * along
        grip = [cylinder(end.tolist(), (end + self.grip * axis).tolist(), _GRIP_RADIUS, 24)] if self.grip > 0.0 else []
        meshes = (
            bent_bar([pivot.tolist(), end.tolist()], self.radius),
            cylinder((body).tolist(), (pivot + (self.radius + 0.004) * axis).tolist(), 0.014, 24),
            lathe(
                [(0.0, 0.7 * _STEM), (0.02, 0.7 * _STEM), (0.03, 0.0)],
                body.tolist(),
                axis.tolist(),
            ),
            *valve_body(body, axis, self.pipe_direction, _LEVER_PIPE_RADIUS, _PIPE_LENGTH),
            *grip,
        )
        sizes = {"lever_length": self.length, "lever_radius": self.radius}
        sizes |= {"grip_length": self.grip} if self.grip > 0.0 else {}
        alike = (("lever", pivot), ("lever", 0.5 * (pivot + end)))
        return PlacedObjects(meshes, (Truth("valve", pose, sizes),), alike)


def valve_body(
    place: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    direction: tuple[float, float, float],
    radius: float,
    length: float,
) -> tuple[Mesh, ...]:
    """Return a bulging body between two flanges on a pipe, whose direction is made perpendicular to the stem's axis."""
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


def tilt_axis(yaw_deg: float, pitch_deg: float) -> Vector:
    """Return a unit axis towards the robot, rotated sideways and up."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    return float(-np.cos(yaw) * np.cos(pitch)), float(-np.sin(yaw) * np.cos(pitch)), float(np.sin(pitch))


@dataclass(frozen=True)
class PipeWheel:
    """Scene with one wheel valve on a pipe in front of a wall, with pipes and boxes beside it.

    Attributes:
        centre: centre of the rim, varied by 5 cm [m].
        angles: sideways and upward angle of its axis, varied by 4 degrees.
        outer: outer radius [m].
        tube: radius of the rim's section [m].
        stem: distance from the rim's plane to the pipe's axis [m].
        wall_x: x of the wall; None: 20 cm behind the pipe [m].
        is_crossed: whether a thin pipe stands in front of the wheel.
    """

    centre: Vector
    angles: tuple[float, float] = (0.0, 0.0)
    outer: float = 0.13
    tube: float = 0.013
    n_spokes: int = 4
    stem: float = 0.16
    pipe: Vector = _UP
    pipe_radius: float = 0.045
    wall_x: float | None = None
    is_crossed: bool = False

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        x, y, z = np.array(self.centre) + rng.uniform(-0.05, 0.05, 3)
        yaw, pitch = np.array(self.angles) + rng.uniform(-4.0, 4.0, 2)
        axis = tilt_axis(yaw, min(pitch, 90.0))
        spoke, hub, stem = 0.55 * self.tube + 0.001, max(0.2 * self.outer, 0.02), max(0.1 * self.outer, 0.01)
        ring = (self.outer - self.tube, self.tube, self.n_spokes, rng.uniform(0.0, 2.0))
        wheel = Valve((x, y, z), axis, *ring, spoke, hub, stem, self.stem)
        face = self.wall_x if self.wall_x is not None else max(x - self.stem * axis[0], x) + 0.2
        parts = [PipedWheel(wheel, self.pipe, self.pipe_radius).build(), floor(), wall(face)]
        for side in (-1.0, 1.0):
            parts.append(upright_pipe(face - 0.1, y + side * rng.uniform(0.5, 0.8), rng.uniform(0.03, 0.07)))
        if self.is_crossed:
            parts.append(upright_pipe(x - 0.12, y + 0.45 * self.outer, 0.016))
        parts += cartons(rng, 2, (face - 0.4, y - 1.2), 0.25)
        return assemble(name, seed, parts, (x, y, z))


@dataclass(frozen=True)
class Manifold:
    """Scene with three wheels of different sizes on pipes side by side."""

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        parts = [floor(), wall(1.15)]
        for y, z, outer, n_spokes in _MANIFOLD:
            centre = (0.8 + rng.uniform(-0.03, 0.03), y, z)
            axis = tilt_axis(rng.uniform(-8.0, 8.0), rng.uniform(-5.0, 10.0))
            wheel = Valve(centre, axis, outer - 0.012, 0.012, n_spokes, rng.uniform(0.0, 2.0), stem_length=0.17)
            parts.append(PipedWheel(wheel, _UP if z < 1.4 else _ACROSS, 0.04, 1.3).build())
        return assemble(name, seed, parts, (0.8, 0.03, 1.1))


@dataclass(frozen=True)
class BallValves:
    """Scene with lever valves on pipes in front of a wall.

    Attributes:
        levers: (pivot, lever direction, lever length, pipe direction) of each [m].
    """

    levers: tuple[tuple[Vector, Vector, float, Vector], ...]

    def make(self, name: str, seed: int) -> SimulatedScene:
        """See :class:`Recipe`."""
        rng = generator(name, seed)
        parts = [floor(), wall(1.05), upright_pipe(0.98, -0.75, 0.05)]
        for pivot, along, length, direction in self.levers:
            x, y, z = np.array(pivot) + rng.uniform(-0.03, 0.03, 3)
            a, b, c = np.array(along) + rng.normal(0.0, 0.08, 3)
            axis = tilt_axis(rng.uniform(-12.0, 12.0), rng.uniform(-6.0, 12.0))
            parts.append(LeverValve((x, y, z), axis, (a, b, c), length, pipe_direction=direction).build())
        return assemble(name, seed, parts, self.levers[0][0])


SCENES: Mapping[str, Recipe] = {
    "valve_tiny": PipeWheel((0.6, 0.05, 1.2), outer=0.055, tube=0.007, n_spokes=3, stem=0.08, pipe_radius=0.025),
    "valve_small": PipeWheel((0.65, 0.1, 1.15), outer=0.075, tube=0.009, n_spokes=3, stem=0.1, pipe_radius=0.03),
    "valve_plain": PipeWheel((0.65, -0.05, 1.1)),
    "valve_large": PipeWheel((0.75, 0.0, 1.1), (5.0, 5.0), 0.28, 0.016, 6, 0.25, _ACROSS, 0.08),
    "valve_huge": PipeWheel((0.85, 0.05, 1.1), (-8.0, 0.0), 0.38, 0.019, 5, 0.3, _UP, 0.1),
    "valve_tilted": PipeWheel((0.65, 0.0, 1.0), (0.0, 45.0), 0.16, 0.013, 5, 0.2, _ACROSS),
    "valve_aside": PipeWheel((0.7, 0.25, 1.1), (40.0, 0.0), 0.15),
    "valve_overhead": PipeWheel((0.7, -0.2, 1.75), (-30.0, -15.0), 0.14, 0.012, 4, 0.15, _ACROSS),
    "valve_upright": PipeWheel((0.7, 0.05, 0.85), (0.0, 88.0), 0.16, 0.014, 5, 0.22, _ACROSS, wall_x=1.1),
    "valve_low": PipeWheel((0.75, -0.1, 0.45), (10.0, 75.0), 0.2, 0.015, 4, 0.2, _ACROSS, wall_x=1.2),
    "valve_near_wall": PipeWheel((0.7, 0.1, 1.15), (0.0, 0.0), 0.12, 0.012, 5, 0.09, _ACROSS, 0.03, wall_x=0.84),
    "valve_far": PipeWheel((1.5, 0.2, 1.2), (10.0, 0.0), 0.17, 0.014),
    "valve_crossed": PipeWheel((0.7, 0.0, 1.1), (0.0, 10.0), 0.15, n_spokes=5, is_crossed=True),
    "valve_manifold": Manifold(),
    "valve_lever": BallValves((((0.75, 0.05, 1.1), _UP, 0.24, _ACROSS),)),
    "valve_lever_along": BallValves((((0.7, -0.1, 1.0), _ACROSS, 0.2, _ACROSS),)),
    "valve_levers": BallValves(
        (((0.75, 0.3, 1.1), _UP, 0.2, _UP), ((0.75, -0.15, 1.1), (0.0, -1.0, 0.0), 0.26, _UP)),
    ),
}
