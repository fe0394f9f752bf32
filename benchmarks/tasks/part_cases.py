"""Requests of task files that push parts and follow faces, drawn for Atlas: pose, height and side are chance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from benchmarks.tasks.given_cases import make_doors, make_valves

Data = dict[str, Any]
THICK_M = 0.12  # of a wall


def request_of(use: str, values: Data, obstacles: list[Data], **more: Data) -> Data:
    """Return the request of a task file for Atlas."""
    request = {"robot": {"name": "atlas"}, "scene": {"floor": True, "obstacles": obstacles}, **more}
    return {**request, "task": {"use": use, "with": values}}


def make_wall(x: float) -> Data:
    """Return a wall whose face is at ``x``."""
    return {"name": "wall", "type": "box", "size": [THICK_M, 2.4, 2.4], "position": [x + 0.5 * THICK_M, 0.0, 1.2]}


def _draw(rng: np.random.Generator, *ranges: tuple[float, float]) -> tuple[float, ...]:
    return tuple(float(rng.uniform(*limits)) for limits in ranges)


def draw_button(rng: np.random.Generator) -> Data:
    """Return a button in front of a panel: 5-30 N, 5-12 mm of travel, on either side."""
    x, height, force, travel = _draw(rng, (0.62, 0.75), (0.95, 1.35), (5.0, 30.0), (0.005, 0.012))
    y = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.35))
    values = {"at": [x, y, height], "force": force, "travel": travel}
    return request_of("button", values, [make_wall(x + travel + 0.005)])


def draw_lever(rng: np.random.Generator) -> Data:
    """Return a lever before a board: 12-22 cm long, 1-6 N m, turned by 30-70 deg either way, on either side."""
    x, height, length, torque, turn = _draw(rng, (0.6, 0.7), (1.0, 1.3), (0.12, 0.22), (1.0, 6.0), (30.0, 70.0))
    side = float(rng.choice([-1.0, 1.0]))
    values = {
        "pivot": [x, side * float(rng.uniform(0.15, 0.35)), height], "bar": [0, -side, 0], "length": length,
        "torque": torque, "turn": turn * float(rng.choice([-1.0, 1.0])),
    }  # fmt: skip
    return request_of("lever", values, [make_wall(x + 0.12)], start={"posture": "reach_ready"})


def draw_drill(rng: np.random.Generator) -> Data:
    """Return a circle of 6-20 cm on a wall 0.7-0.8 m ahead, its centre 1.0-1.3 m high."""
    x, y, height, radius = _draw(rng, (0.7, 0.8), (-0.3, 0.0), (1.0, 1.3), (0.06, 0.2))
    return request_of("drill", {"centre": [x, y, height], "radius": radius, "wall": ["wall"]}, [make_wall(x)])


def draw_cut(rng: np.random.Generator) -> Data:
    """Return a drill of 1-2 kg on a shelf at a wall 0.85-0.95 m ahead, and a circle of 5-12 cm on that."""
    x, y, height, radius = _draw(rng, (0.85, 0.95), (-0.3, 0.0), (1.0, 1.25), (0.05, 0.12))
    top, at, side, length, mass = _draw(rng, (0.8, 0.95), (0.58, 0.64), (-0.5, -0.35), (0.16, 0.22), (1.0, 2.0))
    shelf = {"name": "shelf", "type": "box", "size": [0.3, 0.3, 0.02], "position": [at, side, top - 0.01]}
    width = float(rng.uniform(0.04, 0.055))
    drill = {
        "name": "drill", "type": "box", "size": [width, width, length], "mass_kg": mass,
        "position": [at, side, top + 0.5 * width], "quaternion_wxyz": [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0],
    }  # fmt: skip
    values = {
        "tip": 0.5 * length, "centre": [x, y, height], "radius": radius, "wall": ["wall"], "hand": "right",
        "thrust": float(rng.uniform(5.0, 20.0)),
    }  # fmt: skip
    request = request_of("cut", values, [make_wall(x), shelf], start={"posture": "reach_ready"})
    request["robot"]["hand"] = "gripper"
    request["scene"]["objects"] = [drill]
    return request


def draw_wipe(rng: np.random.Generator) -> Data:
    """Return strokes of 15-30 cm on a wall or a table, by either hand."""
    side = str(rng.choice(["left", "right"]))
    sign, length = 1.0 if side == "left" else -1.0, float(rng.uniform(0.15, 0.3))
    values: Data = {"length": length, "hand": side, "force": float(rng.uniform(2.0, 15.0))}
    if rng.random() < 0.5:
        x, height = _draw(rng, (0.65, 0.8), (1.0, 1.3))
        corner = [x, sign * 0.25 - 0.5 * length, height]
        return request_of("wipe", {**values, "corner": corner, "pieces": ["wall"]}, [make_wall(x)])
    top, x = _draw(rng, (0.8, 1.0), (0.4, 0.5))
    table = {"name": "table", "type": "box", "size": [0.6, 1.6, 0.05], "position": [0.65, 0.0, top - 0.025]}
    corner = [x, sign * 0.3 - 0.5 * length, top]
    values |= {"corner": corner, "normal": [0, 0, 1], "pieces": ["table"]}
    return request_of("wipe", values, [table], start={"posture": "reach_ready"})


def draw_door(rng: np.random.Generator) -> Data:
    """Return a door of ``benchmarks.tasks.given_cases``, opened by 40 deg."""
    cases = list(make_doors(12, int(rng.integers(10**6)), 40.0))
    return cases[int(rng.integers(12))].request


def draw_valve(rng: np.random.Generator) -> Data:
    """Return a valve of ``benchmarks.tasks.given_cases``."""
    cases = list(make_valves(12, int(rng.integers(10**6))))
    return cases[int(rng.integers(12))].request


PART_CASES: Mapping[str, Callable[[np.random.Generator], Data]] = {
    "button": draw_button,
    "lever": draw_lever,
    "drill": draw_drill,
    "cut": draw_cut,
    "wipe": draw_wipe,
    "door": draw_door,
    "valve": draw_valve,
}
"""Makers of requests by task file; the planner's objects are given."""
