"""Requests that list steps: motions of hands and body, a peg between two holes, paths, presses, touches and a walk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.attack.gantry_files import pick_place_request

FROM, INTO, WIDTH, CLEARANCE, DEPTH, TOP = (0.1, -0.2), (-0.1, 0.2), 0.04, 0.002, 0.06, 0.4
UP = DEPTH + 0.03
WALL = {"name": "wall", "type": "box", "size": [0.1, 2.0, 2.4], "position": [0.85, 0.0, 1.2]}
FACE = {"point": [0.8, 0.0, 1.2], "normal": [-1.0, 0.0, 0.0], "pieces": ["wall"]}
MOVES = [
    {"name": "line",
     "move": {"hand": "right", "by": {"translation": [0.05, 0, 0.1]}, "along": "line", "speed_m_s": 0.1}},
    {"name": "turn", "screw": {"hand": "right", "axis": [0, 0, 1], "axes": "hand", "rotation_deg": 40}},
    {"name": "body", "body": {"pelvis_m": [0.0, 0.0, -0.04], "torso_rpy_deg": [0, 0, 8]}},
    {"name": "joints", "move": {"joints": {"r_arm_elx": -1.2, "r_arm_ely": 1.8}, "along": "joint_quintic",
                                "hand": "right", "other_hand": "lock"}},
    {"name": "both", "move": {"hand": "both", "by": {"translation": [0, 0, 0.04]}, "along": "line", "duration_s": 2.5}},
]  # fmt: skip
CIRCLE = {"centre": [0.7, -0.2, 1.1], "radius_m": 0.1, "angle_deg": 200.0}
PATHS = [
    {"name": "cut", "follow": {"hand": "right", "face": FACE, "circle": CIRCLE, "thrust_n": 15.0}},
    {"name": "line", "follow": {"hand": "right", "face": FACE, "polyline": [[0.8, -0.3, 1.1], [0.8, -0.3, 1.2]],
                                "tilt_deg": 10.0, "turn": "keep", "depth_m": -0.01}},
]  # fmt: skip
PRESS = {"normal": [-1, 0, 0], "force_n": 15, "travel_m": 0.008, "height_m": 0.02}
PRESSES = [{"press": {"at": [0.74, -0.25, z], **PRESS}} for z in (1.4, 1.2)]
TOUCHES = [
    {"name": "feel",
     "touch": {"hand": "right", "direction": [0, 0, 1], "window_m": [0.02, 0.06], "force_n": 10.0}},
]  # fmt: skip
RISE = {"hand": "right", "by": {"translation": [0.0, 0.0, 0.04]}, "along": "line"}
WALK = [
    {"name": "push", "press": {"at": [0.74, -0.25, 1.2], **PRESS}},
    {"name": "walk", "walk": {"to": [0.2, 0.0]}},
    {"name": "up again", "move": RISE},
]


def steps_request(name: str) -> dict[str, Any]:
    """Return the request of Atlas for ``moves``, ``paths``, ``presses``, ``touches`` or ``walk``."""
    obstacles = [WALL] if name == "paths" else []
    steps = {"moves": MOVES, "paths": PATHS, "presses": PRESSES, "touches": TOUCHES, "walk": WALK}[name]
    posture = "stand" if name in ("moves", "paths") else "reach_ready"
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": posture},
        "scene": {"floor": True, "obstacles": obstacles},
        "task": {"steps": steps},
    }


def make_hole(name: str, at: tuple[float, float]) -> list[dict[str, Any]]:
    """Return four walls about a hole on the table."""
    width, rim = WIDTH + CLEARANCE, 0.04
    off = 0.5 * (width + rim)
    walls = {
        "left": ([off, 0.0], [rim, width + 2 * rim]),
        "right": ([-off, 0.0], [rim, width + 2 * rim]),
        "far": ([0.0, off], [width, rim]),
        "near": ([0.0, -off], [width, rim]),
    }
    return [
        {
            "type": "box",
            "name": f"{name} {side}",
            "size": [*size, DEPTH],
            "position": [at[0] + shift[0], at[1] + shift[1], TOP + 0.5 * DEPTH],
        }
        for side, (shift, size) in walls.items()
    ]


def peg_request(urdf: Path, **changes: Any) -> dict[str, Any]:
    """Return a request that takes a peg out of a hole into another; ``changes`` are fields of steps by name."""
    holes = [*make_hole("from", FROM), *make_hole("into", INTO)]
    peg = {"name": "peg", "size": [WIDTH, WIDTH, 0.14], "position": [*FROM, TOP + 0.07], "mass_kg": 0.4}
    request = pick_place_request(urdf, block=peg, obstacles=holes, object="peg")
    fit = {"object": "peg", "clearance_m": CLEARANCE, "chamfer_m": 0.001, "depth_m": UP, "force_n": 12.0}
    over = {"link": "peg", "position": [*INTO, TOP + 0.07 + UP], "quaternion_wxyz": [1, 0, 0, 0]}
    names = ("left", "right", "far", "near")
    steps: list[dict[str, Any]] = [
        {"name": "take", "grasp": {"object": "peg", "force_n": 40.0}},
        {"name": "out", "withdraw": {**fit, "axis": [0, 0, 1], "pieces": [f"from {side}" for side in names]}},
        {"name": "across", "move": {"poses": [over]}},
        {
            "name": "in",
            "insert": {**fit, "axis": [0, 0, -1], "at": [*INTO, TOP], "pieces": [f"into {side}" for side in names]},
        },
        {"name": "let go", "release": {"object": "peg"}},
    ]
    for step in steps:
        kind = next(key for key in step if key != "name")
        step[kind] |= changes.get(step["name"].replace(" ", "_"), {})
    request["task"] = {"steps": steps}
    return request
