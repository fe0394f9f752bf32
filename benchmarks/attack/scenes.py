"""False scenes and names: obstacles named like parts of the robot, missing floors, millimetres."""

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
from benchmarks.attack.scenes_standing import STANDING, box
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
    "a load of 1000 kg",
    "a load as long as the room",
    "a wall called like the rim, in the hand's way",
    *(
        f"rods across the circle called '{name}'"
        for name in ("rod", "valve", "valve/rim", "valve/rim/", "l_hook", "floor")
    ),
)
Box = dict[str, Any]


def attacks() -> list[Attack]:
    """Return one attack for each scene."""
    return [replace(attack, is_short=attack.is_short and attack.name not in SLOW) for attack in ATTACKS + STANDING]


def _arm(name: str, expected: Expected, *words: str, **more: Any) -> None:
    """Register a scene around the arm; ``more`` replaces parts of its request."""

    def run(scratch: Path) -> tuple[Answer, str]:
        request = arm_request(write_arm(scratch), **more)
        apart = (("forearm", "hand"),)
        return answer_of(Lie(request, expected, words, honest_urdf(), scratch, "collision", apart), scratch)

    ATTACKS.append(Attack("scenes", name, run))


def _obstacles(name: str, expected: Expected, *obstacles: Box, words: tuple[str, ...] = ()) -> None:
    _arm(name, expected, *words, scene={"obstacles": list(obstacles)})


def _convex(points: list[list[float]]) -> Box:
    return {"name": "stone", "type": "convex", "points": points, "position": [0.0, 0.0, 0.0]}


# Names.
for _name in (
    "hand",
    "forearm",
    "base",
    "universe",
    "floor",
    "post*",
    "*",
    "hand/0",
    "",
    "a\nb",
    "../post",
    "x" * 5000,
):
    _obstacles(f"post called {_name[:12]!r}", TRUTH, {**POST, "name": _name}, SHELF)
_obstacles("two obstacles of one name", TRUTH, POST, {**SHELF, "name": "post"})
_obstacles("two obstacles of one name, the second far away", TRUTH, POST, {**POST, "position": [9.0, 9.0, 0.45]})

# Units and numbers.
MM = (r"mm|millimetres?|units?",)
_obstacles("a table in millimetres", NAMED, box("table", [600, 900, 40], [750, 0, 800]), words=MM)
_obstacles("a post in millimetres", NAMED, box("post", [80, 80, 900], [620, 0, 450]), words=MM)
_obstacles("a post in millimetres at metres", NAMED, box("post", [80, 80, 900], [60.2, 0, 0.45]), words=MM)
_obstacles("a ball in millimetres", NAMED, {"name": "ball", "type": "sphere", "radius": 150, "position": [620, 0, 450]},
    words=MM)  # fmt: skip
_obstacles("a pipe in millimetres", NAMED, {"name": "pipe", "type": "cylinder", "radius": 40, "height": 900,
    "position": [620, 0, 450]}, words=MM)  # fmt: skip
_obstacles("a stone in millimetres", NAMED, _convex([[600, 0, 0], [640, 0, 0], [620, 40, 0], [620, 0, 900]]), words=MM)
_obstacles("a box of no size", NO, box("post", [0.08, 0.0, 0.9], [0.62, 0, 0.45]))
_obstacles("a box of negative size", NO, box("post", [0.08, -0.08, 0.9], [0.62, 0, 0.45]))
_obstacles("a box at NaN", NO, box("post", [0.08, 0.08, 0.9], [float("nan"), 0, 0.45]))
_obstacles("a box at infinity", NO, box("post", [0.08, 0.08, 0.9], [float("inf"), 0, 0.45]))
_obstacles("a box at a billion metres", NO, box("post", [0.08, 0.08, 0.9], [1e9, 0, 0.45]))
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
_obstacles("a plate of a tenth of a millimetre across the way", TRUTH, box("plate", [1.2, 1e-4, 2.0], [0.9, 0.0, 0.8]))
_obstacles("plates of a tenth of a millimetre, turned a little", TRUTH,
    *(box(f"plate{k}", [0.5, 1e-4, 0.9], [0.8, 0.1 * k, 0.5], quaternion_wxyz=[0.99, 0.0, 0.0, 0.141])
      for k in range(-3, 4)))  # fmt: skip
_obstacles(
    "needles", TRUTH, *(box(f"needle{k}", [1e-3, 1e-3, 0.95], [0.5 + 0.03 * k, 0.02 * k, 0.475]) for k in range(9))
)
_obstacles("a speck in the way", TRUTH, box("speck", [1e-3, 1e-3, 1e-3], [0.62, 0.0, 0.82]))
_obstacles("a box around the whole arm", NO, box("block", [3.0, 3.0, 3.0], [0.0, 0.0, 0.5]))
_obstacles("a hollow box around the arm, its wall in the way", TRUTH,
    box("left", [3.0, 0.01, 3.0], [0.0, 1.0, 1.0]), box("right", [3.0, 0.01, 3.0], [0.0, -1.0, 1.0]),
    box("front", [0.01, 2.0, 3.0], [0.6, 0.0, 1.0]))  # fmt: skip
_obstacles("a post at the goal", NO, box("post", [0.08, 0.08, 1.2], [0.42, 0.53, 0.6]))
_obstacles("a lid on the arm at the start", NO, box("lid", [0.3, 0.3, 0.1], [0.35, -0.44, 0.82]))
_obstacles("a wall of ten kilometres", TRUTH, box("wall", [0.1, 1e4, 1e4], [1.2, 0.0, 0.0]), POST)
_obstacles("fifty posts in one", TRUTH, *({**POST, "name": f"post{k}"} for k in range(50)))


SHOULDER, REACH_M = np.array([0.0, 0.0, 0.41]), 0.97


def _near(kind: str, radius: float, direction: tuple[float, float, float]) -> Attack:
    """Return a sphere or cylinder 0.13 m beyond the reach of the arm, which must not prevent the plan."""

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

    name = f"a {kind} of {radius:g} m out of reach towards {direction}"
    return Attack("harmless", name, run, direction in (DIRECTIONS[0], DIRECTIONS[-1]))


DIRECTIONS = ((1.0, 0.0, 0.0), (1.0, 0.3, 0.2), (0.6, 0.6, 0.3), (0.5, -0.6, 0.6), (0.3, 0.4, 0.85))
ATTACKS += [_near("sphere", 10.0, direction) for direction in DIRECTIONS]
ATTACKS += [_near("capsule", 10.0, direction) for direction in DIRECTIONS[:2]]
ATTACKS += [_near("cylinder", 10.0, direction) for direction in DIRECTIONS[:2]]


# Loads.
def _load(mass: float, size: tuple[float, float, float] = (0.04, 0.04, 0.04), **more: Any) -> Box:
    load = {"name": "load", "link": "hand", "type": "box", "size": list(size), "position": [0.0, 0.0, 0.2]}
    return {**load, "mass_kg": mass, **more}


for _mass in (40.0, 1000.0, -5.0, float("nan")):
    _arm(f"a load of {_mass:g} kg", NO, attached=[_load(_mass)], options={"time_limit_s": 5.0})
_arm("a load in the forearm", NO, attached=[_load(1.0, position=[0.0, 0.0, -0.2])])
_arm("a load that touches everything", NO, attached=[_load(1.0, touches=["base", "forearm", "upper_arm", "turret"])])
_arm("a load called like a link", NO, attached=[_load(1.0, name="base")])
_arm("a load on a link that is not there", NO, attached=[_load(1.0, link="claw")])
_arm("a load as long as the room", NO, attached=[_load(0.1, (0.02, 0.02, 90.0), position=[0.0, 0.0, 45.2])])

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
    """Check that the independent program accepts a correct result with an obstacle named like a link."""

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


ATTACKS += [
    Attack("stranger", f"an obstacle called {n!r}", _stranger_meets(n), False) for n in ("hand", "base", "post")
]
