"""Requests of what few plans have: MuJoCo models, split links, bases on wheels, regions, padding, blends, stacks,
fingers that follow, and a mechanism that two steps push."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.attack.arm_files import arm_request, write_arm
from benchmarks.attack.gantry_files import hand_over_request, pick_place_request, write_gantry, write_two_hands
from benchmarks.attack.step_requests import FROM, INTO, TOP, peg_request
from benchmarks.tasks.carry import draw_both

_MJCF = """<mujoco model="arm">
 <compiler angle="degree"/>
 <worldbody>
  <body name="base" pos="0 0 0.2"><geom type="cylinder" size="0.1 0.1"/>
   <body name="upper" pos="0 0 0.15"><joint name="pan" axis="0 0 1" range="-170 170"/>
    <geom type="capsule" fromto="0 0 0.08 0 0 0.36" size="0.04"/>
    <body name="lower" pos="0 0 0.45"><joint name="lift" axis="0 1 0" range="-100 100"/>
     <geom type="capsule" fromto="0.09 0 0 0.3 0 0" size="0.03"/>
     <body name="hand" pos="0.42 0 0"><joint name="slide" type="slide" axis="1 0 0" range="0 0.2"/>
      <geom type="box" size="0.05 0.03 0.02"/>
     </body></body></body></body>
 </worldbody>
 <actuator><motor joint="pan" ctrlrange="-30 30" ctrllimited="true" gear="2"/>
  <position joint="lift" kp="100" forcerange="-50 50"/></actuator>
 <keyframe><key name="home" qpos="-0.8 0.2 0.02"/></keyframe>
</mujoco>"""
_SPLIT = """<robot name="fork"><link name="base"/>
<link name="grip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0"/><geometry><mesh filename="grip.stl"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="grip"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>"""
_CART = """<robot name="cart">
<link name="chassis"><inertial><mass value="20"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.5 0.4 0.3"/></geometry></collision></link>
<link name="arm"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.3 0.1 0.1"/></geometry></collision></link>
<joint name="lift" type="revolute"><parent link="chassis"/><child link="arm"/><origin xyz="0.2 0 0.5"/>
<axis xyz="0 -1 0"/><limit lower="-2" upper="2" velocity="2" effort="60"/></joint></robot>"""
PIN = {"name": "pin", "type": "box", "size": [0.012, 0.012, 0.2], "position": [0.16, 0.0, 0.0]}
PILLAR = {"name": "pillar", "type": "cylinder", "radius": 0.15, "height": 2.0, "position": [1.0, 0.05, 1.0]}
LEAF, LEVER = (
    Path(__file__).resolve().parents[2] / "examples" / "data" / name for name in ("doorway.urdf", "entrance.urdf")
)


def make_mujoco(folder: Path) -> dict[str, Any]:
    """Return a request for an arm that is a model of MuJoCo."""
    (folder / "arm.xml").write_text(_MJCF, encoding="utf-8")
    post = {"name": "post", "type": "box", "size": [0.06, 0.06, 0.6], "position": [0.4, 0.0, 0.3]}
    return {
        "robot": {"urdf": str(folder / "arm.xml")},
        "start": {"posture": "home"},
        "scene": {"obstacles": [post]},
        "goal": {"joints": {"pan": 0.8, "lift": 0.1, "slide": 0.1}},
    }


def make_split(folder: Path) -> dict[str, Any]:
    """Return a request for a fork whose prongs go on both sides of a pin: its one mesh is split."""
    prongs = [trimesh.creation.box((0.1, 0.02, 0.02)) for _ in range(2)]
    for prong, side in zip(prongs, (-0.04, 0.04), strict=True):
        prong.apply_translation((0.05, side, 0.0))
    palm = trimesh.creation.box((0.02, 0.1, 0.02))
    trimesh.util.concatenate([palm, *prongs]).export(folder / "grip.stl")
    (folder / "fork.urdf").write_text(_SPLIT, encoding="utf-8")
    return {
        "robot": {"urdf": str(folder / "fork.urdf"), "decompose": ["grip"]},
        "start": {"joints": {"turn": 0.08}},
        "scene": {"floor": False, "obstacles": [PIN]},
        "goal": {"joints": {"turn": -0.08}},
    }


def make_cart(folder: Path) -> dict[str, Any]:
    """Return a request for a base on two wheels around a pillar."""
    (folder / "cart.urdf").write_text(_CART, encoding="utf-8")
    return {
        "robot": {"urdf": str(folder / "cart.urdf"), "root": "differential"},
        "start": {"joints": {"base_yaw": 0.5, "lift": 0.2}},
        "scene": {"floor": False, "obstacles": [PILLAR]},
        "goal": {"joints": {"base_x": 2.0, "base_y": 0.4, "base_yaw": 1.0, "lift": 0.6}},
    }


def make_region(folder: Path) -> dict[str, Any]:
    """Return a request for an arm that stays below a height and ends in a box."""
    region = {"x_min_m": 0.2, "x_max_m": 0.5, "y_min_m": 0.3, "y_max_m": 0.7, "z_min_m": 0.4, "z_max_m": 0.9}
    request = arm_request(write_arm(folder), goal={"poses": [{"link": "hand", "region": region}]})
    request["scene"]["obstacles"] = []
    level = {"position": [0.0, 0.0, 0.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0], "rotation_tolerance_deg": 180.0}
    request["keep"] = [{"link": "hand", "region": {"z_max_m": 1.0}, **level}]
    return request


def make_padded(folder: Path) -> dict[str, Any]:
    """Return a request for an arm that keeps distances, of single links and of one obstacle."""
    options = {"clearance_m": 0.02, "padding": {"hand": 0.015, "post": 0.01}, "time_limit_s": 20.0}
    return arm_request(write_arm(folder), options=options)


def make_blends(folder: Path) -> dict[str, Any]:
    """Return a request for a hand that goes through two rounded corners."""
    ways = ([0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.02, -0.1])
    moves = [
        {"hand": "right", "along": "line", "speed_m_s": 0.1, "by": {"translation": way}, **more}
        for way, more in zip(ways, ({"blend_m": 0.03}, {"blend_m": 0.02}, {}), strict=True)
    ]
    request = pick_place_request(write_gantry(folder))
    request["scene"]["objects"] = []
    request["task"] = {"steps": [{"move": move} for move in moves]}
    return request


def make_stack(folder: Path) -> dict[str, Any]:
    """Return a request that takes a stack of two blocks apart and builds it again."""
    request = peg_request(write_gantry(folder))
    block = {"type": "box", "size": [0.04, 0.04, 0.06], "mass_kg": 0.3}
    request["scene"]["obstacles"] = [one for one in request["scene"]["obstacles"] if one["name"] == "table"]
    request["scene"]["objects"] = [
        {"name": name, **block, "position": [*FROM, TOP + 0.03 + 0.06 * k]} for k, name in enumerate(("lower", "upper"))
    ]
    request["task"] = {"steps": []}
    for k, name in enumerate(("upper", "lower")):
        height = TOP + 0.03 + 0.06 * k
        request["task"]["steps"] += [
            {"grasp": {"object": name}},
            {"move": {"frame": name, "by": {"translation": [0, 0, 0.05]}, "along": "line"}},
            {"move": {"poses": [{"link": name, "position": [*INTO, height + 0.05]}]}},
            {"move": {"poses": [{"link": name, "position": [*INTO, height]}], "along": "line"}},
            {"release": {"object": name}},
        ]
    return request


def make_follower(folder: Path) -> dict[str, Any]:
    """Return a request to carry a block between fingers of which one follows the other."""
    return pick_place_request(write_gantry(folder, follows=True), follows=True)


def make_beam(folder: Path) -> dict[str, Any]:
    """Return a request to carry a beam with two hands."""
    return draw_both(np.random.default_rng(0))


def make_two_pushes(folder: Path) -> dict[str, Any]:
    """Return a request to push a leaf in two steps, of which the second goes on where the first ends."""
    push = {
        "urdf": str(LEAF),
        "position": [0.74, 0.55, 0.0],
        "joints": {"hinge": {"friction": 4.0}},
        "handle": {"link": "leaf", "place": [-0.02, -0.8, 1.1], "axis": [1, 0, 0], "tool": "tip", "tilt_deg": 35.0},
        "hand": "right",
    }
    return _make_steps([{"mechanism": {**push, "moves": [{"joint": "hinge", "to": to}]}} for to in (0.15, 0.3)])


def make_lever_of_door(folder: Path) -> dict[str, Any]:
    """Return a request to press a door's lever with the sides of closed fingers, and to open its leaf with the palm."""
    handle = {
        "link": "lever", "place": [-0.0935, 0.1, 0.02], "axis": [1, 0, 0], "tool": "stub", "tilt_deg": 5.0,
        "approach": [-0.12, 0, 0.03],
    }  # fmt: skip
    mechanism = {
        "urdf": str(LEVER),
        "position": [0.74, 0.55, 0.0],
        "joints": {"hinge": {"friction": 4.0}, "handle": {"preload": 2.0}},
        "releases": [{"joint": "hinge", "latch": "handle", "at": 0.6}],
        "handle": handle,
        "moves": [{"joint": "handle", "to": 0.65}, {"joint": "hinge", "to": 0.2}, {"joint": "handle", "to": 0.0}],
        "hand": "right",
    }
    return _make_steps([{"mechanism": mechanism}], hand="gripper")


def make_braced(folder: Path) -> dict[str, Any]:
    """Return a request to hook the left hand behind a rail, and to press hard with the right one."""
    rail = {"name": "rail", "type": "box", "size": [0.04, 0.5, 0.04], "position": [0.6, 0.5, 1.05]}
    hook = {"name": "hook", "make": {"left_hook": {"surface": "rail", "at": [0.62, 0.35, 1.05]}}}
    brace = {"surfaces": {"rail": {"piece": "rail", "normal": [1, 0, 0]}}, "stances": [hook]}
    press = {"at": [0.74, -0.25, 1.2], "normal": [-1, 0, 0], "force_n": 300.0, "travel_m": 0.02, "hand": "right"}
    return _make_steps([{"name": "brace", "contacts": brace}, {"name": "shove", "press": press}], rail)


def _make_steps(steps: list[dict[str, Any]], *obstacles: dict[str, Any], hand: str = "hook") -> dict[str, Any]:
    return {
        "robot": {"name": "atlas", "hand": hand},
        "start": {"posture": "reach_ready"},
        "scene": {"floor": True, "obstacles": list(obstacles)},
        "task": {"steps": steps},
    }


def make_hand_over(folder: Path) -> dict[str, Any]:
    """Return a request that hands a bar over."""
    return hand_over_request(write_two_hands(folder))


RARE: dict[str, Callable[[Path], dict[str, Any]]] = {
    "mujoco": make_mujoco,
    "split": make_split,
    "cart": make_cart,
    "region": make_region,
    "padded": make_padded,
    "blends": make_blends,
    "stack": make_stack,
    "follower": make_follower,
    "beam": make_beam,
    "pushes": make_two_pushes,
    "handover": make_hand_over,
    "handle": make_lever_of_door,
    "braced": make_braced,
}
