"""Requests of the load generators: plans of about 10, 25, 50 and 140 ms of one core, one without end, and robots."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.proto.planner.v1.planner_pb2 import PlanRequest
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import parse_request
from service.wire.requests import request_to_message

ARM, SMALL_ARM = "arm7", "arm2"  # the robots that ``robots`` writes: seven boxes in a row, and two
_STAND = {"robot": {"name": "atlas"}, "start": {"posture": "stand"}}

ELBOW: Mapping[str, Any] = {**_STAND, "goal": {"joints": {"l_arm_elx": 1.2}}}
ARM_TURNS: Mapping[str, Any] = {
    "robot": {"name": ARM},
    "goal": {"joints": {"joint1": 1.5}},
    "scene": {"obstacles": [{"type": "box", "name": "crate", "size": [0.2, 0.2, 0.4], "position": [1.0, 0.9, 0.2]}]},
}
SWING: Mapping[str, Any] = {
    "robot": {"name": SMALL_ARM},
    "goal": {"joints": {"joint1": 1.0}},
    # without any obstacle no pair of an arm of two links is checked, and nothing is certified
    "scene": {"obstacles": [{"type": "box", "name": "crate", "size": [0.2, 0.2, 0.4], "position": [1.0, -0.9, 0.2]}]},
}
OVER_A_TABLE: Mapping[str, Any] = {
    **_STAND,
    "scene": {
        "obstacles": [
            {"name": "table", "type": "box", "size": [0.6, 1.2, 0.04], "position": [0.75, 0.0, 0.80]},
            {"name": "left_box", "type": "box", "size": [0.2, 0.1, 0.25], "position": [0.70, 0.55, 0.945]},
            {"name": "right_box", "type": "box", "size": [0.2, 0.1, 0.25], "position": [0.70, -0.05, 0.945]},
        ]
    },
    "goal": {"poses": [{"link": "l_tool", "position": [0.60, 0.25, 1.05]}]},
}
# A grate that blocks every arm: all starts of the optimiser and the sampling planner fail.
ENDLESS: Mapping[str, Any] = {
    **_STAND,
    "scene": {
        "obstacles": [
            {"type": "box", "name": f"bar{i}", "size": [0.02, 2.0, 0.02], "position": [0.42, 0.0, 0.75 + 0.06 * i]}
            for i in range(16)
        ]
    },
    "goal": {"poses": [{"link": "l_hand", "position": [0.75, 0.25, 1.2]}]},
    "options": {"starts": 64},
}


def motion(asked: Mapping[str, Any]) -> MotionRequest:
    """Return a request as a message."""
    return request_to_message(parse_request(asked))


def plan_request(asked: Mapping[str, Any], request_id: str = "", **more: bool) -> PlanRequest:
    """Return a ``PlanRequest``."""
    return PlanRequest(request=motion(asked), request_id=request_id, **more)


def robots(folder: Path) -> Path:
    """Write a folder for ``--robots`` that contains both arms."""
    for name, n_joints in ((ARM, 7), (SMALL_ARM, 2)):
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / "robot.urdf").write_text(_arm_urdf(name, n_joints), encoding="utf-8")
    return folder


def _arm_urdf(name: str, n_joints: int) -> str:
    parts = ['<link name="base"/>']
    for k in range(1, n_joints + 1):
        axis, at = ("0 0 1" if k % 2 else "0 1 0"), ("0 0 0.4" if k == 1 else "0.25 0 0")
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0.12 0 0"/><mass value="1"/>'
            '<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'
            '<collision><origin xyz="0.125 0 0"/><geometry><box size="0.25 0.08 0.08"/></geometry></collision></link>'
            f'<joint name="joint{k}" type="revolute"><parent link="{"base" if k == 1 else f"link{k - 1}"}"/>'
            f'<child link="link{k}"/><origin xyz="{at}"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="2" effort="50"/></joint>'
        )
    return f'<robot name="{name}">{"".join(parts)}</robot>'
