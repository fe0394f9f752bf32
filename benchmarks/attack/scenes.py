"""Scenes and names that lie: obstacles called like parts of the robot, floors that are not there, millimetres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack import bases, judges
from benchmarks.attack.arm_files import GOAL, POST, SHELF, START, arm_request, honest_urdf, write_arm
from benchmarks.attack.outcome import Answer, Attack
from benchmarks.attack.requests import Expected, Lie, answer_of
from service import RequestError

NO, NAMED, TRUTH = Expected.NO_CERTIFICATE, Expected.NAMED, Expected.TRUTH
ATTACKS: list[Attack] = []
SLOW = (
    "a valve under the floor",
    "a valve in a wall",
    "a floor under one foot",
    "a floor under the toes alone",
    "floor at 20 mm",
    "floor at 29 mm",
    "fifty posts in one",
    "a wall called like the rim, in the hand's way",
    *(f"rods across the circle called '{name}'" for name in ("rod", "valve", "valve/rim", "valve/rim/", "l_hook", "floor")),
)
Box = dict[str, Any]


def attacks() -> list[Attack]:
    """One for each scene."""
    return [replace(attack, is_short=attack.is_short and attack.name not in SLOW) for attack in ATTACKS]


def _arm(name: str, expected: Expected, *words: str, **more: Any) -> None:
    """Register a scene around the arm; ``more`` replaces parts of its request."""

    def run(scratch: Path) -> tuple[Answer, str]:
        request = arm_request(write_arm(scratch), **more)
        apart = (("forearm", "hand"),)
        return answer_of(Lie(request, expected, words, honest_urdf(), scratch, "collision", apart), scratch)

    ATTACKS.append(Attack("scenes", name, run))


def _obstacles(name: str, expected: Expected, *obstacles: Box, words: tuple[str, ...] = ()) -> None:
    _arm(name, expected, *words, scene={"obstacles": list(obstacles)})


def _atlas(name: str, request: Callable[[], dict[str, Any]], expected: Expected = NO, *words: str) -> None:
    """Register a request of the bundled Atlas, for which nothing but a word beside the verdict excuses CERTIFIED."""
    run = lambda scratch: answer_of(Lie(request(), expected, words), scratch)  # noqa: E731
    ATTACKS.append(Attack("scenes", name, run))


def _box(name: str, size: list[float], position: list[float], **more: Any) -> Box:
    return {"name": name, "type": "box", "size": size, "position": position, **more}


def _convex(points: list[list[float]]) -> Box:
    return {"name": "stone", "type": "convex", "points": points, "position": [0.0, 0.0, 0.0]}


# Names.
for _name in ("hand", "forearm", "base", "universe", "floor", "post*", "*", "hand/0", "", "a\nb", "../post", "x" * 5000):
    _obstacles(f"post called {_name[:12]!r}", TRUTH, {**POST, "name": _name}, SHELF)
_obstacles("two obstacles of one name", TRUTH, POST, {**SHELF, "name": "post"})
_obstacles("two obstacles of one name, the second far away", TRUTH, POST, {**POST, "position": [9.0, 9.0, 0.45]})

# Units and numbers.
MM = (r"mm|millimetres?|units?",)
_obstacles("a table in millimetres", NAMED, _box("table", [600, 900, 40], [750, 0, 800]), words=MM)
_obstacles("a post in millimetres", NAMED, _box("post", [80, 80, 900], [620, 0, 450]), words=MM)
_obstacles("a post in millimetres at metres", NAMED, _box("post", [80, 80, 900], [60.2, 0, 0.45]), words=MM)
_obstacles("a ball in millimetres", NAMED, {"name": "ball", "type": "sphere", "radius": 150, "position": [620, 0, 450]},
    words=MM)  # fmt: skip
_obstacles("a pipe in millimetres", NAMED, {"name": "pipe", "type": "cylinder", "radius": 40, "height": 900,
    "position": [620, 0, 450]}, words=MM)  # fmt: skip
_obstacles("a stone in millimetres", NAMED, _convex([[600, 0, 0], [640, 0, 0], [620, 40, 0], [620, 0, 900]]), words=MM)
_obstacles("a box of no size", NO, _box("post", [0.08, 0.0, 0.9], [0.62, 0, 0.45]))
_obstacles("a box of negative size", NO, _box("post", [0.08, -0.08, 0.9], [0.62, 0, 0.45]))
_obstacles("a box at NaN", NO, _box("post", [0.08, 0.08, 0.9], [float("nan"), 0, 0.45]))
_obstacles("a box at infinity", NO, _box("post", [0.08, 0.08, 0.9], [float("inf"), 0, 0.45]))
_obstacles("a box at a billion metres", NO, _box("post", [0.08, 0.08, 0.9], [1e9, 0, 0.45]))
_obstacles("a box turned by nothing", NO, {**POST, "quaternion_wxyz": [0.0, 0.0, 0.0, 0.0]})
_obstacles("a box turned by two", TRUTH, {**POST, "quaternion_wxyz": [2.0, 0.0, 0.0, 0.0]})
_obstacles("a stone of one point", NO, _convex([[0.62, 0.0, 0.8]]))
_obstacles("a flat stone", TRUTH, _convex([[0.62, -0.3, 0.0], [0.62, 0.3, 0.0], [0.62, 0.3, 0.9], [0.62, -0.3, 0.9]]))
_obstacles("a stone of one point four times", NO, _convex([[0.62, 0.0, 0.8]] * 4))
_obstacles("a stone with NaN", NO, _convex([[0.6, 0, 0], [0.7, 0, 0], [0.6, 0.1, 0], [0.6, 0, float("nan")]]))
_arm("a floor at NaN", NO, scene={"floor": float("nan"), "obstacles": [POST]})
_arm("a margin below zero", TRUTH, options={"margin_m": -0.05, "time_limit_s": 10.0})
_arm("a speed that is NaN", NO, options={"velocity_scale": float("nan")})
_arm("a goal at NaN", NO, goal={"joints": {**GOAL, "yaw": float("nan")}})
_arm("a goal beyond the limits", NO, goal={"joints": {**GOAL, "yaw": 3.5}})
_arm("a start beyond the limits", NO, start={"joints": {**START, "yaw": -3.5}})

# Geometry.
_obstacles("a plate of a tenth of a millimetre across the way", TRUTH, _box("plate", [1.2, 1e-4, 2.0], [0.9, 0.0, 0.8]))
_obstacles("plates of a tenth of a millimetre, turned a little", TRUTH,
    *(_box(f"plate{k}", [0.5, 1e-4, 0.9], [0.8, 0.1 * k, 0.5], quaternion_wxyz=[0.99, 0.0, 0.0, 0.141])
      for k in range(-3, 4)))  # fmt: skip
_obstacles("needles", TRUTH, *(_box(f"needle{k}", [1e-3, 1e-3, 0.95], [0.5 + 0.03 * k, 0.02 * k, 0.475]) for k in range(9)))
_obstacles("a speck in the way", TRUTH, _box("speck", [1e-3, 1e-3, 1e-3], [0.62, 0.0, 0.82]))
_obstacles("a box around the whole arm", NO, _box("block", [3.0, 3.0, 3.0], [0.0, 0.0, 0.5]))
_obstacles("a hollow box around the arm, its wall in the way", TRUTH,
    _box("left", [3.0, 0.01, 3.0], [0.0, 1.0, 1.0]), _box("right", [3.0, 0.01, 3.0], [0.0, -1.0, 1.0]),
    _box("front", [0.01, 2.0, 3.0], [0.6, 0.0, 1.0]))  # fmt: skip
_obstacles("a post at the goal", NO, _box("post", [0.08, 0.08, 1.2], [0.42, 0.53, 0.6]))
_obstacles("a lid on the arm at the start", NO, _box("lid", [0.3, 0.3, 0.1], [0.35, -0.44, 0.82]))
_obstacles("a wall of ten kilometres", TRUTH, _box("wall", [0.1, 1e4, 1e4], [1.2, 0.0, 0.0]), POST)
_obstacles("fifty posts in one", TRUTH, *({**POST, "name": f"post{k}"} for k in range(50)))


SHOULDER, REACH_M = np.array([0.0, 0.0, 0.41]), 0.97


def _near(kind: str, radius: float, direction: tuple[float, float, float]) -> Attack:
    """A round thing 0.13 m beyond anything that the arm reaches, which must not stop it."""

    def run(scratch: Path) -> tuple[Answer, str]:
        unit = np.array(direction) / np.linalg.norm(direction)
        place = (SHOULDER + (radius + REACH_M + 0.13) * unit).tolist()
        thing = {"name": "ball", "type": kind, "radius": radius, "position": place}
        if kind != "sphere":
            thing["height"] = 0.5
        request = arm_request(write_arm(scratch), scene={"obstacles": [thing]})
        lie = Lie(request, TRUTH, (), honest_urdf(), scratch, "collision", (("forearm", "hand"),))
        answer, text = answer_of(lie, scratch)
        return (answer, text) if answer in (Answer.TRUE, Answer.CRASHED) else (Answer.ALARM, text)

    return Attack("harmless", f"a {kind} of {radius:g} m out of reach towards {direction}", run)


DIRECTIONS = ((1.0, 0.0, 0.0), (1.0, 0.3, 0.2), (0.6, 0.6, 0.3), (0.5, -0.6, 0.6), (0.3, 0.4, 0.85))
ATTACKS += [_near("sphere", 10.0, direction) for direction in DIRECTIONS]
ATTACKS += [_near("capsule", 10.0, direction) for direction in DIRECTIONS[:2]]
ATTACKS += [_near("cylinder", 10.0, direction) for direction in DIRECTIONS[:2]]


# Floors.
def _reach(**scene: Any) -> Callable[[], dict[str, Any]]:
    def request() -> dict[str, Any]:
        goal = {"joints": {"l_arm_elx": 1.2}}
        return {"robot": {"name": "atlas"}, "scene": scene, "goal": goal, "options": {"time_limit_s": 3.0}}

    return request


for _height in (0.004, 0.009, 0.02, 0.029, -0.004, -0.012, -0.05):
    _atlas(f"floor at {1e3 * _height:g} mm", _reach(floor=_height))
_atlas("no floor under planted feet", _reach(floor=False))
_atlas("a floor under one foot", _reach(floor=False, obstacles=[_box("step", [0.6, 0.3, 0.1], [0.0, 0.16, -0.05])]))
_atlas("a tilted floor", _reach(floor=False, obstacles=[
    _box("ramp", [3.0, 3.0, 0.1], [0.0, 0.0, -0.056], quaternion_wxyz=[0.9998, 0.0, 0.02, 0.0])]))  # fmt: skip
_atlas("a floor with a hole under the feet", _reach(floor=False, obstacles=[
    _box("front", [2.0, 4.0, 0.1], [1.3, 0.0, -0.05]), _box("back", [2.0, 4.0, 0.1], [-1.3, 0.0, -0.05])]))  # fmt: skip
_atlas("a floor under the toes alone", _reach(floor=False, obstacles=[_box("edge", [2.0, 2.0, 0.1], [1.1, 0.0, -0.05])]))
_atlas("a step called floor, 9 mm into the soles", _reach(floor=False, obstacles=[
    _box("floor", [1.0, 1.0, 0.1], [0.0, 0.0, -0.041])]))  # fmt: skip
_atlas("a step called floor, 8 mm into one sole", _reach(floor=True, obstacles=[
    _box("floor", [0.3, 0.2, 0.05], [0.04, 0.14, -0.017])]))  # fmt: skip
_atlas("a floor called like a foot", _reach(floor=False, obstacles=[_box("l_foot", [2.0, 2.0, 0.1], [0.0, 0.0, -0.062])]))


# Valves.
def _valve(obstacles: tuple[Box, ...] = (), **valve: Any) -> Callable[[], dict[str, Any]]:
    def request() -> dict[str, Any]:
        asked = bases.request_of("valve", Path("."))
        asked["task"] = {"valve": {**bases.VALVE, **valve}}
        asked["scene"] = {"floor": True, "obstacles": list(obstacles)}
        asked["options"] = {"time_limit_s": 6.0}
        return asked

    return request


SHIFT = np.array([0.0, 0.0, 0.0])


def _rods(prefix: str, turn_deg: float) -> tuple[Box, ...]:
    """Rods fixed in the world across the circle that the hook must follow, wherever it is put in."""
    centre, radius = np.array(bases.VALVE["centre"]), bases.VALVE["radius"]
    angles = np.deg2rad(np.arange(0.0, 360.0, 0.9 * turn_deg))
    places = [centre + radius * np.array([0.0, np.cos(a), np.sin(a)]) for a in angles]
    return tuple(_box(f"{prefix}{k}", [0.02, 0.012, 0.012], (place + SHIFT).tolist()) for k, place in enumerate(places))


for _prefix in ("rod", "valve/rim/x", "valve/rim/", "valve/rim", "valve", "l_hook", "floor"):
    _atlas(f"rods across the circle called {_prefix!r}", _valve(_rods(_prefix, 60.0)))
_atlas("a wall called like the rim, in the hand's way", _valve((_box("valve/rim/0", [0.02, 1.2, 1.2], [0.62, 0.15, 1.15]),)))
_atlas("a valve without axis", _valve(axis=[0.0, 0.0, 0.0]))
_atlas("a valve whose axis is NaN", _valve(axis=[float("nan"), 0.0, 0.0]))
_atlas("a valve of no radius", _valve(radius=0.0))
_atlas("a valve of 5 m", _valve(radius=5.0))
_atlas("a valve in millimetres", _valve(centre=[750.0, 150.0, 1150.0], radius=150.0))
_atlas("a valve behind the robot", _valve(centre=[-3.0, 0.15, 1.15]))
_atlas("a valve inside the chest", _valve(centre=[0.0, 0.0, 1.2]))
_atlas("a valve under the floor", _valve(centre=[0.75, 0.15, -0.6]))
_atlas("a valve in a wall", _valve((_box("wall", [0.4, 2.0, 2.0], [0.8, 0.0, 1.0]),)))


# Programs whose numbers are none.
NAN, FAR = float("nan"), 1e308


def _program(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], tuple[Answer, str]]:
    def run(scratch: Path) -> tuple[Answer, str]:
        request = bases.request_of("program", scratch)
        change(request["task"]["trajopt"])
        return answer_of(Lie(request, NO), scratch)

    return run


for _what, _change in {
    "NaN in a program's goal": lambda p: p["constraints"][0]["params"]["vals"].__setitem__(0, NAN),
    "NaN in a program's start": lambda p: p["init_info"]["endpoint"].__setitem__(0, NAN),
    "NaN for a program's margin": lambda p: p["costs"][1]["params"].update(dist_pen=[NAN]),
    "NaN for a program's weight": lambda p: p["costs"][0]["params"].update(coeffs=[NAN]),
    "infinity for a program's weight": lambda p: p["costs"][0]["params"].update(coeffs=[float("inf")]),
    "overflow in a program's goal": lambda p: p["constraints"][0]["params"]["vals"].__setitem__(0, FAR),
    "NaN for a program's steps": lambda p: p["basic_info"].update(n_steps=NAN),
    "a million steps": lambda p: p["basic_info"].update(n_steps=1_000_000),
}.items():
    ATTACKS.append(Attack("scenes", _what, _program(_change)))


def _stranger_meets(name: str) -> Callable[[Path], tuple[Answer, str]]:
    """An honest result whose obstacle is called like a link must be replayed, not stumbled over."""

    def run(scratch: Path) -> tuple[Answer, str]:
        request = arm_request(write_arm(scratch), scene={"obstacles": [{**POST, "name": name}]})
        try:
            verdict = bases.write_plan(request, scratch)
        except RequestError as error:
            return Answer.REFUSED, str(error)
        answer, text = judges.ask_stranger(scratch / "result")
        if verdict == judges.CERTIFIED and answer is Answer.BELIEVED:
            return Answer.TRUE, "the stranger confirms the certificate"
        return answer if answer is Answer.CRASHED else Answer.ALARM, text

    return run


ATTACKS += [Attack("stranger", f"an obstacle called {n!r}", _stranger_meets(n), False) for n in ("hand", "base", "post")]
