"""Requests of task files that take objects, drawn from stated ranges, for a gantry or for Atlas with grippers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Data = dict[str, Any]
RIM_M = 0.04


@dataclass(frozen=True)
class Place:
    """Where a robot works.

    Attributes:
        top: height of a table there [m].
        x, y: ranges of places on it [m].
        apart_m: least distance of two of them.
        base: robot, start and floor of a request.
    """

    top: tuple[float, float]
    x: tuple[float, float]
    y: tuple[float, float]
    apart_m: float
    base: Data

    def draw(self, rng: np.random.Generator) -> tuple[float, tuple[float, float], tuple[float, float]]:
        """Return the table's height, and two places that are apart on it [m]."""
        top = float(rng.uniform(*self.top))
        while True:
            first, second = ((float(rng.uniform(*self.x)), float(rng.uniform(*self.y))) for _ in range(2))
            if np.hypot(first[0] - second[0], first[1] - second[1]) > self.apart_m:
                return top, first, second


def make_gantry_place(urdf: str) -> Place:
    """Return the table below a gantry (``benchmarks.attack.gantry_files``)."""
    hand = {"link": "hand", "hook": "hand", "tool": "tool", "fingers": ["finger_1", "finger_2"]}
    base = {
        "robot": {"urdf": urdf, "hands": {"right": hand}},
        "start": {"joints": {"z": -0.1, "grip_1": 0.01, "grip_2": 0.01}},
        "scene": {"floor": 0.0},
    }
    return Place((0.35, 0.5), (-0.25, 0.25), (-0.25, 0.25), 0.25, base)


ATLAS = Place(
    (0.75, 1.0),
    (0.42, 0.55),
    (-0.45, -0.05),
    0.2,
    {"robot": {"name": "atlas", "hand": "gripper"}, "start": {"posture": "reach_ready"}, "scene": {"floor": True}},
)


def _request(place: Place, top: float, walls: list[Data], item: Data, use: str, values: Data) -> Data:
    middle = [0.5 * sum(place.x), 0.5 * sum(place.y)]
    size = [place.x[1] - place.x[0] + 0.4, place.y[1] - place.y[0] + 0.4, 0.1]
    table = {"type": "box", "name": "table", "size": size, "position": [*middle, top - 0.05]}
    scene = {**place.base["scene"], "obstacles": [table, *walls], "objects": [{"name": "item", **item}]}
    return {**place.base, "scene": scene, "task": {"use": use, "with": {"object": "item", **values}}}


def make_hole(name: str, at: tuple[float, float], bottom: float, width: float, depth: float) -> list[Data]:
    """Return four walls about a square hole that opens upwards."""
    off = 0.5 * (width + RIM_M)
    walls = {
        "left": ([off, 0.0], [RIM_M, width + 2.0 * RIM_M]),
        "right": ([-off, 0.0], [RIM_M, width + 2.0 * RIM_M]),
        "far": ([0.0, off], [width, RIM_M]),
        "near": ([0.0, -off], [width, RIM_M]),
    }
    return [
        {
            "type": "box",
            "name": f"{name} {side}",
            "size": [*size, depth],
            "position": [at[0] + shift[0], at[1] + shift[1], bottom + 0.5 * depth],
        }
        for side, (shift, size) in walls.items()
    ]


def _draw(rng: np.random.Generator, *ranges: tuple[float, float]) -> tuple[float, ...]:
    return tuple(float(rng.uniform(*limits)) for limits in ranges)


def draw_plug(place: Place, rng: np.random.Generator) -> Data:
    """Return a plug in one socket of a bench, and another socket: 30-45 mm wide, 30-60 mm deep, 1.5-4 mm of play."""
    top, first, second = place.draw(rng)
    width, depth, play = _draw(rng, (0.03, 0.045), (0.03, 0.06), (1.5e-3, 4e-3))
    walls = [*make_hole("one", first, top, width + play, depth), *make_hole("two", second, top, width + play, depth)]
    height = depth + float(rng.uniform(0.06, 0.09))
    item = {"type": "box", "size": [width, width, height], "mass_kg": float(rng.uniform(0.1, 0.8))}
    values = {
        "to": [*second, top + 0.5 * height], "normal": [0, 0, 1], "depth": depth, "clear": 0.03, "clearance": play,
        "sockets": [wall["name"] for wall in walls],
    }  # fmt: skip
    return _request(place, top, walls, {**item, "position": [*first, top + 0.5 * height]}, "plug", values)


def draw_debris(place: Place, rng: np.random.Generator) -> Data:
    """Return a short beam that lies between two others, up to which it has 3-6 cm."""
    top, first, second = place.draw(rng)
    thick, length = float(rng.uniform(0.03, 0.05)), float(rng.uniform(0.15, 0.25))
    gap = float(rng.uniform(0.03, 0.06)) + thick
    walls = [
        {"type": "box", "name": f"beam {k}", "size": [length, thick, thick],
         "position": [first[0], first[1] + sign * gap, top + 0.5 * thick]}
        for k, sign in enumerate((1.0, -1.0))
    ]  # fmt: skip
    item = {"type": "box", "size": [length, thick, thick], "mass_kg": float(rng.uniform(0.5, 2.0))}
    values = {"to": [*second, top + 0.5 * thick]}
    return _request(place, top, walls, {**item, "position": [*first, top + 0.5 * thick]}, "debris", values)


def draw_hose(place: Place, rng: np.random.Generator) -> Data:
    """Return the end of a hose that stands on a bench, and a standpipe that points upwards, a square hole here.

    In every other draw it goes to the bottom, and is turned in two grips.
    """
    top, first, second = place.draw(rng)
    radius, depth, play = _draw(rng, (0.016, 0.022), (0.02, 0.04), (2e-3, 5e-3))
    walls = make_hole("pipe", second, top, 2.0 * radius + play, depth)
    height = float(rng.uniform(0.12, 0.16))
    item = {"type": "cylinder", "radius": radius, "height": height, "mass_kg": float(rng.uniform(0.3, 1.5))}
    values = {
        "to": [*second, top + 0.5 * height + 8e-3], "axis": [0, 0, -1], "depth": depth, "clearance": play,
        "turn": float(rng.uniform(15.0, 45.0)), "pieces": [wall["name"] for wall in walls],
    }  # fmt: skip
    if rng.random() < 0.5:
        rests = {"to": [*second, top + 0.5 * height], "pieces": [*values["pieces"], "table"], "regrasps": 1}
        values |= rests
    return _request(place, top, walls, {**item, "position": [*first, top + 0.5 * height]}, "hose", values)


def draw_part(place: Place, rng: np.random.Generator) -> Data:
    """Return a part on a bench and a fixture into which it goes from above."""
    top, first, second = place.draw(rng)
    width, depth, play = _draw(rng, (0.03, 0.05), (0.015, 0.03), (1.5e-3, 4e-3))
    walls = make_hole("fixture", second, top, width + play, depth)
    height = float(rng.uniform(0.09, 0.12))
    item = {"type": "box", "size": [width, width, height], "mass_kg": float(rng.uniform(0.2, 1.5))}
    values = {
        "to": [*second, top + 0.5 * height], "depth": depth, "clearance": play, "reach": 0.05,
        "fixture": [wall["name"] for wall in walls],
    }  # fmt: skip
    return _request(place, top, walls, {**item, "position": [*first, top + 0.5 * height]}, "tend_machine", values)


def draw_block(place: Place, rng: np.random.Generator) -> Data:
    """Return a block or a cylinder that is put elsewhere on a bench."""
    top, first, second = place.draw(rng)
    width, height = float(rng.uniform(0.03, 0.06)), float(rng.uniform(0.06, 0.14))
    shape: Data = {"type": "box", "size": [width, width, height]}
    if rng.random() < 0.5:
        shape = {"type": "cylinder", "radius": 0.5 * width, "height": height}
    item = {**shape, "mass_kg": float(rng.uniform(0.2, 1.5)), "position": [*first, top + 0.5 * height]}
    return _request(place, top, [], item, "pick_place", {"to": [*second, top + 0.5 * height]})


CASES: Mapping[str, Callable[[Place, np.random.Generator], Data]] = {
    "pick_place": draw_block,
    "plug": draw_plug,
    "debris": draw_debris,
    "hose": draw_hose,
    "tend_machine": draw_part,
}
"""Makers of requests by task file."""
