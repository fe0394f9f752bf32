"""Seeded random holds as requests: bars, buttons, hatches, chains, wheels and doors, with pegs on any side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.tasks.given_cases import make_doors
from service.demands.hands import PEG_RADIUS

X, Y, Z = np.eye(3)
Vector = Float[np.ndarray, "3"]
OPEN_DEG = 30.0
TILTS_DEG = (10.0, 20.0, 30.0, 45.0)  # of the hand's lean


@dataclass(frozen=True)
class Draw:
    """One hold.

    Attributes:
        number: of the draw.
        kind: of what is moved.
        request: as plain data.
        needs_place: whether the place to stand is searched first.
    """

    number: int
    kind: str
    request: dict[str, Any]
    needs_place: bool = False


def make_draws(seed: int) -> Iterator[Draw]:
    """Yield holds without end; the first ``n`` of a seed are always the same."""
    doors = make_doors(10_000, seed, OPEN_DEG)
    kinds = tuple(MAKERS)
    for number in count():
        rng = np.random.default_rng([seed, number])
        kind = kinds[number % len(kinds)]
        if kind == "door":
            case = next(doors)
            yield Draw(number, case.group, {**case.request, "options": {}}, needs_place=True)
            continue
        yield Draw(number, kind, MAKERS[kind](rng))


def _make_request(task: dict[str, Any], hand: str = "hook") -> dict[str, Any]:
    return {"robot": {"name": "atlas", "hand": hand}, "start": {"posture": "reach_ready"}, "task": task}


def _make_bar(
    rng: np.random.Generator, direction: Callable[[Vector, Vector], Vector], *, turns: bool
) -> dict[str, Any]:
    """Return a bar that a peg moves: the peg is on a random side of it, in a random of the ways that hands reach.

    Args:
        rng: of the draw.
        direction: from the bar's axis and the unit vector from the peg's middle to the bar's to that of its motion.
        turns: whether the bar turns about an axis beside it; it slides otherwise.
    """
    bar, hand = _choose(rng, ((Y, -Z), (Y, X), (Z, X), (Z, Y), (Z, -Y)))
    side = float(rng.choice([-1.0, 1.0])) * np.cross(bar, hand)  # from the bar's middle to the peg's
    radius, length = rng.uniform(0.008, 0.014), rng.uniform(0.16, 0.3)
    moves = direction(bar, -side)
    place = (radius + PEG_RADIUS) * side
    joint, travel, friction = ("prismatic", moves, Z * 0.0), rng.uniform(0.06, 0.15), rng.uniform(10.0, 40.0)
    if turns:
        arm = rng.uniform(0.12, 0.25)
        away = np.cross(moves, bar)  # the bar's middle is beside the axis, which is parallel to it
        joint, travel, friction = ("revolute", bar, arm * away), rng.uniform(0.4, 1.0), friction * arm
    kind, axis, offset = joint
    urdf = _write_urdf(
        [("bar", _write_cylinder(radius, length, offset, bar))], [("move", "bar", kind, axis)]
    )  # fmt: skip
    return _make_request({
        "mechanism": {
            "urdf": urdf,
            "position": _round([rng.uniform(0.55, 0.72), rng.uniform(-0.35, -0.1), rng.uniform(0.9, 1.25)] - offset),
            "handle": {
                "link": "bar", "place": _round(offset + place), "axis": _round(hand), "tool": "peg",
                "approach": _round(-0.12 * hand), "tilt_deg": float(rng.choice(TILTS_DEG)),
            },
            "joints": {"move": {"friction": round(float(friction), 2)}},
            "moves": [{"joint": "move", "to": round(float(travel), 3)}],
        }
    })  # fmt: skip


def make_rail(rng: np.random.Generator) -> dict[str, Any]:
    """Return a bar that slides in any direction across itself; half of them within 60 deg of the peg's pressure."""
    return _make_bar(rng, lambda bar, press: _turn(press, bar, _draw_angle(rng)), turns=False)


def make_drawer(rng: np.random.Generator) -> dict[str, Any]:
    """Return a bar that slides straight away from the peg or, mirrored, straight towards it, with a little slant."""
    sense = float(rng.choice([1.0, 1.0, 1.0, -1.0]))
    return _make_bar(rng, lambda bar, press: sense * _turn(press, bar, rng.normal(0.0, 0.2)), turns=False)


def make_lever(rng: np.random.Generator) -> dict[str, Any]:
    """Return a bar that turns about an axis beside it, in either sense."""
    return _make_bar(rng, lambda bar, press: _turn(press, bar, _draw_angle(rng)), turns=True)


def make_button(rng: np.random.Generator) -> dict[str, Any]:
    """Return a cap that a tip presses, straight or slanted, or that it would have to pull."""
    angle, about = abs(_draw_angle(rng)), rng.uniform(0.0, 2.0 * np.pi)
    moves = np.cos(angle) * X + np.sin(angle) * (np.cos(about) * Y + np.sin(about) * Z)
    urdf = _write_urdf([("cap", _write_cylinder(0.02, 0.02, np.zeros(3), X))], [("press", "cap", "prismatic", moves)])
    return _make_request({
        "mechanism": {
            "urdf": urdf,
            "position": _round([rng.uniform(0.65, 0.8), rng.uniform(-0.35, -0.15), rng.uniform(1.0, 1.4)]),
            "handle": {
                "link": "cap", "place": [-0.008, 0, 0], "axis": [1, 0, 0], "tool": "tip", "approach": [-0.08, 0, 0],
                "tilt_deg": float(rng.choice(TILTS_DEG[:2])),
            },
            "joints": {"press": {"friction": round(float(rng.uniform(10.0, 40.0)), 1)}},
            "moves": [{"joint": "press", "to": round(float(rng.uniform(0.008, 0.03)), 4)}],
        }
    })  # fmt: skip


def make_hatch(rng: np.random.Generator) -> dict[str, Any]:
    """Return a plate on a hinge behind it that a peg lifts or lowers, from below or from above."""
    depth, thickness = rng.uniform(0.25, 0.4), 0.02
    above = bool(rng.random() < 0.5)
    lifts = bool(rng.random() < (0.3 if above else 0.7))
    place = np.array([0.02, 0.0, (0.5 * thickness + PEG_RADIUS) * (1.0 if above else -1.0)])
    axis = Y if lifts else -Y  # about the hinge, which is at x = depth: a positive turn about y lifts the front
    urdf = _write_urdf(
        [("plate", _write_box([depth, 0.3, thickness], np.array([0.5 * depth, 0.0, 0.0]) - depth * X))],
        [("hinge", "plate", "revolute", axis)],
    )
    position = np.array([rng.uniform(0.5, 0.6), rng.uniform(-0.35, -0.15), rng.uniform(0.9, 1.2)]) + depth * X
    return _make_request({
        "mechanism": {
            "urdf": urdf,
            "position": _round(position),
            "handle": {
                "link": "plate", "place": _round(place - depth * X), "axis": [1, 0, 0], "tool": "peg",
                "approach": [-0.12, 0, 0], "tilt_deg": float(rng.choice(TILTS_DEG)),
            },
            "joints": {"hinge": {"friction": round(float(rng.uniform(2.0, 10.0)), 1)}},
            "moves": [{"joint": "hinge", "to": round(float(rng.uniform(0.2, 0.6)), 2)}],
        }
    })  # fmt: skip


def make_chain(rng: np.random.Generator) -> dict[str, Any]:
    """Return a ring with a bar that turns on a carrier that slides: the slide has a friction of its own, or none."""
    sense = float(rng.choice([-1.0, 1.0]))
    urdf = _write_urdf(
        [
            ("carrier", _write_cylinder(0.03, 0.02, 0.05 * X, X)),
            ("ring", _write_cylinder(0.045, 0.05, np.zeros(3), X) + _write_cylinder(0.01, 0.09, 0.085 * Z, Z)),
        ],
        [("push", "carrier", "prismatic", X), ("turn", "ring", "revolute", sense * X)],
    )
    side = float(rng.choice([1.0, 1.0, 1.0, -1.0])) * sense
    return _make_request({
        "mechanism": {
            "urdf": urdf,
            "position": _round([rng.uniform(0.58, 0.7), rng.uniform(-0.3, -0.1), rng.uniform(0.9, 1.15)]),
            "handle": {
                "link": "ring", "place": _round([0.0, 0.019 * side, 0.1]), "axis": [1, 0, 0], "tool": "peg",
                "approach": [-0.12, 0, 0], "tilt_deg": float(rng.choice(TILTS_DEG)),
            },
            "joints": {
                "turn": {"friction": round(float(rng.uniform(1.0, 4.0)), 1)},
                "push": {"friction": float(rng.choice([0.0, 2.0, 10.0, 40.0]))},
            },
            "moves": [{"joint": "turn", "to": round(float(rng.uniform(0.5, 1.4)), 2)}],
        }
    })  # fmt: skip


def make_wheel(rng: np.random.Generator, mode: str) -> dict[str, Any]:
    """Return a wheel that a hook or a gripper turns, either way."""
    tilt, yaw = np.deg2rad(rng.uniform(-20.0, 20.0, 2))
    axis = [-np.cos(tilt) * np.cos(yaw), -np.cos(tilt) * np.sin(yaw), np.sin(tilt)]
    first = rng.uniform(0.0, 120.0)
    valve = {
        "mode": mode,
        "centre": _round([rng.uniform(0.62, 0.8), rng.uniform(-0.25, 0.25), rng.uniform(0.95, 1.25)]),
        "axis": [float(value) for value in axis],
        "radius": round(float(rng.uniform(0.11, 0.2)), 3),
        "turn_deg": round(float(rng.choice([-1.0, 1.0]) * rng.uniform(60.0, 240.0))),
        "torque_nm": round(float(rng.uniform(2.0, 8.0)), 1),
        "spokes_deg": [round(float(first + 120.0 * k), 1) for k in range(3)],
    }
    return _make_request({"valve": valve}, "hook" if mode == "hook" else "gripper")


MAKERS: dict[str, Callable[[np.random.Generator], dict[str, Any]]] = {
    "rail": make_rail,
    "lever": make_lever,
    "button": make_button,
    "hatch": make_hatch,
    "drawer": make_drawer,
    "chain": make_chain,
    "wheel hook": lambda rng: make_wheel(rng, "hook"),
    "wheel grip": lambda rng: make_wheel(rng, "grasp"),
    "door": lambda rng: {},  # benchmarks.tasks.given_cases makes them
}


def _choose(rng: np.random.Generator, pairs: tuple[tuple[Vector, Vector], ...]) -> tuple[Vector, Vector]:
    return pairs[int(rng.integers(len(pairs)))]


def _draw_angle(rng: np.random.Generator) -> float:
    """Return an angle between the pressure and the motion: half within 60 deg, half anywhere [rad]."""
    most = np.pi / 3.0 if rng.random() < 0.5 else np.pi
    return float(rng.uniform(-most, most))


def _turn(vector: Vector, axis: Vector, angle: float) -> Vector:
    """Return a vector turned about a unit axis square to it."""
    return np.asarray(np.cos(angle) * vector + np.sin(angle) * np.cross(axis, vector))


def _round(vector: Any) -> list[float]:
    return [round(float(value), 5) + 0.0 for value in vector]


def _write_cylinder(radius: float, length: float, middle: Vector, axis: Vector) -> str:
    rpy = {"x": "0 1.570796 0", "y": "1.570796 0 0", "z": "0 0 0"}["xyz"[int(np.abs(axis).argmax())]]
    return (
        f'<collision><origin xyz="{_join(middle)}" rpy="{rpy}"/>'
        f'<geometry><cylinder radius="{radius:.4f}" length="{length:.4f}"/></geometry></collision>'
    )


def _write_box(size: list[float], middle: Vector) -> str:
    return (
        f'<collision><origin xyz="{_join(middle)}"/><geometry><box size="{_join(size)}"/></geometry></collision>'
    )  # fmt: skip


def _join(vector: Any) -> str:
    return " ".join(f"{float(value) + 0.0:.5f}" for value in vector)


def _write_urdf(links: list[tuple[str, str]], joints: list[tuple[str, str, str, Vector]]) -> str:
    """Return a URDF: a base without shape, and links in a chain."""
    parent, text = "base", '<robot name="m"><link name="base"/>'
    for name, shapes in links:
        text += f'<link name="{name}">{shapes}</link>'
    for name, child, kind, axis in joints:
        text += (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="{_join(axis)}"/><limit lower="-1.5" upper="1.5" velocity="1" effort="500"/></joint>'
        )
        parent = child
    return f"{text}</robot>"
