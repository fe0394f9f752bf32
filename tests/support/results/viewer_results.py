"""A result to draw: a little biped of boxes walks its hand to a valve and turns it."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from service.viewer import LinkPlacements
from service.viewer.placements import align_signs

LINKS = ("pelvis", "torso", "l_hand", "r_hand", "l_foot", "r_foot")
SIZES = {
    "pelvis": (0.2, 0.3, 0.2),
    "torso": (0.25, 0.4, 0.5),
    "l_hand": (0.12, 0.12, 0.12),
    "r_hand": (0.12, 0.12, 0.12),
    "l_foot": (0.26, 0.12, 0.08),
    "r_foot": (0.26, 0.12, 0.08),
}
PLACES = {
    "pelvis": (0.0, 0.0, 0.9),
    "torso": (0.0, 0.0, 1.3),
    "l_hand": (0.3, 0.3, 1.0),
    "r_hand": (0.3, -0.3, 1.0),
    "l_foot": (0.0, 0.11, 0.04),
    "r_foot": (0.0, -0.11, 0.04),
}
VALVE = np.array([0.55, 0.3, 1.0])
TURN = 2.0
"""What the valve turns [rad]."""

HINGE, SLIDE = np.array([0.75, -0.45, 0.0]), np.array([0.65, 0.1, 1.0])
"""Origins of the joints of ``door``."""


def box(centre: Any, size: Any) -> list[list[float]]:
    """Corners of an axis-aligned box."""
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, 8).T
    return (np.asarray(centre, dtype=float) + signs * np.asarray(size, dtype=float)).tolist()


def placements(n_samples: int) -> LinkPlacements:
    """The left hand moves 0.25 m forward and circles, the torso yaws by 0.4 rad; all else stands."""
    u = np.linspace(0.0, 1.0, n_samples)
    poses = np.zeros((n_samples, len(LINKS), 7))
    poses[..., 3] = 1.0
    for column, link in enumerate(LINKS):
        poses[:, column, :3] = PLACES[link]
    hand = LINKS.index("l_hand")
    poses[:, hand, 0] += 0.25 * np.minimum(2.0 * u, 1.0)
    angle = TURN * np.maximum(2.0 * u - 1.0, 0.0)
    poses[:, hand, 1] += 0.15 * np.sin(angle)
    poses[:, hand, 2] += 0.15 * np.cos(angle)
    torso = LINKS.index("torso")
    poses[:, torso, 3], poses[:, torso, 6] = np.cos(0.2 * u), np.sin(0.2 * u)
    return LinkPlacements(LINKS, align_signs(poses))


def _may_touch(rim: str) -> dict[str, Any]:
    """An allowance for the left hand and a body of the wheel."""
    hand = {"owner": "robot", "link": "l_hand", "body": None}
    return {"first": hand, "second": {"owner": "mechanism", "link": "valve", "body": rim}, "depth": 0.004}


def make_result(
    n_samples: int = 61, duration: float = 6.0, verdict: str = "CERTIFIED"
) -> tuple[dict[str, Any], LinkPlacements]:
    """A result as ``json.loads`` would give it, and its placements."""
    u = np.linspace(0.0, 1.0, n_samples)
    times = duration * u
    half, last = n_samples // 2, n_samples - 1
    com = np.column_stack([0.02 * u, 0.01 * np.sin(6.0 * u), np.full(n_samples, 0.95)])
    polygon = [[-0.13, -0.17], [0.13, -0.17], [0.13, 0.17], [-0.13, 0.17]]
    return {
        "format": "scopt-result/1",
        "request": {"robot": "boxer", "task": {"valve": {"turn_deg": 115}}},
        "verdict": verdict,
        "explanation": [] if verdict == "CERTIFIED" else ["l_hand enters 'crate' by 12 mm"],
        "notes": ["start: snapped by 4e-4 rad"],
        "planning_time_s": 1.5,
        "timings": {"turn": 0.9},
        "min_clearance_m": 0.024,
        "min_clearance_pair": ["crate", "l_hand"],
        "min_balance_margin_m": 0.03,
        "robot": {"name": "boxer", "root": "floating"},
        "bodies": [{"name": link, "link": link, "vertices": box((0, 0, 0), SIZES[link])} for link in LINKS],
        "pieces": [
            {"name": "floor", "kind": "floor", "vertices": box((0.3, 0, -0.05), (3, 3, 0.1))},
            {"name": "crate", "kind": "obstacle", "vertices": box((0.4, -0.7, 0.3), (0.4, 0.4, 0.6))},
            {"name": "wall", "kind": "wall", "vertices": box((0.9, 0, 1.0), (0.1, 2.0, 2.0))},
        ],
        "movables": [_valve(TURN * np.maximum(2.0 * u - 1.0, 0.0))],
        "trajectory": {
            "joint_names": ["base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz", "arm"],
            "positions": [[0.0, 0.0, 0.9, 1.0, 0.0, 0.0, 0.0, float(value)] for value in u],
            "times": times.tolist(),
        },
        "waypoints": np.unique(np.linspace(0, last, 7).astype(int)).tolist(),
        "phases": [
            {
                "name": "reach",
                "first": 0,
                "last": half,
                "contacts": _contacts(),
                "allowances": [],
                "targets": [_pose()],
            },
            {
                "name": "turn",
                "first": half,
                "last": last,
                "contacts": _contacts(),
                "allowances": [_may_touch(f"rim/{k}") for k in range(2)],
                "targets": [_circle()],
            },
        ],
        "support_polygons": [{"first": 0, "last": last, "polygon": polygon, "margin_m": 0.02}],
        "com": com.tolist(),
        "zmp": com[:, :2].tolist(),
        "checks": _checks(verdict == "CERTIFIED", times),
        "figures": {"turned_deg": 114.6},
        "cloud": np.random.default_rng(3).uniform([0.2, -0.9, 0], [0.9, 0.9, 1], (500, 3)).round(4).tolist(),
    }, placements(n_samples)


def _valve(angles: np.ndarray) -> dict[str, Any]:
    spokes = [box(VALVE + np.array([0, 0, 0.075 * sign]), (0.03, 0.03, 0.15)) for sign in (-1, 1)]
    bodies = [{"name": f"rim/{i}", "kind": "rim", "vertices": spoke} for i, spoke in enumerate(spokes)]
    return {
        "name": "valve",
        "joint": "valve_turn",
        "type": "revolute",
        "origin": VALVE.tolist(),
        "axis": [-1.0, 0.0, 0.0],
        "bodies": bodies,
        "angles": angles.tolist(),
    }


def _contacts() -> list[dict[str, Any]]:
    corners = [(-0.13, -0.06), (0.13, 0.06), (0.13, -0.06), (-0.13, 0.06)]  # in no order round the sole
    return [
        {
            "link": f"{side}_foot",
            "position": [0.0, y, 0.0],
            "quaternion_wxyz": [1, 0, 0, 0],
            "sole": [[a, y + b, 0.0] for a, b in corners],
        }
        for side, y in (("l", 0.11), ("r", -0.11))
    ]


def _pose() -> dict[str, Any]:
    return {"kind": "pose", "frame": "l_hand", "position": [0.55, 0.3, 1.15], "quaternion_wxyz": [1, 0, 0, 0]}


def _circle() -> dict[str, Any]:
    return {
        "kind": "circle",
        "frame": "l_hand",
        "centre": VALVE.tolist(),
        "axis": [-1, 0, 0],
        "radius": 0.15,
        "tolerance_m": 0.005,
        "axis_tolerance_deg": 3.0,
    }


def _checks(is_certified: bool, times: np.ndarray) -> list[dict[str, Any]]:
    late = float(times[2 * len(times) // 3])
    return [
        {
            "name": "joint limits",
            "ok": True,
            "value": 0.1,
            "limit": 0.0,
            "unit": "rad",
            "text": "",
            "where": {"time_s": float(times[3]), "position": None, "names": ["torso"]},
        },
        {
            "name": "clearance",
            "ok": is_certified,
            "value": 0.024 if is_certified else -0.012,
            "limit": 0.0,
            "unit": "m",
            "text": "crate and l_hand",
            "where": {"time_s": late, "position": [0.4, -0.5, 0.6], "names": ["crate", "l_hand"]},
        },
        {
            "name": "torque",
            "ok": True,
            "value": None,
            "limit": None,
            "unit": "-",
            "text": "not checked",
            "where": {"time_s": None, "position": None, "names": []},
        },
    ]


def movable(name: str, origin: Any, axis: Any, angles: Any, kind: str = "revolute", parent: str | None = None) -> Any:
    """An entry of ``result["movables"]``."""
    return {
        "name": name, "joint": f"{name}_joint", "type": kind, "parent": parent, "origin": list(origin),
        "axis": list(axis), "lower": -9.0, "upper": 9.0, "start": float(angles[0]),
        "bodies": [{"name": f"{name}/body", "kind": "movable", "vertices": box(origin, (0.04, 0.6, 0.1))}],
        "angles": [float(angle) for angle in angles],
    }  # fmt: skip


def door(n_samples: int) -> list[dict[str, Any]]:
    """A leaf that opens by 1 rad, from 0.2 rad on, and a bar on it that slides by 3 cm."""
    u = np.linspace(0.0, 1.0, n_samples)
    bar = movable("door/bar", SLIDE, (2.0, 0.0, 0.0), 0.03 * u, "prismatic", "door/leaf")
    return [movable("door/leaf", HINGE, (0.0, 0.0, -1.0), 0.2 + u), bar]


def unpack(entry: dict[str, Any]) -> np.ndarray:
    """A packed array of a payload."""
    array = np.frombuffer(base64.b64decode(entry["data"]), dtype=np.dtype(entry["dtype"]).newbyteorder("<"))
    array = array.reshape(entry["shape"])
    if "lower" not in entry:
        return array
    lower, upper = np.array(entry["lower"]), np.array(entry["upper"])
    return lower + array / 65535.0 * (upper - lower)
