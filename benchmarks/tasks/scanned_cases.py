"""Seeded valves and doors that a simulated lidar sees from where the robot stands.

``benchmarks.tasks.scanned`` plans them.

Valves: wheels of 10 to 20 cm for hook and gripper, lever valves, and cranks on axes tilted by 34 degrees; on pipes
before a wall.  Doors: both sides, both hinge sides, levers, pull handles and push bars, shut and ajar.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np

from perception.simulate import Mesh, Scanner, box
from perception.simulate.scenes.doors import Door, truth_geometry
from perception.simulate.scenes.valves import LeverValve, PipedWheel
from perception.simulate.valve_scene import Room, Valve

SCANNER = Scanner()
HINT_SIGMA = 0.04  # of the click of an operator [m]
VALVES = ("hook", "lever", "grasp", "crank")
# opens, furniture, angle at the start [deg]; each with the hinges on either side
DOORS = (
    ("push", "lever", 0.0),
    ("pull", "lever", 0.0),
    ("push", "bar", 0.0),
    ("pull", "pull", 0.0),
    ("push", "lever", 12.0),
    ("pull", "pull", 10.0),
    ("push", "bar", 10.0),
    ("pull", "lever", 10.0),
)
OPEN_DEG = 30.0
CRANK_TILT_DEG = 34.0
KINDS = {"lever": "lever", "pull": "pull", "bar": "push_bar"}


@dataclass(frozen=True)
class ScannedCase:
    """A scene with an object to move.

    Attributes:
        name, group: of the case, and of the table's row.
        meshes: of the scene.
        true: the request's section ``task``, with the object as it is.
        seen: the same, with the object left to the scan.
        middle: (3,) of the object [m].
        hand: of the robot.
    """

    name: str
    group: str
    meshes: tuple[Mesh, ...]
    true: dict[str, Any]
    seen: dict[str, Any]
    middle: tuple[float, ...]
    hand: str


def make_scanned_valves(count: int, seed: int) -> Iterator[ScannedCase]:
    """Yield valves before a wall, kinds in turn."""
    rng = np.random.default_rng([seed, 3])
    for number, kind in zip(range(count), cycle(VALVES), strict=False):
        yield _make_valve(rng, number, kind)


def _make_valve(rng: np.random.Generator, number: int, kind: str) -> ScannedCase:
    yaw = np.deg2rad(rng.uniform(-20.0, 20.0))
    tilt = np.deg2rad(CRANK_TILT_DEG if kind == "crank" else rng.uniform(-10.0, 25.0))
    axis = np.array([-np.cos(tilt) * np.cos(yaw), -np.cos(tilt) * np.sin(yaw), np.sin(tilt)])
    centre = np.array([rng.uniform(0.7, 0.8), rng.uniform(-0.15, 0.15), rng.uniform(0.95, 1.25)])
    across = (0.0, 1.0, 0.0) if rng.random() < 0.5 else (0.0, 0.0, 1.0)
    common = {"centre": _list(centre), "axis": _list(axis)}
    hint = _list(centre + rng.normal(0.0, HINT_SIGMA, 3))
    room = Room(wall_x=float(centre[0] + 0.35))
    if kind in ("lever", "crank"):
        side = np.cross([0.0, 0.0, 1.0], axis)
        side /= np.linalg.norm(side)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        direction = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
        length = float(rng.uniform(0.18, 0.28) if kind == "lever" else rng.uniform(0.16, 0.22))
        grip = 0.0 if kind == "lever" else float(rng.uniform(0.09, 0.12))
        placed = LeverValve(_tuple(centre), _tuple(axis), _tuple(direction), length, pipe_direction=across, grip=grip)
        turn = float(rng.choice([-1.0, 1.0])) * (90.0 if kind == "lever" else 360.0)
        lever = {"direction": _list(direction), "length_m": length, "grip_m": grip}
        task = {"mode": "hook", "turn_deg": turn}
        name = f"valve {number}: {kind} {length:.2f} m"
        meshes = (*room.meshes(), *placed.build().meshes)
        true, seen = {**task, **common, "lever": lever}, {**task, "hint": hint}
        return ScannedCase(name, kind, meshes, {"valve": true}, {"valve": seen}, _tuple(centre), "hook")
    outer, tube = float(rng.uniform(0.1, 0.2)), float(rng.uniform(0.011, 0.016))
    n_spokes, spin = int(rng.integers(3, 6)), float(rng.uniform(0.0, 2.0))
    wheel = Valve(
        _tuple(centre), _tuple(axis), outer - tube, tube, n_spokes, spin, 0.55 * tube + 0.001, max(0.2 * outer, 0.02),
        max(0.1 * outer, 0.01), 0.16,
    )  # fmt: skip
    task = {"mode": kind, "turn_deg": 360.0}
    spokes = {"spokes_deg": [float(np.rad2deg(angle)) for angle in wheel.spoke_angles], "spoke_width_m": 0.02}
    true, seen = {**task, **common, "radius": outer - tube, **spokes}, {**task, "hint": hint}
    meshes = (*room.meshes(), *PipedWheel(wheel, across).build().meshes)
    name = f"valve {number}: {kind} radius {outer:.2f} m"
    hand = "hook" if kind == "hook" else "gripper"
    return ScannedCase(name, kind, meshes, {"valve": true}, {"valve": seen}, _tuple(centre), hand)


def make_scanned_doors(count: int, seed: int) -> Iterator[ScannedCase]:
    """Yield doors in frames in a wall, kinds in turn; what no scan can show of them is stated."""
    rng = np.random.default_rng([seed, 4])
    kinds = cycle([(*door, side) for side in ("right", "left") for door in DOORS])
    for number in range(count):
        opens, furniture, ajar_deg, hinge_on = next(kinds)
        yield _make_door(rng, number, opens, furniture, ajar_deg, hinge_on)


def _make_door(
    rng: np.random.Generator, number: int, opens: str, furniture: str, ajar_deg: float, hinge_on: str
) -> ScannedCase:
    width, along = rng.uniform(0.76, 1.0), (-0.5 if hinge_on == "left" else 0.5) * np.pi
    along += np.deg2rad(rng.uniform(-12.0, 12.0))
    middle = np.array([rng.uniform(0.85, 1.05), rng.uniform(-0.15, 0.15)])
    hinge = middle - 0.5 * width * np.array([np.cos(along), np.sin(along)])
    ajar = np.deg2rad(ajar_deg + rng.uniform(-2.0, 2.0)) if ajar_deg else 0.0
    door = Door(
        _tuple(hinge), along, hinge_on, opens, ajar, width, furniture=furniture, handle_z=rng.uniform(0.95, 1.08),  # type: ignore[arg-type]
        backset=rng.uniform(0.055, 0.085), lever_length=rng.uniform(0.115, 0.14), pull_length=rng.uniform(0.25, 0.4),
        standoff=rng.uniform(0.056, 0.068), gap=rng.uniform(0.003, 0.006),
    )  # fmt: skip
    truth = truth_geometry(door)
    task: dict[str, Any] = {"open_deg": OPEN_DEG, "opens": opens}
    edge = truth.hinge + truth.width * truth.along
    leaf = {
        "hinge": _list(truth.hinge), "edge": _list(edge), "height_m": float(truth.height),
        "thickness_m": float(truth.thickness), "ajar_deg": float(np.rad2deg(truth.ajar)),
    }  # fmt: skip
    bar = truth.handle
    handle = {} if bar is None else {
        "kind": bar.kind, "centre": _list(bar.centre), "direction": _list(bar.direction),
        "length_m": float(bar.length), "radius_m": float(bar.radius),
    }  # fmt: skip
    place = truth.hinge + 0.5 * truth.width * truth.along
    seen: dict[str, Any] = {**task, "hint": _list([*(place[:2] + rng.normal(0.0, HINT_SIGMA, 2)), 1.1])}
    if furniture == "bar" and not ajar:
        seen["hinge"] = hinge_on
    around = [box((-6.0, -6.0, -0.1), (6.0, 6.0, 0.0)), box((3.8, -4.0, 0.0), (3.9, 4.0, 2.6))]
    group = f"{opens} {KINDS[furniture]}{' ajar' if ajar else ''}"
    return ScannedCase(
        f"door {number}: {group} {hinge_on}", group, (*door.build().meshes, *around),
        {"door": {**task, "leaf": leaf, "handle": handle}}, {"door": seen}, (*_tuple(place[:2]), 1.05), "hook",
    )  # fmt: skip


def _list(values: Sequence[float] | np.ndarray) -> list[float]:
    return [round(float(value), 5) for value in values]


def _tuple(values: Sequence[float] | np.ndarray) -> Any:
    return tuple(float(value) for value in values)
