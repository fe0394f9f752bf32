"""Objects taken and put elsewhere by Atlas: certified or not, done or not in physics, at what cost.

``python -m benchmarks.tasks.carry [--count N] [--seed S] [--perturb P] [--kinds one both]``
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from benchmarks.tasks.drawn import COLUMNS, carry_out_draws
from costs.robot import load_robot
from service.request.file import parse_request

PLATE_M = 0.04  # thickness of tables
KINDS = ("one", "both")


def draw_one(rng: np.random.Generator) -> dict[str, Any]:
    """Return a request for one hand: a box or a can on a table, put elsewhere on it or on a shelf beside."""
    height, side = float(rng.uniform(0.7, 1.05)), float(rng.choice([-1.0, 1.0]))
    is_can = bool(rng.random() < 0.4)
    tall = float(rng.uniform(0.08, 0.2))
    shape: dict[str, Any] = {"type": "box", "size": [float(v) for v in rng.uniform(0.03, 0.07, 2)] + [tall]}
    if is_can:
        shape = {"type": "cylinder", "radius": float(rng.uniform(0.02, 0.035)), "height": tall}
    turn = float(rng.uniform(-0.7, 0.7))
    at = [float(rng.uniform(0.5, 0.62)), side * float(rng.uniform(0.1, 0.35))]
    to = [float(rng.uniform(0.5, 0.62)), side * float(rng.uniform(0.1, 0.35))]
    shelf = height + float(rng.choice([0.0, 0.15]))
    obstacles = [_plate("table", [0.75, 0.6 * side], height), _plate("shelf", [0.75, -0.1 * side], shelf)]
    if shelf > height:
        to[1] = -0.1 * side + float(rng.uniform(-0.1, 0.1))
        at[1] = side * float(rng.uniform(0.34, 0.45))
    else:
        obstacles[0] = _plate("table", [0.75, 0.0], height, 1.4)
        del obstacles[1]
    rise = 0.5 * tall
    return _request(
        obstacles,
        {
            **shape,
            "mass_kg": float(rng.uniform(0.2, 3.0)),
            "position": [*at, height + rise],
            "quaternion_wxyz": _turn(turn),
        },
        {"to": {"position": [*to, (shelf if shelf > height else height) + rise]}, "grip_n": 150.0},
    )


def draw_both(rng: np.random.Generator) -> dict[str, Any]:
    """Return a request for two hands: a beam on two posts, put on two higher ones."""
    low, high = float(rng.uniform(0.3, 0.6)), float(rng.uniform(0.75, 1.0))
    length, thick = float(rng.uniform(1.6, 2.2)), float(rng.uniform(0.04, 0.07))
    near, far = float(rng.uniform(0.4, 0.48)), float(rng.uniform(0.6, 0.66))
    posts = [
        _post(f"{name}_{side}", x, 0.37 * length * sign, top - 0.5 * thick)
        for name, x, top in (("low", near, low), ("high", far, high))
        for side, sign in (("left", 1.0), ("right", -1.0))
    ]
    beam = {"type": "box", "size": [thick, length, thick], "mass_kg": float(rng.uniform(4.0, 10.0))}
    return _request(
        posts,
        {**beam, "position": [near, 0.0, low]},
        {"to": {"position": [far, 0.0, high]}, "hand": "both", "grip_n": 180.0},
    )


def _request(obstacles: list[dict[str, Any]], item: Mapping[str, Any], section: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "robot": {"name": "atlas", "hand": "gripper"},
        "start": {"posture": "reach_ready"},
        "scene": {"obstacles": obstacles, "objects": [{"name": "object", **item}]},
        "task": {"pick_place": {"object": "object", **section}},
    }


def _plate(name: str, at: list[float], top: float, width: float = 0.6) -> dict[str, Any]:
    return {"name": name, "type": "box", "size": [0.6, width, PLATE_M], "position": [*at, top - 0.5 * PLATE_M]}


def _post(name: str, x: float, y: float, top: float) -> dict[str, Any]:
    return {"name": name, "type": "box", "size": [0.1, 0.1, top], "position": [x, y, 0.5 * top]}


def _turn(angle: float) -> list[float]:
    return [float(np.cos(0.5 * angle)), 0.0, 0.0, float(np.sin(0.5 * angle))]


def main() -> None:
    """Plan every draw, carry out what is certified, and print a row per kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--perturb", type=float, default=0.0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    given = parser.parse_args()
    robot, rows = load_robot("atlas", hand="gripper"), []
    for kind in given.kinds:
        seeds, draw = range(given.seed, given.seed + given.count), draw_one if kind == "one" else draw_both
        draws = ((seed, parse_request(draw(np.random.default_rng([seed, KINDS.index(kind)])))) for seed in seeds)
        rows.append([kind, *carry_out_draws(kind, draws, given.perturb, robot)])
    print_table("Objects carried", ["hands", *COLUMNS], rows)


if __name__ == "__main__":
    main()
