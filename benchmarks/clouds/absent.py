"""Scenes of objects that belong to none of the detected kinds, or only resemble one: nothing confident is due in them.

Handles on narrow and wide switch boxes are levers, not valves; a nozzle may be reported as a hose end, and a ladder's
stile or a plank of a step as a beam, which it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from perception.simulate.scenes.fixtures import BoxLever
from perception.simulate.scenes.loose import chair, table
from perception.simulate.scenes.scene import PlacedObjects, cartons, make_room, pose_of, things, upright_pipe, wall
from perception.simulate.scenes.valves import tilt_axis
from perception.solids.primitives import Mesh, bent_bar, box, capsule, cylinder, lathe, pipe, torus

Place = tuple[float, float, float]
Maker = Callable[[np.random.Generator], tuple[list[PlacedObjects], Place]]


def make_ladders(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a leaning ladder, a stepladder and a ladder fixed to the wall."""
    lean = pose_of((0.75, -0.6, 0.0), pitch=rng.uniform(0.15, 0.3))
    rungs: list[Mesh] = [box((-0.03, y, 0.0), (0.03, y + 0.025, 2.2)) for y in (0.0, 0.42)]
    rungs += [cylinder((0.0, 0.0, z), (0.0, 0.42, z), 0.015, 16) for z in np.arange(0.25, 2.2, 0.28)]
    steps: list[Mesh] = []
    beams = [lean @ [0.0, y, z, 1.0] for y in (0.0125, 0.4325) for z in np.arange(0.2, 2.2, 0.2)]
    for pitch, x in ((0.22, 0.0), (-0.22, 0.75)):
        side = [box((0.0, y, 0.0), (0.02, y + 0.05, 1.6)) for y in (0.0, 0.45)]
        treads = [box((-0.06, 0.0, z), (0.06, 0.5, z + 0.03)) for z in np.arange(0.25, 1.5, 0.25)]
        pose = pose_of((0.8 + x, 0.35, 0.0), pitch=pitch)
        steps += [mesh.place(pose) for mesh in (*side, *treads)]
        beams += [pose @ [0.01, y, z, 1.0] for y in (0.025, 0.475) for z in np.arange(0.2, 1.6, 0.2)]
        beams += [pose @ [0.0, 0.25, z + 0.015, 1.0] for z in np.arange(0.25, 1.5, 0.25)]
    fixed: list[Mesh] = [cylinder((1.5, y, 0.0), (1.5, y, 2.5), 0.02, 16) for y in (-1.7, -1.3)]
    fixed += [cylinder((1.5, -1.7, z), (1.5, -1.3, z), 0.012, 16) for z in np.arange(0.3, 2.5, 0.3)]
    ladders = (*(mesh.place(lean) for mesh in rungs), *steps, *fixed)
    alike = tuple(("beam", place[:3]) for place in beams)
    return [PlacedObjects(ladders, (), alike), wall(1.65)], (0.9, 0.0, 1.0)


def make_rails(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a handrail on brackets, a guard rail with posts, a stair and a grab bar."""
    wall_rail: list[Mesh] = [cylinder((1.12, -1.6, 0.95), (1.12, -0.2, 0.95), 0.021)]
    wall_rail += [bent_bar([(1.12, y, 0.93), (1.12, y, 0.88), (1.2, y, 0.88)], 0.008) for y in (-1.4, -0.9, -0.4)]
    guard = [cylinder((0.8, y, 0.0), (0.8, y, 1.05), 0.02) for y in (0.3, 0.9, 1.5)]
    guard += [cylinder((0.8, 0.3, z), (0.8, 1.5, z), 0.02) for z in (0.5, 1.05)]
    grab = bent_bar([(1.2, -0.05, 1.2), (1.13, -0.05, 1.2), (1.13, 0.25, 1.2), (1.2, 0.25, 1.2)], 0.016)
    stair = [box((0.6 + 0.25 * k, -1.6, 0.0), (0.85 + 0.25 * k, -0.7, 0.17 * (k + 1))) for k in range(2)]
    return [things(*wall_rail, *guard, grab, *stair), wall(1.2)], (0.9, 0.1, 1.0)


def make_extinguishers(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make fire extinguishers on the wall and on the floor, with heads, handles and hoses, and a sand bucket."""
    parts: list[Mesh] = []
    nozzles = []
    for x, y, z, size in ((0.95, -0.35, 0.6, 1.0), (0.7, 0.5, 0.0, 1.2), (0.9, 0.15, 0.9, 0.8)):
        r, h = 0.08 * size, 0.45 * size
        bottle = [(0.0, 0.0), (r, 0.0), (r, h), (0.4 * r, 1.15 * h), (0.3 * r, 1.25 * h), (0.0, 1.25 * h)]
        parts.append(lathe(bottle, (x, y, z)))
        top = z + 1.25 * h
        parts += [
            box((x - 0.02, y - 0.02, top - 0.01), (x + 0.02, y + 0.02, top + 0.03)),
            capsule((x, y, top + 0.02), (x - 0.12, y, top + 0.05), 0.008),
            capsule((x, y, top), (x - 0.11, y, top - 0.01), 0.008),
            torus((x - 0.02, y + 0.03, top), (0.0, 1.0, 0.0), 0.02, 0.006, 32, 8),
        ]
        hose = [(x, y - 0.02, top), (x, y - 1.5 * r, top - 0.02), (x, y - 1.3 * r, z + 0.4 * h)]
        parts.append(bent_bar(hose, 0.011))
        nozzles.append(("hose", np.array(hose[-1])))
    sign = box((1.08, -0.5, 1.5), (1.1, -0.25, 1.8))
    return [PlacedObjects((*parts, sign), (), tuple(nozzles)), wall(1.1)], (0.9, 0.0, 0.8)


def make_reels(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a fire hose reel on a wall, a cable drum on the floor and a coil of cable on a hook."""
    centre = np.array([0.9, rng.uniform(-0.1, 0.1), 1.1])
    side = [(0.05, 0.0), (0.27, 0.0), (0.27, 0.012), (0.05, 0.012), (0.05, 0.0)]
    reel: list[Mesh] = [lathe(side, _beside(centre, x), (1.0, 0.0, 0.0), 64) for x in (-0.08, 0.08)]
    reel += [
        torus(_beside(centre, x), (1.0, 0.0, 0.0), r, 0.014, 64, 12)
        for r in (0.14, 0.17, 0.2)
        for x in (-0.05, -0.02, 0.01, 0.04)
    ]
    reel.append(cylinder(_beside(centre, -0.1), _beside(centre, 0.3), 0.045))
    tail = [_beside(centre, -0.02, -0.2), _beside(centre, -0.03, -0.2, -0.5)]
    reel.append(bent_bar(tail, 0.014))
    drum = [(0.04, 0.0), (0.35, 0.0), (0.35, 0.03), (0.15, 0.03), (0.15, 0.37), (0.35, 0.37), (0.35, 0.4), (0.04, 0.4)]
    parts = [lathe(drum, (0.75, 1.0, 0.36), (0.5, 0.87, 0.0))]
    coil = [torus((1.12 - 0.02 * k, -0.8, 1.2), (1.0, 0.0, 0.1), 0.15, 0.01) for k in range(3)]
    nozzle = ("hose", np.array(tail[-1]))
    return [PlacedObjects((*reel, *parts, *coil), (), (nozzle,)), wall(1.2)], (0.9, 0.0, 1.0)


def _beside(place: np.ndarray, x: float, y: float = 0.0, z: float = 0.0) -> list[float]:
    return [float(place[0]) + x, float(place[1]) + y, float(place[2]) + z]


def make_switches(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a narrow and a wide switch box with handles, a cabinet with a rotary switch, conduits and a socket."""
    narrow = BoxLever((0.72, -0.45, 1.2), tilt_axis(0.0, 0.0), rng.uniform(-1.8, 1.8), 0.16, 0.011, 0.06, 0.1, 0.3, 0.1)
    wide = BoxLever((0.75, 0.1, 1.15), tilt_axis(8.0, 0.0), rng.uniform(1.0, 2.2), 0.22, 0.013, 0.07, 0.35, 0.5, 0.15)
    upper = BoxLever((0.8, 0.75, 1.4), tilt_axis(-10.0, 0.0), rng.uniform(-0.5, 0.5), 0.18, 0.01, 0.06, 0.16, 0.2, 0.12)
    cabinet = [box((0.8, -1.5, 0.3), (1.1, -0.85, 1.9)), cylinder((0.8, -1.15, 1.3), (0.77, -1.15, 1.3), 0.05)]
    cabinet.append(box((0.74, -1.16, 1.26), (0.77, -1.14, 1.34)))
    conduits = [cylinder((1.08, y, 1.5), (1.08, y, 2.6), 0.012, 16) for y in (-0.45, 0.05, 0.15)]
    conduits.append(box((1.04, -0.3, 0.0), (1.1, -0.22, 2.6)))
    return [narrow.build(), wide.build(), upper.build(), things(*cabinet, *conduits), wall(1.1)], (0.8, 0.0, 1.2)


def make_fans(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a square exhaust fan, a desk fan tilted up, an industrial drum fan and a round duct grille."""
    parts: list[Mesh] = []
    for centre, axis, r in (((0.9, 0.3, 1.3), (-1.0, 0.0, 0.4), 0.15), ((0.85, -0.7, 0.5), (-1.0, 0.3, 0.2), 0.3)):
        way = np.array(axis) / np.linalg.norm(axis)
        for k in (-1.0, 1.0):
            rings = (0.4 * r, 0.7 * r, r)
            parts += [torus((np.array(centre) + 0.3 * k * r * way).tolist(), axis, q, 0.004, 48, 8) for q in rings]
        parts.append(
            pipe((np.array(centre) - 0.3 * r * way).tolist(), (np.array(centre) + 0.3 * r * way).tolist(), r, 0.006)
        )
        side = np.cross(way, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        up = np.cross(side, way)
        for a in np.arange(0.0, 2.0 * np.pi, np.pi / 2.0):
            out = np.cos(a) * side + np.sin(a) * up
            parts.append(capsule(centre, (np.array(centre) + 0.9 * r * out).tolist(), 0.02))
        parts.append(cylinder(centre, (np.array(centre) - 0.5 * r * way).tolist(), 0.3 * r))
        parts.append(cylinder((centre[0], centre[1], 0.0), (centre[0], centre[1], centre[2] - r), 0.02))
    square = [box((1.1, -0.25, 1.5), (1.14, -0.2, 2.0)), box((1.1, 0.2, 1.5), (1.14, 0.25, 2.0))]
    square += [box((1.1, -0.25, z), (1.14, 0.25, z + 0.05)) for z in (1.5, 1.95)]
    square.append(torus((1.1, 0.0, 1.75), (1.0, 0.0, 0.0), 0.2, 0.008))
    square += [
        capsule((1.12, 0.0, 1.75), (1.12, 0.18 * np.cos(a), 1.75 + 0.18 * np.sin(a)), 0.025)
        for a in (0.4, 1.97, 3.5, 5.1)
    ]
    return [things(*parts, *square), wall(1.25)], (0.9, 0.0, 1.0)


def make_chairs(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make an office chair on five arms, a bar stool with a foot ring, a wheelchair and a plain chair."""
    x, y = 0.8, -0.5
    office: list[Mesh] = [
        cylinder((x, y, 0.1), (x, y, 0.45), 0.03),
        box((x - 0.22, y - 0.23, 0.45), (x + 0.22, y + 0.23, 0.53)),
    ]
    office += [
        capsule((x, y, 0.1), (x + 0.3 * np.cos(a), y + 0.3 * np.sin(a), 0.06), 0.02)
        for a in np.arange(0.2, 6.2, 2.0 * np.pi / 5.0)
    ]
    office.append(box((x + 0.2, y - 0.2, 0.65), (x + 0.25, y + 0.2, 1.1)))
    stool: list[Mesh] = [
        cylinder((0.75, 0.35, 0.7), (0.75, 0.35, 0.75), 0.17),
        torus((0.75, 0.35, 0.3), (0, 0, 1), 0.18, 0.011),
    ]
    stool += [
        capsule((0.75, 0.35, 0.7), (0.75 + 0.22 * np.cos(a), 0.35 + 0.22 * np.sin(a), 0.0), 0.012)
        for a in (0.5, 2.1, 3.6, 5.2)
    ]
    return [
        things(*office, *stool),
        _wheelchair(pose_of((1.3, 1.1, 0.0), yaw=rng.uniform(2.0, 4.0))),
        chair((1.4, 0.1, 0.0), rng.uniform(0.0, 6.0)),
        make_room(2.2, -2.0, 1.9),
    ], (0.9, 0.1, 0.7)


def _wheelchair(pose: np.ndarray) -> PlacedObjects:
    """Return a wheelchair: two spoked wheels with hand rings, a seat, a back."""
    parts: list[Mesh] = [box((-0.2, -0.22, 0.48), (0.2, 0.22, 0.51)), box((-0.22, -0.22, 0.5), (-0.2, 0.22, 0.95))]
    for y, out in ((-0.28, -1.0), (0.28, 1.0)):
        parts += [
            torus((-0.1, y, 0.3), (0, 1, 0), 0.28, 0.016, 64, 12),
            torus((-0.1, y + 0.05 * out, 0.3), (0, 1, 0), 0.24, 0.009, 64, 8),
        ]
        parts += [
            capsule((-0.1, y, 0.3), (-0.1 + 0.27 * np.cos(a), y, 0.3 + 0.27 * np.sin(a)), 0.002)
            for a in np.arange(0.0, 6.2, np.pi / 8.0)
        ]
        parts += [
            cylinder((-0.1, y - 0.03, 0.3), (-0.1, y + 0.03, 0.3), 0.03),
            bent_bar([(-0.2, y * 0.8, 0.95), (-0.32, y * 0.8, 0.95)], 0.014),
        ]
    return PlacedObjects(tuple(mesh.place(pose) for mesh in parts))


def make_drawers(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a cupboard with bar handles, knobs and drawers, a worktop with a tap, and hooks on the wall."""
    front: list[Mesh] = [box((0.9, -1.2, 0.0), (1.4, 0.6, 0.88))]
    for y in (-0.9, -0.3, 0.3):
        front.append(
            bent_bar(
                [(0.9, y - 0.07, 0.75), (0.86, y - 0.07, 0.75), (0.86, y + 0.07, 0.75), (0.9, y + 0.07, 0.75)], 0.006
            )
        )
        front.append(
            bent_bar([(0.9, y + 0.2, 0.3), (0.865, y + 0.2, 0.3), (0.865, y + 0.2, 0.5), (0.9, y + 0.2, 0.5)], 0.006)
        )
        front.append(
            lathe(
                [(0.0, 0.03), (0.016, 0.03), (0.016, 0.012), (0.008, 0.01), (0.008, 0.0)],
                (0.9, y, 0.6),
                (-1.0, 0.0, 0.0),
            )
        )
    tap = bent_bar([(1.3, -0.2, 0.88), (1.3, -0.2, 1.15), (1.15, -0.2, 1.18), (1.12, -0.2, 1.12)], 0.013)
    hooks = [bent_bar([(1.4, y, 1.5), (1.34, y, 1.5), (1.33, y, 1.54)], 0.006) for y in np.arange(-1.0, 0.6, 0.2)]
    upper = box((1.1, 0.7, 1.3), (1.4, 1.6, 2.0))
    spout = ("hose", np.array([1.12, -0.2, 1.12]))
    return [PlacedObjects((*front, tap, *hooks, upper), (), (spout,)), wall(1.4)], (0.9, -0.2, 0.8)


def make_machines(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a motor with a belt guard, pulleys, a gas bottle, a flanged pipe with a blind end and gauges."""
    pulley = [
        (0.02, 0.0),
        (0.18, 0.0),
        (0.18, 0.05),
        (0.15, 0.05),
        (0.15, 0.03),
        (0.04, 0.03),
        (0.04, 0.05),
        (0.02, 0.05),
    ]
    parts: list[Mesh] = [
        lathe(pulley, (0.75, -0.5, 0.6), (-0.9, 0.3, 0.0)),
        cylinder((0.75, -0.5, 0.6), (1.2, -0.65, 0.6), 0.02),
    ]
    parts += [cylinder((0.85, -0.9, 0.3), (0.85, -0.3, 0.3), 0.12), box((0.7, -0.9, 0.0), (1.0, -0.3, 0.18))]
    bottle = [(0.0, 0.0), (0.115, 0.0), (0.115, 1.25), (0.04, 1.45), (0.035, 1.55), (0.0, 1.55)]
    parts += [lathe(bottle, (0.9, 0.8, 0.0)), lathe(bottle, (0.95, 1.08, 0.0))]
    parts += [cylinder((0.8, -0.1, 1.1), (1.3, -0.1, 1.1), 0.06), cylinder((0.78, -0.1, 1.1), (0.8, -0.1, 1.1), 0.11)]
    parts += [
        capsule(
            (0.765, -0.1 + 0.09 * np.cos(a), 1.1 + 0.09 * np.sin(a)),
            (0.79, -0.1 + 0.09 * np.cos(a), 1.1 + 0.09 * np.sin(a)),
            0.01,
        )
        for a in np.arange(0.0, 6.2, np.pi / 4.0)
    ]
    for y in (0.25, 0.42):
        parts += [
            cylinder((0.95, y, 1.4), (0.99, y, 1.4), 0.05),
            torus((0.95, y, 1.4), (1, 0, 0), 0.05, 0.006, 48, 8),
            cylinder((0.99, y, 1.4), (1.3, y, 1.4), 0.012),
        ]
    return [things(*parts), wall(1.3), upright_pipe(1.2, -1.2, 0.06)], (0.9, 0.0, 0.9)


def make_carts(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a wheelbarrow, a hand truck and a bicycle, all with wheels and bars with a free end."""
    barrow: list[Mesh] = [
        torus((0.55, 0.0, 0.18), (0, 1, 0), 0.15, 0.03, 48, 12),
        cylinder((0.55, -0.03, 0.18), (0.55, 0.03, 0.18), 0.08),
    ]
    barrow += [
        bent_bar([(0.55, 0.12 * s, 0.18), (-0.1, 0.25 * s, 0.4), (-0.75, 0.3 * s, 0.6)], 0.017) for s in (-1.0, 1.0)
    ]
    barrow += [
        box((-0.3, -0.3, 0.42), (0.4, 0.3, 0.6)),
        *(capsule((-0.2, 0.25 * s, 0.4), (-0.2, 0.25 * s, 0.0), 0.017) for s in (-1.0, 1.0)),
    ]
    truck: list[Mesh] = [cylinder((0.0, y, 0.1), (-0.15, y, 1.25), 0.016) for y in (-0.2, 0.2)]
    truck += [cylinder((-0.05 - 0.1 * z, -0.2, z), (-0.05 - 0.1 * z, 0.2, z), 0.014) for z in (0.4, 0.8, 1.25)]
    truck += [cylinder((0.0, y, 0.12), (0.0, y + 0.05, 0.12), 0.12) for y in (-0.28, 0.23)]
    bicycle: list[Mesh] = []
    for x in (-0.52, 0.52):
        bicycle += [
            torus((x, 0.0, 0.33), (0, 1, 0), 0.32, 0.018, 64, 10),
            cylinder((x, -0.05, 0.33), (x, 0.05, 0.33), 0.025),
        ]
        bicycle += [
            capsule((x, 0.0, 0.33), (x + 0.31 * np.cos(a), 0.0, 0.33 + 0.31 * np.sin(a)), 0.0015)
            for a in np.arange(0.0, 6.2, np.pi / 9.0)
        ]
    bicycle += [
        bent_bar([(-0.52, 0.0, 0.33), (-0.15, 0.0, 0.85), (0.4, 0.0, 0.9), (0.52, 0.0, 0.33)], 0.016),
        bent_bar([(0.35, -0.3, 1.0), (0.4, 0.0, 1.05), (0.35, 0.3, 1.0)], 0.012),
    ]
    groups = (
        (barrow, pose_of((1.0, -0.9, 0.0), yaw=2.6)),
        (truck, pose_of((0.8, 0.1, 0.0), yaw=rng.uniform(2.6, 3.6))),
        (bicycle, pose_of((1.3, 1.0, 0.0), yaw=1.57 + rng.uniform(-0.3, 0.3))),
    )
    return [things(*(mesh.place(pose) for meshes, pose in groups for mesh in meshes)), wall(1.75)], (0.9, 0.1, 0.7)


def make_bench(rng: np.random.Generator) -> tuple[list[PlacedObjects], Place]:
    """Make a bench with hammers, bottles, a watering can, a hand lamp, a clamp and boards on the wall."""
    top = 0.9
    hammer = [
        capsule((0.75, -0.4, top + 0.02), (0.95, -0.25, top + 0.02), 0.014),
        box((0.93, -0.28, top), (0.98, -0.2, top + 0.05)),
    ]
    bottles = [
        lathe([(0.0, 0.0), (r, 0.0), (r, h), (0.4 * r, 1.2 * h), (0.4 * r, 1.4 * h), (0.0, 1.4 * h)], (0.95, y, top))
        for r, h, y in ((0.035, 0.15, 0.0), (0.045, 0.2, 0.12))
    ]
    watering = [
        lathe([(0.0, 0.0), (0.09, 0.0), (0.09, 0.2), (0.0, 0.2)], (0.9, 0.45, top)),
        capsule((0.85, 0.5, top + 0.05), (0.7, 0.62, top + 0.24), 0.014),
        torus((0.95, 0.4, top + 0.2), (0.5, 0.7, 0.0), 0.08, 0.009, 48, 8),
    ]
    lamp = [
        capsule((0.8, -0.7, top + 0.03), (0.98, -0.72, top + 0.03), 0.025),
        cylinder((0.78, -0.7, top + 0.05), (0.8, -0.7, top + 0.05), 0.045),
    ]
    gun = [box((0.7, 0.2, top), (0.78, 0.23, top + 0.12)), box((0.74, 0.2, top + 0.12), (0.95, 0.23, top + 0.15))]
    spout = ("hose", np.array([0.7, 0.62, top + 0.24]))
    return [
        PlacedObjects((*hammer, *bottles, *watering, *lamp, *gun), (), (spout,)),
        table((0.6, -1.0, 0.0), 1.9, 0.6, top),
        wall(1.25),
        *cartons(rng, 1, (0.8, 1.5), 0.1),
    ], (0.8, 0.0, 1.0)


ABSENT: Mapping[str, Maker] = {
    "none_ladders": make_ladders,
    "none_rails": make_rails,
    "none_extinguishers": make_extinguishers,
    "none_reels": make_reels,
    "none_switches": make_switches,
    "none_fans": make_fans,
    "none_chairs": make_chairs,
    "none_drawers": make_drawers,
    "none_machines": make_machines,
    "none_carts": make_carts,
    "none_bench": make_bench,
}
