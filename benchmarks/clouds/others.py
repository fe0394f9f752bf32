"""Scenes with objects that the simulator's recipes do not contain, for measuring how detectors generalise.

Wheels of 8 to 40 cm with thin and flat rims at any tilt, doors of other proportions, metric timber, lever valves with
flat levers, knife switches, other drills; steering wheels, fans, tyres and gratings are there to be left alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from benchmarks.clouds.absent import ABSENT, Maker
from benchmarks.clouds.cases import Case
from benchmarks.clouds.decoys import DECOYS
from perception import wheel_basis
from perception.simulate import Caster, join_meshes
from perception.simulate.scenes import SimulatedScene, Truth
from perception.simulate.scenes.debris import heap
from perception.simulate.scenes.doors import Door
from perception.simulate.scenes.fixtures import BoxLever
from perception.simulate.scenes.loose import Beam, Drill, chair, shelf, table, tyre
from perception.simulate.scenes.scene import (
    PlacedObjects,
    assemble,
    cartons,
    floor,
    frame,
    generator,
    make_room,
    pose_of,
    side_walls,
    things,
    upright_pipe,
    wall,
)
from perception.simulate.scenes.valves import PipedWheel, tilt_axis, valve_body
from perception.simulate.valve_scene import Valve
from perception.solids.primitives import Mesh, bent_bar, box, capsule, cylinder, lathe, torus


def wheel(
    outer: float, half_width: float, half_depth: float, n_spokes: int, yaw: float, pitch: float, x: float = 0.8
) -> Maker:
    """Return the maker of a scene with a wheel, its rim's section an ellipse, in a room with pipes and boxes.

    Args:
        outer: outer radius [m].
        half_width, half_depth: of the rim's section along the radius and the axis [m].
        yaw, pitch: sideways and upward angle of its axis [deg].
        x: distance of its centre in front of the robot [m].
    """

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        centre = (x + rng.uniform(-0.05, 0.05), rng.uniform(-0.15, 0.15), rng.uniform(0.9, 1.25))
        axis = np.array(tilt_axis(yaw + rng.uniform(-5.0, 5.0), min(90.0, pitch + rng.uniform(-5.0, 5.0))))
        rim, stem = outer - half_width, max(0.08, 0.8 * outer)
        valve = Valve(
            centre,
            (float(axis[0]), float(axis[1]), float(axis[2])),
            rim,
            0.002,
            n_spokes,
            rng.uniform(0.0, 2.0),
            max(0.35 * half_width, 0.005),
            max(0.18 * outer, 0.018),
            max(0.08 * outer, 0.009),
            stem,
        )
        parts = PipedWheel(valve, (0.0, 0.3, 1.0), 0.25 * outer + 0.01, 1.0).build()
        angle = np.linspace(0.0, 2.0 * np.pi, 17)
        section = [(rim + half_width * np.cos(a), half_depth * np.sin(a)) for a in angle]
        solid = lathe([*section[:-1], section[0]], centre, axis.tolist(), 72)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = wheel_basis(axis).T, centre
        truth = Truth("valve", pose, {"outer_radius": outer, "rim_radius": rim, "tube_radius": half_width})
        face = centre[0] + stem + 0.35 * outer + 0.3
        return [
            PlacedObjects((*parts.meshes, solid), (truth,)),
            make_room(face, -2.0, 1.9),
            upright_pipe(face - 0.1, centre[1] + 0.7, rng.uniform(0.03, 0.07)),
            *cartons(rng, 2, (face - 0.4, -1.1), 0.25),
        ], centre

    return make


def flat_lever(length: float, half_width: float) -> Maker:
    """Return the maker of a ball valve with a lever of sheet metal on a level pipe."""

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        pivot = (0.7 + rng.uniform(-0.05, 0.05), rng.uniform(-0.2, 0.2), rng.uniform(0.9, 1.3))
        axis = tilt_axis(rng.uniform(-15.0, 15.0), rng.uniform(-5.0, 30.0))
        pose = frame(pivot, (0.0, float(rng.choice([-1.0, 1.0])), rng.uniform(-0.6, 0.6)), axis)
        plate = box((-0.02, -half_width, -0.004), (length, half_width, 0.004)).place(pose)
        body = pose[:3, 3] - 0.07 * pose[:3, 2]
        stem = cylinder(body.tolist(), (pose[:3, 3] + 0.006 * pose[:3, 2]).tolist(), 0.012, 24)
        fitting = valve_body(body, pose[:3, 2], (0.0, 1.0, 0.0), 0.03, 0.9)
        truth = Truth("valve", pose, {"lever_length": length, "lever_radius": half_width})
        alike = (("lever", pose[:3, 3]), ("lever", (pose @ [0.5 * length, 0.0, 0.0, 1.0])[:3]))
        valve = PlacedObjects((plate, stem, *fitting), (truth,), alike)
        return [valve, wall(1.1), upright_pipe(1.0, -0.7, 0.05)], pivot

    return make


def knife_switch(length: float) -> Maker:
    """Return the maker of a switch box with a round handle beside or on its front, shorter and longer than usual."""

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        pivot = (0.75 + rng.uniform(-0.05, 0.05), rng.uniform(-0.2, 0.2), rng.uniform(1.0, 1.35))
        normal = tilt_axis(rng.uniform(-20.0, 20.0), 0.0)
        switch = BoxLever(pivot, normal, rng.uniform(-2.2, 2.2), length, 0.009 + 0.03 * length, 0.07, 0.22, 0.5, 0.12)
        return [switch.build(), wall(1.0), upright_pipe(0.95, 0.8, 0.04)], pivot

    return make


def timber(width: float, thickness: float, length: float, n: int) -> Maker:
    """Return the maker of metric timbers lying on the floor and leaning on a wall."""

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        parts = [wall(2.0), *cartons(rng, 1, (1.3, -1.2), 0.2)]
        for k in range(n):
            pose = pose_of(
                (1.0 + 0.3 * k + rng.uniform(-0.05, 0.05), rng.uniform(-0.3, 0.3), 0.5 * thickness),
                yaw=rng.uniform(0.9, 2.2),
            )
            parts.append(Beam(pose, length, width, thickness).build())
        lean = np.radians(rng.uniform(55.0, 70.0))
        foot = 2.0 - length * np.cos(lean) - 0.03
        middle = (foot + 0.5 * length * np.cos(lean), 0.9, 0.5 * length * np.sin(lean) + 0.03)
        parts.append(Beam(pose_of(middle, pitch=-lean), length, width, thickness).build())
        return parts, (1.2, 0.0, 0.2)

    return make


def door(**fields: object) -> Maker:
    """Return the maker of a door with these fields of :class:`Door`."""

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        x = rng.uniform(0.85, 1.1)
        leaf = Door(**{"hinge": (x, 0.45), **fields})  # type: ignore[arg-type]
        return [leaf.build(), side_walls(1.6, 3.0), *cartons(rng, 1, (0.7, 1.1), 0.15)], (x, 0.0, 1.1)

    return make


def drill(grip: float, body: float, yaw: float) -> Maker:
    """Return the maker of a drill of other proportions on a bench, with a bottle and a tin beside it."""

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        foot = (0.8 + rng.uniform(-0.05, 0.05), rng.uniform(-0.15, 0.15), 0.9)
        bottle = lathe([(0.0, 0.0), (0.035, 0.0), (0.035, 0.16), (0.014, 0.2), (0.014, 0.25), (0.0, 0.25)],
                       (0.85, foot[1] + 0.3, 0.9))  # fmt: skip
        tool = Drill(foot, np.radians(yaw) + rng.uniform(-0.2, 0.2), grip, body).build()
        return [tool, things(bottle), table((0.6, -0.7, 0.0), 1.4, 0.6, 0.9), wall(1.6)], foot

    return make


def heap_of(n: int) -> Maker:
    """Return the maker of a heap of beams in a closed room with furniture."""

    def make(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
        room = [make_room(2.6, -2.4, 2.3), shelf((2.0, -1.6, 0.0), 1.2, 0.4, (0.4, 0.9, 1.4), 1.8)]
        return [*room, *heap(rng, n, (1.1, 0.1), 0.35), chair((1.6, 1.5, 0.0), rng.uniform(0.0, 6.0))], (1.1, 0.1, 0.3)

    return make


def _steering(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
    """Return a steering wheel on its column before a dashboard, with a seat behind it."""
    centre = np.array([0.75, rng.uniform(-0.1, 0.1), 0.95])
    axis = np.array([-np.cos(0.45), 0.0, np.sin(0.45)])
    u, v, _ = wheel_basis(axis)
    rim: list[Mesh] = [torus(centre.tolist(), axis.tolist(), 0.185, 0.014)]
    rim += [
        capsule(centre.tolist(), (centre + 0.18 * (np.cos(a) * u + np.sin(a) * v)).tolist(), 0.018)
        for a in (0.1, np.pi - 0.1, -np.pi / 2.0)
    ]
    rim.append(cylinder((centre - 0.03 * axis).tolist(), (centre + 0.01 * axis).tolist(), 0.06))
    rim.append(cylinder((centre - 0.4 * axis).tolist(), centre.tolist(), 0.03))
    dash = box((1.0, -0.8, 0.55), (1.4, 0.8, 1.0))
    seat = [box((-0.25, -0.25, 0.3), (0.25, 0.25, 0.5)), box((-0.35, -0.25, 0.3), (-0.25, 0.25, 1.1))]
    return [things(*rim, dash, *seat), wall(1.8)], (0.8, 0.0, 0.9)


def _fan(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
    """Return a standing fan: a cage of rings and wires about blades."""
    centre = np.array([0.9, rng.uniform(-0.2, 0.2), 1.15])
    axis = np.array([-1.0, 0.0, 0.0])
    u, v, _ = wheel_basis(axis)
    parts: list[Mesh] = [torus(centre.tolist(), axis.tolist(), 0.2, 0.006)]
    parts += [torus((centre + 0.04 * axis).tolist(), axis.tolist(), r, 0.003, 32, 8) for r in (0.05, 0.12, 0.16)]
    for a in np.arange(0.0, 2.0 * np.pi, np.pi / 16.0):
        way = np.cos(a) * u + np.sin(a) * v
        parts.append(bent_bar([(centre + 0.05 * axis).tolist(), (centre + 0.2 * way).tolist()], 0.002))
    for a in (0.3, 2.4, 4.5):
        way, aside = np.cos(a) * u + np.sin(a) * v, -np.sin(a) * u + np.cos(a) * v
        blade = box((0.03, -0.05, -0.006), (0.17, 0.05, 0.006))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.column_stack([way, aside, axis]), centre
        parts.append(blade.place(pose))
    parts.append(cylinder(centre.tolist(), (centre - 0.12 * axis).tolist(), 0.06))
    parts.append(cylinder((1.0, centre[1], 0.0), (1.0, centre[1], 1.15), 0.02))
    return [things(*parts, cylinder((1.0, centre[1], 0.0), (1.0, centre[1], 0.03), 0.2)), wall(1.7)], (0.9, 0.0, 1.1)


def _tyres(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
    """Return tyres on hooks, a bicycle wheel and a car's wheel with its rim."""
    parts = [tyre((0.95, -0.5, 1.2), (1.0, 0.1, 0.0), 0.3, 0.18), tyre((1.0, 0.9, 0.35), (1.0, 0.0, 0.25))]
    bicycle: list[Mesh] = [torus((0.9, 0.25, 1.1), (1.0, 0.2, 0.0), 0.31, 0.018, 64, 12)]
    for a in np.arange(0.0, 2.0 * np.pi, np.pi / 14.0):
        end = (0.9 - 0.06 * np.cos(a), 0.25 + 0.3 * np.cos(a), 1.1 + 0.3 * np.sin(a))
        bicycle.append(capsule((0.9, 0.25, 1.1), end, 0.0015))
    bicycle.append(cylinder((0.86, 0.24, 1.1), (0.94, 0.26, 1.1), 0.02))
    return [*parts, things(*bicycle), wall(1.25)], (0.9, 0.0, 1.0)


def _grating(rng: np.random.Generator) -> tuple[list[PlacedObjects], tuple[float, float, float]]:
    """Return rails, a ladder, a grating and round ducts."""
    bars = [cylinder((0.9, y, 0.2), (0.9, y, 1.8), 0.012, 16) for y in (-0.9, -0.5)]
    bars += [cylinder((0.9, -0.9, z), (0.9, -0.5, z), 0.01, 16) for z in np.arange(0.3, 1.8, 0.28)]
    rail = [bent_bar([(0.7, 0.3, 0.0), (0.7, 0.3, 1.0), (0.7, 1.4, 1.0), (0.7, 1.4, 0.0)], 0.02)]
    rail += [cylinder((0.7, 0.3, 0.5), (0.7, 1.4, 0.5), 0.015)]
    duct = [cylinder((1.2, 0.1, 1.5), (1.2, 1.6, 1.5), 0.15), torus((1.2, 0.1, 1.5), (0.0, 1.0, 0.0), 0.16, 0.012)]
    return [things(*bars, *rail, *duct), wall(1.45), *cartons(rng, 2, (1.1, 0.8), 0.2)], (0.9, 0.0, 1.0)


MAKERS: Mapping[str, Maker] = {
    "wheel_08_thin": wheel(0.08, 0.006, 0.006, 3, 10.0, 0.0, 0.65),
    "wheel_08_wide": wheel(0.08, 0.014, 0.007, 4, -20.0, 15.0, 0.65),
    "wheel_12_tilted": wheel(0.12, 0.009, 0.009, 5, 15.0, 60.0),
    "wheel_20_wide": wheel(0.20, 0.028, 0.009, 5, 0.0, 10.0),
    "wheel_25_wide_tilted": wheel(0.25, 0.035, 0.01, 6, 20.0, 50.0),
    "wheel_30_wide": wheel(0.30, 0.04, 0.012, 6, -15.0, 0.0, 0.9),
    "wheel_30_thin_upright": wheel(0.30, 0.012, 0.012, 4, 0.0, 85.0, 0.9),
    "wheel_40_thin": wheel(0.40, 0.014, 0.014, 5, 10.0, 5.0, 1.0),
    "wheel_40_wide": wheel(0.40, 0.05, 0.012, 6, -10.0, 20.0, 1.1),
    "wheel_40_tilted": wheel(0.40, 0.02, 0.015, 5, 25.0, 45.0, 1.0),
    "ball_valve_short": flat_lever(0.14, 0.011),
    "ball_valve_long": flat_lever(0.24, 0.014),
    "knife_switch_short": knife_switch(0.14),
    "knife_switch_long": knife_switch(0.3),
    "timber_60_40": timber(0.06, 0.04, 1.5, 3),
    "timber_100_100": timber(0.1, 0.1, 1.2, 2),
    "timber_140_22": timber(0.14, 0.022, 1.8, 3),
    "door_narrow": door(width=0.7, height=1.9, handle_z=0.95),
    "door_wide_tall": door(width=1.1, height=2.3, handle_z=1.1, hinge=(1.0, 0.6)),
    "door_wide_push_ajar": door(width=1.0, side="push", ajar=0.3, hinge_on="right", hinge=(1.0, -0.5), along=np.pi / 2),
    "door_low_knob": door(width=0.8, height=1.85, furniture="knob", handle_z=0.85),
    "drill_short": drill(0.1, 0.17, 100.0),
    "drill_long": drill(0.15, 0.24, -60.0),
    "drill_away": drill(0.12, 0.2, 20.0),
    "heap_in_room": heap_of(8),
    "none_steering": _steering,
    "none_fan": _fan,
    "none_tyres": _tyres,
    "none_grating": _grating,
    **ABSENT,
    **DECOYS,
}


def make_other(name: str, seed: int = 0) -> SimulatedScene:
    """Return a scene of :data:`MAKERS`."""
    parts, look_at = MAKERS[name](generator(name, seed))
    return assemble(name, seed, [floor(), *parts], look_at)


def other_cases(variants: Sequence[str], seed: int = 0) -> Iterator[Case]:
    """Yield scans of these scenes by each of the sensors; those joined by a slash take turns."""
    for i, name in enumerate(MAKERS):
        for turns in variants:
            variant = turns.split("/")[i % len(turns.split("/"))]
            scene = make_other(name, seed)
            yield Case(
                f"{name}:{variant}",
                "sparse" if "sparse" in variant else "dense",
                partial(scene.scan, variant),
                scene.truth,
                tuple((kind, place[None, :]) for kind, place in scene.lookalikes),
                surface=partial(_caster, scene),
                judge=partial(scene.scan, variant, 1),
                is_heap=name.startswith("heap"),
            )


def _caster(scene: SimulatedScene) -> Caster:
    return Caster(join_meshes(scene.meshes))
