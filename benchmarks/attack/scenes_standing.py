"""False scenes for a standing robot: missing floors, rods named like the rim of a valve, valves that are not there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack import bases
from benchmarks.attack.outcome import Attack
from benchmarks.attack.requests import Expected, Lie, answer_of

Box = dict[str, Any]
NO = Expected.NO_CERTIFICATE
STANDING: list[Attack] = []


def box(name: str, size: list[float], position: list[float], **more: Any) -> Box:
    """Return an obstacle of a request."""
    return {"name": name, "type": "box", "size": size, "position": position, **more}


def _atlas(name: str, request: Callable[[], dict[str, Any]], expected: Expected = NO, *words: str) -> None:
    """Register a request of the bundled Atlas that may be CERTIFIED only with a note on the false data."""
    run = lambda scratch: answer_of(Lie(request(), expected, words), scratch)  # noqa: E731
    STANDING.append(Attack("scenes", name, run))


# Floors.
def _reach(**scene: Any) -> Callable[[], dict[str, Any]]:
    def request() -> dict[str, Any]:
        goal = {"joints": {"l_arm_elx": 1.2}}
        return {"robot": {"name": "atlas"}, "scene": scene, "goal": goal, "options": {"time_limit_s": 3.0}}

    return request


for _height in (0.004, 0.009, 0.02, 0.029, -0.004, -0.012, -0.05):
    _atlas(f"floor at {1e3 * _height:g} mm", _reach(floor=_height))
_atlas("no floor under planted feet", _reach(floor=False))
_atlas("a floor under one foot", _reach(floor=False, obstacles=[box("step", [0.6, 0.3, 0.1], [0.0, 0.16, -0.05])]))
_atlas("a tilted floor", _reach(floor=False, obstacles=[
    box("ramp", [3.0, 3.0, 0.1], [0.0, 0.0, -0.056], quaternion_wxyz=[0.9998, 0.0, 0.02, 0.0])]))  # fmt: skip
_atlas("a floor with a hole under the feet", _reach(floor=False, obstacles=[
    box("front", [2.0, 4.0, 0.1], [1.3, 0.0, -0.05]), box("back", [2.0, 4.0, 0.1], [-1.3, 0.0, -0.05])]))  # fmt: skip
_atlas("a floor under the toes alone", _reach(floor=False, obstacles=[box("edge", [2.0, 2.0, 0.1], [1.1, 0.0, -0.05])]))
_atlas("a step called floor, 9 mm into the soles", _reach(floor=False, obstacles=[
    box("floor", [1.0, 1.0, 0.1], [0.0, 0.0, -0.041])]))  # fmt: skip
_atlas("a step called floor, 8 mm into one sole", _reach(floor=True, obstacles=[
    box("floor", [0.3, 0.2, 0.05], [0.04, 0.14, -0.017])]))  # fmt: skip
_atlas(
    "a floor called like a foot", _reach(floor=False, obstacles=[box("l_foot", [2.0, 2.0, 0.1], [0.0, 0.0, -0.062])])
)


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
    """Return fixed rods across the circle that the hook follows, for every place of insertion."""
    centre, radius = np.array(bases.VALVE["centre"]), bases.VALVE["radius"]
    angles = np.deg2rad(np.arange(0.0, 360.0, 0.9 * turn_deg))
    places = [centre + radius * np.array([0.0, np.cos(a), np.sin(a)]) for a in angles]
    return tuple(box(f"{prefix}{k}", [0.02, 0.012, 0.012], (place + SHIFT).tolist()) for k, place in enumerate(places))


for _prefix in ("rod", "valve/rim/x", "valve/rim/", "valve/rim", "valve", "l_hook", "floor"):
    _atlas(f"rods across the circle called {_prefix!r}", _valve(_rods(_prefix, 60.0)))
_atlas(
    "a wall called like the rim, in the hand's way",
    _valve((box("valve/rim/0", [0.02, 1.2, 1.2], [0.62, 0.15, 1.15]),)),
)
_atlas("a valve without axis", _valve(axis=[0.0, 0.0, 0.0]))
_atlas("a valve whose axis is NaN", _valve(axis=[float("nan"), 0.0, 0.0]))
_atlas("a valve of no radius", _valve(radius=0.0))
_atlas("a valve of 5 m", _valve(radius=5.0))
_atlas("a valve in millimetres", _valve(centre=[750.0, 150.0, 1150.0], radius=150.0))
_atlas("a valve behind the robot", _valve(centre=[-3.0, 0.15, 1.15]))
_atlas("a valve inside the chest", _valve(centre=[0.0, 0.0, 1.2]))
_atlas("a valve under the floor", _valve(centre=[0.75, 0.15, -0.6]))
_atlas("a valve in a wall", _valve((box("wall", [0.4, 2.0, 2.0], [0.8, 0.0, 1.0]),)))
