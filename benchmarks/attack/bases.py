"""Correct result folders that attacks start from: planned once, checked, and copied for every edit."""

from __future__ import annotations

import atexit
import copy
import json
import shutil
import tempfile
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import yaml

from benchmarks.attack import judges
from benchmarks.attack.arm_files import GOAL, START, arm_request, write_arm
from benchmarks.attack.gantry_files import pick_place_request, write_gantry
from benchmarks.attack.outcome import Answer
from benchmarks.attack.rare_bases import RARE
from benchmarks.attack.step_requests import peg_request, steps_request
from scopt import EffortClock
from service import parse_request, plan, write_result
from service.replay.rest import make_rest_request
from service.request.file import to_json
from service.result import output
from service.result.folder import GLB_NAME, OPENRAVE_NAME, VIEWER_NAME

ROOT = Path(__file__).resolve().parents[2]
TABLE = {"name": "table", "type": "box", "size": [0.6, 1.2, 0.04], "position": [0.75, 0.0, 0.80]}
LEFT_BOX = {"name": "left_box", "type": "box", "size": [0.2, 0.1, 0.25], "position": [0.70, 0.55, 0.945]}
RIGHT_BOX = {"name": "right_box", "type": "box", "size": [0.2, 0.1, 0.25], "position": [0.70, -0.05, 0.945]}
VIEWS = (VIEWER_NAME, GLB_NAME, OPENRAVE_NAME)
# Of which attacks edit, swap or sign drawings.  Of the others each verification would draw them again, which takes as
# long as the proof of a humanoid's plan.
DRAWN = ("arm", "untimed", "missed")
WALL = {"name": "wall", "type": "box", "size": [0.1, 2.0, 2.0], "position": [1.1, 0.0, 1.0]}
VALVE = {
    "mode": "hook",
    "hand": "left",
    "turn_deg": 60.0,
    "centre": [0.75, 0.15, 1.15],
    "axis": [-1.0, 0.0, 0.0],
    "radius": 0.15,
    "spokes_deg": [0.0, 90.0, 180.0, 270.0],
}


LEVER = {
    "hand": "left",
    "turn_deg": 90.0,
    "centre": [0.72, 0.2, 1.12],
    "axis": [-1.0, 0.0, 0.0],
    "lever": {"direction": [0.0, 0.0, 1.0], "length_m": 0.22},
}


def request_of(name: str, folder: Path) -> dict[str, Any]:
    """Return the request of a base as new plain data; write the files it names to ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    return copy.deepcopy(_request(name, folder))


def _request(name: str, folder: Path) -> dict[str, Any]:
    match name:
        case "arm":
            return arm_request(write_arm(folder))
        case "untimed":
            return arm_request(write_arm(folder), options={"time_limit_s": 20.0, "timed": False})
        case "paced":
            options = {
                "time_limit_s": 20.0,
                "pace": "normal",
                "jerk_scale": 0.5,
                "tool_speed_m_s": 0.3,
                "sway_m": 0.01,
                "sway_deg": 1.0,
            }
            return arm_request(write_arm(folder), options=options)
        case "moving":
            arm = arm_request(write_arm(folder))
            arm["start"]["rates"], arm["goal"]["rates"] = {"shoulder": 0.4}, {"elbow": -0.3}
            return arm
        case "program":
            return arm_request(write_arm(folder), goal=None, task={"trajopt": _program()})
        case "reach":
            pose = {"link": "l_tool", "position": [0.60, 0.25, 1.05], "position_tolerance_m": 0.005}
            obstacles = [TABLE, LEFT_BOX, RIGHT_BOX]
            return _atlas("stand", obstacles, goal={"poses": [pose]})
        case "valve":
            return _atlas("reach_ready", [WALL], task={"valve": VALVE})
        case "lever":
            return _atlas("reach_ready", [WALL], task={"valve": LEVER})
        case "gripper":
            rim = {key: VALVE[key] for key in ("hand", "turn_deg", "centre", "axis", "radius")}
            request = _atlas("reach_ready", [WALL], task={"valve": {"mode": "grasp", **rim}})
            return {**request, "robot": {"name": "atlas", "hand": "gripper"}}
        case "door" | "drawer" | "carry" | "chair" | "stair":
            return _example(name)
        case "steps":
            steps = _example(name)
            del steps["task"]["contacts"]["stances"][2:]
            return steps
        case "rail":  # one stance, on which no phase stands
            stair = _example("stair")
            del stair["task"]["contacts"]["stances"][1:], stair["task"]["contacts"]["finish"]
            return stair
        case "egress":  # as far as the first foot; the whole way out takes a minute
            egress = _example(name)
            egress["task"]["egress"]["until"] = "right foot out"
            return egress
        case "resume":  # the drawer, once the rod is behind its bar
            return _rest("drawer", "move slide")
        case "compliant":  # the motion of the drawer, kept for one that is 4 mm farther
            rest = _rest("drawer", "reach", is_compliant=True)
            rest["task"]["mechanism"]["position"][0] += 0.004
            return rest
        case "scan":
            shutil.copyfile(ROOT / "examples" / "data" / "valve_scan.pcd", folder / "scan.pcd")
            valve = {"mode": "hook", "turn_deg": 60.0}
            return {
                "robot": {"name": "atlas"},
                "start": {"posture": "reach_ready"},
                "scene": {"cloud": str(folder / "scan.pcd")},
                "task": {"valve": valve},
            }
        case "carried":
            return pick_place_request(write_gantry(folder))
        case "peg":
            return peg_request(write_gantry(folder))
        case "moves" | "paths" | "presses" | "touches" | "walk":
            return steps_request(name)
        case _ if name in RARE:
            return RARE[name](folder)
        case "missed":
            pose = {"link": "l_tool", "position": [0.50, 0.20, 2.40], "position_tolerance_m": 0.001}
            return _atlas("stand", [], goal={"poses": [pose]}, options={"starts": 1, "time_limit_s": 4.0})
    raise ValueError(f"no base is called {name!r}")


@cache
def original(name: str) -> Path:
    """Folder with ``result`` (as ``scopt plan`` writes it), ``request.yaml`` and ``files`` of a base.

    Raises:
        RuntimeError: the unedited base is not certified.
    """
    folder = _scratch() / name
    request = request_of(name, folder / "files")
    write_plan(request, folder, is_drawn=name in DRAWN)
    if name != "missed":
        answer, text = judges.verify(folder / "result")
        if answer is not Answer.BELIEVED:
            raise RuntimeError(f"the honest result '{name}' is not certified: {text}")
    return folder


def write_plan(request: dict[str, Any], folder: Path, *, is_drawn: bool = True) -> str:
    """Plan a request, write ``result`` and ``request.yaml`` to ``folder``, and return the verdict."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "request.yaml").write_text(json.dumps(request), encoding="utf-8")
    result = plan(parse_request(request, folder), clock=EffortClock())
    with nullcontext() if is_drawn else mock.patch.object(output, "draw_views"):
        write_result(result, folder / "result")
    return result.verdict.value


def copy_of(name: str, scratch: Path, *, is_drawn: bool = True) -> Path:
    """Return a fresh copy of a base's result folder, with or without its drawings."""
    target = scratch / "result"
    shutil.copytree(original(name) / "result", target, ignore=None if is_drawn else shutil.ignore_patterns(*VIEWS))
    return target


@cache
def _scratch() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="attack-bases-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _example(name: str) -> dict[str, Any]:
    """Return a request of the examples, with the places of its files."""
    text = (ROOT / "examples" / "requests" / f"{name}.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text.replace("../data/", f"{ROOT / 'examples' / 'data'}/")))


def _rest(name: str, phase: str, *, is_compliant: bool = False) -> dict[str, Any]:
    """Return the request for the rest of a base, from a phase on and where its plan begins that phase."""
    return to_json(make_rest_request(original(name) / "result", phase, None, is_compliant=is_compliant))


def _atlas(posture: str, obstacles: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": posture},
        "scene": {"floor": True, "obstacles": obstacles},
        **more,
    }


def _program() -> dict[str, Any]:
    """Return a TrajOpt document with joint values at the end, a slow tool and a fixed start."""
    goal = [GOAL[name] for name in START]
    return {
        "basic_info": {"n_steps": 8, "manip": "active", "start_fixed": True},
        "costs": [
            {"type": "joint_vel", "params": {"coeffs": [1]}},
            {"type": "collision", "params": {"coeffs": [20], "dist_pen": [0.02], "continuous": True}},
        ],
        "constraints": [{"type": "joint", "params": {"vals": goal}}],
        "init_info": {"type": "straight_line", "endpoint": goal},
    }
