"""Requests for doors given by their leaf and handle, in front of Atlas."""

from __future__ import annotations

from typing import Any

THICKNESS = 0.045


def door_request(
    opens: str = "push",
    kind: str = "lever",
    x: float = 0.7,
    open_deg: float = 30.0,
    obstacles: tuple[dict[str, Any], ...] = (),
    **more: Any,
) -> dict[str, Any]:
    """A door 0.9 m wide, hinged on the robot's right, with walls beside it that begin 4 cm from the leaf."""
    face = x - (THICKNESS if opens == "push" else 0.0)
    across = {"lever": 0.38, "pull": 0.36, "push_bar": 0.0}[kind]
    out = 0.075 if kind == "push_bar" else 0.055
    wall_x = x + 0.06 if opens == "pull" else x - 0.06
    walls = [
        {"name": name, "type": "box", "size": [0.12, 1.2, 2.4], "position": [wall_x, y, 1.2]}
        for name, y in (("left wall", 1.09), ("right wall", -1.09))
    ]
    task = {
        "open_deg": open_deg,
        "opens": opens,
        "leaf": {"hinge": [x, -0.45, 0.01], "edge": [x, 0.45, 0.01]},
        "handle": {"kind": kind, "centre": [face - out, across, 1.02]},
        **more,
    }
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "scene": {"obstacles": [*walls, *obstacles]},
        "task": {"door": task},
        "options": {},
    }
