"""Seeded doors and valves of varied proportions, as requests: what ``benchmarks.tasks.given`` plans."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

THICKNESS_GAP = 0.02  # between leaf and frame [m]
WALL_DEPTH, WALL_WIDTH, WALL_HEIGHT = 0.12, 1.2, 2.4
# opens, handle, whether ajar; each with the hinge on either side
DOORS = (
    ("push", "lever", False),
    ("pull", "lever", False),
    ("push", "push_bar", False),
    ("pull", "pull", False),
    ("push", "lever", True),
    ("pull", "pull", True),
)
MODES = ("hook", "grasp")
N_DOORS, N_VALVES = 24, 12


@dataclass(frozen=True)
class Case:
    """One request.

    Attributes:
        name: of the case.
        group: of the table's row.
        request: as plain data.
    """

    name: str
    group: str
    request: dict[str, Any]


def make_doors(count: int, seed: int, open_deg: float) -> Iterator[Case]:
    """Yield doors that are given by leaf and handle, with walls beside the leaf and a lintel; the robot faces them."""
    rng = np.random.default_rng(seed)
    kinds = cycle([(*door, side) for side in ("right", "left") for door in DOORS])
    for number in range(count):
        opens, handle, is_ajar, side = next(kinds)
        case = _make_door(rng, opens, handle, is_ajar, side, open_deg)
        name = f"door {number}: {opens} {handle} {side}{' ajar' if is_ajar else ''}"
        yield Case(name, f"{opens} {handle}{' ajar' if is_ajar else ''}", case)


def _make_door(
    rng: np.random.Generator, opens: str, handle: str, is_ajar: bool, side: str, open_deg: float
) -> dict[str, Any]:
    """Return the request of a door whose shut leaf is at x = ``distance`` before the turn about the robot."""
    s = 1.0 if side == "right" else -1.0
    width, height, thickness = rng.uniform(0.76, 1.0), rng.uniform(1.95, 2.1), rng.uniform(0.035, 0.05)
    x, y, turn = rng.uniform(0.7, 0.95), rng.uniform(-0.25, 0.25), np.deg2rad(rng.uniform(-20.0, 20.0))
    z, inset, stands_out = rng.uniform(0.95, 1.1), rng.uniform(0.06, 0.09), rng.uniform(0.05, 0.065)
    face = x - (thickness if opens == "push" else 0.0)
    edge = y + s * 0.5 * width
    centre = [face - stands_out, edge - s * inset, z]
    if handle == "pull":
        centre[1] = edge - s * (inset + 0.02)
    if handle == "push_bar":
        centre = [face - stands_out - 0.02, y, z]
    rotation = Rotation.from_euler("Z", turn)
    w, qx, qy, qz = rotation.as_quat(scalar_first=True).tolist()

    def place(point: list[float]) -> list[float]:
        return [round(float(value), 4) for value in rotation.apply(point)]

    def box(name: str, size: list[float], position: list[float]) -> dict[str, Any]:
        pose = {"position": place(position), "quaternion_wxyz": [w, qx, qy, qz]}
        return {"name": name, "type": "box", "size": [float(value) for value in size], **pose}

    wall_x = x + (0.5 if opens == "pull" else -0.5) * WALL_DEPTH
    off = 0.5 * width + THICKNESS_GAP + 0.5 * WALL_WIDTH
    obstacles = [
        box("left wall", [WALL_DEPTH, WALL_WIDTH, WALL_HEIGHT], [wall_x, y + off, 0.5 * WALL_HEIGHT]),
        box("right wall", [WALL_DEPTH, WALL_WIDTH, WALL_HEIGHT], [wall_x, y - off, 0.5 * WALL_HEIGHT]),
        box("lintel", [WALL_DEPTH, width, 0.2], [wall_x, y, height + 0.03 + 0.1]),
    ]
    leaf = {
        "hinge": place([x, y - s * 0.5 * width, 0.01]),
        "edge": place([x, edge, 0.01]),
        "height_m": float(height),
        "thickness_m": float(thickness),
        "ajar_deg": float(rng.uniform(8.0, 15.0)) if is_ajar else 0.0,
    }
    length = {"lever": rng.uniform(0.11, 0.14), "pull": rng.uniform(0.25, 0.4), "push_bar": rng.uniform(0.5, 0.7)}
    door = {
        "open_deg": open_deg,
        "opens": opens,
        "leaf": leaf,
        "handle": {"kind": handle, "centre": place(centre), "length_m": float(length[handle])},
    }
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {"obstacles": obstacles},
        "task": {"door": door},
    }


def make_valves(count: int, seed: int) -> Iterator[Case]:
    """Yield valves given by rim and, for a hook, spokes: radii from 0.1 to 0.25 m, axes tilted up to 30 deg."""
    rng = np.random.default_rng(seed + 1)
    for number, mode in zip(range(count), cycle(MODES), strict=False):
        radius = 0.1 + 0.15 * (number // 2) / max(count // 2 - 1, 1)
        tilt, yaw = np.deg2rad(rng.uniform(-30.0, 30.0, 2))
        axis = [-np.cos(tilt) * np.cos(yaw), -np.cos(tilt) * np.sin(yaw), np.sin(tilt)]
        centre = [rng.uniform(0.6, 0.9), rng.uniform(-0.4, 0.4), rng.uniform(0.9, 1.3)]
        valve = {
            "mode": mode,
            "turn_deg": 360.0,
            "centre": [round(float(value), 4) for value in centre],
            "axis": [float(value) for value in axis],
            "radius": round(float(radius), 3),
            **({"spokes_deg": [30.0, 150.0, 270.0]} if mode == "hook" else {}),
        }
        robot = {"name": "atlas", "hand": "hook" if mode == "hook" else "gripper"}
        request = {"robot": robot, "start": {"posture": "reach_ready"}, "task": {"valve": valve}}
        yield Case(f"valve {number}: {mode} radius {radius:.2f} tilt {np.rad2deg(tilt):.0f}", f"valve {mode}", request)
