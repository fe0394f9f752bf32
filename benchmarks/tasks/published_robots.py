"""Requests of robots that ``example-robot-data`` publishes, each with a gripper of our own at its right hand."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.attack.gantry_files import format_joint, format_link
from benchmarks.tasks.object_cases import make_hole

Data = dict[str, Any]
HAND = {"link": "grip_hand", "hook": "grip_hand", "tool": "grip_tool", "fingers": ["grip_1", "grip_2"]}
OPEN = {"slide_1": 0.03, "slide_2": 0.03}
PEG, PLAY, DEPTH, HEIGHT = 0.03, 0.003, 0.04, 0.12
STANDING = {"hip_pitch": -0.2, "knee": 0.4, "ankle_pitch": -0.2}


@dataclass(frozen=True)
class Bench:
    """A table before a robot: height of its top, its middle and size, and places on it [m]."""

    top: float
    middle: tuple[float, float]
    size: tuple[float, float]
    first: tuple[float, float]
    second: tuple[float, float]
    circle: tuple[float, float]
    radius: float


def find_published() -> Path | None:
    """Return the folder of the published robots; None where there is none."""
    given = os.environ.get("EXAMPLE_ROBOT_DATA")
    if given is None:
        found = find_spec("cmeel")
        packages = () if found is None else found.submodule_search_locations or ()
        places = [Path(package).parent / "cmeel.prefix" for package in packages]
    else:
        places = [Path(given)]
    robots = (place / "share/example-robot-data/robots" for place in places)
    return next((folder for folder in robots if folder.is_dir()), None)


def write_gripper(source: Path, folder: Path, link: str, at: str, turned: str) -> str:
    """Write a URDF with a gripper at one of its links, and return its path."""
    text = source.read_text(encoding="utf-8").replace('filename="meshes/', f'filename="{source.parents[1]}/meshes/')
    parts = [
        format_link("grip_hand", 0.3, "0.04 0.12 0.04", "0 0 0.02"),
        format_link("grip_1", 0.05, "0.02 0.012 0.06", "0 0.006 0.03"),
        format_link("grip_2", 0.05, "0.02 0.012 0.06", "0 -0.006 0.03"),
        '<link name="grip_tool"/>',
        f'<joint name="grip_mount" type="fixed"><parent link="{link}"/><child link="grip_hand"/>'
        f'<origin xyz="{at}" rpy="{turned}"/></joint>',
        format_joint("slide_1", "prismatic", "grip_hand", "grip_1", "0 0.004 0.042", "0 1 0", (0.0, 0.04, 100.0)),
        format_joint("slide_2", "prismatic", "grip_hand", "grip_2", "0 -0.004 0.042", "0 -1 0", (0.0, 0.04, 100.0)),
        '<joint name="grip_end" type="fixed"><parent link="grip_hand"/><child link="grip_tool"/>'
        '<origin xyz="0 0 0.08"/></joint>',
    ]
    path = folder / source.name
    path.write_text(text.replace("</robot>", "".join(parts) + "</robot>"), encoding="utf-8")
    return str(path)


def make_requests(base: Data, bench: Bench, way: list[float]) -> Mapping[str, Data]:
    """Return a line, a circle above the table, a block put elsewhere, and a peg from hole to hole."""
    top, size = bench.top, [*bench.size, 0.05]
    table = {"type": "box", "name": "table", "size": size, "position": [*bench.middle, top - 0.025]}
    middle = top + 0.5 * HEIGHT
    item = {"name": "item", "type": "box", "size": [PEG, PEG, HEIGHT], "mass_kg": 0.2}
    item = {**item, "position": [*bench.first, middle]}
    walls = [
        *make_hole("one", bench.first, top, PEG + PLAY, DEPTH),
        *make_hole("two", bench.second, top, PEG + PLAY, DEPTH),
    ]
    face = {"point": [*bench.circle, top], "normal": [0, 0, 1], "pieces": ["table"]}
    circle = {"centre": [*bench.circle, top], "radius_m": bench.radius}
    put = {"object": "item", "to": [*bench.second, middle], "hand": "right"}
    plug = {
        **put, "normal": [0, 0, 1], "depth": DEPTH, "clear": 0.03, "clearance": PLAY,
        "sockets": [wall["name"] for wall in walls],
    }  # fmt: skip

    def request(task: Data, *more: Data, objects: tuple[Data, ...] = ()) -> Data:
        scene = {**base.get("scene", {}), "obstacles": [table, *more], "objects": list(objects)}
        return {**base, "scene": scene, "task": task}

    line = {"hand": "right", "by": {"translation": way}, "along": "line", "speed_m_s": 0.1}
    follow = {"hand": "right", "face": face, "circle": circle, "depth_m": -0.035}
    return {
        "line": request({"steps": [{"move": line}]}),
        "follow": request({"steps": [{"follow": follow}]}),
        "pick_place": request({"use": "pick_place", "with": put}, objects=(item,)),
        "insert": request({"use": "plug", "with": plug}, *walls, objects=(item,)),
    }


def make_ur5(robots: Path, folder: Path) -> Mapping[str, Data]:
    """Return the requests of Universal Robots' UR5."""
    urdf = write_gripper(robots / "ur_description/urdf/ur5_robot.urdf", folder, "tool0", "0 0 0.005", "0 0 0")
    arm = {"shoulder_pan": 0.0, "shoulder_lift": -1.2, "elbow": 1.7, "wrist_1": -2.07, "wrist_2": -1.57, "wrist_3": 0.0}
    joints = {f"{name}_joint": value for name, value in arm.items()}
    robot = {"urdf": urdf, "package_dirs": [str(robots.parents[1])], "hands": {"right": HAND}}
    bench = Bench(0.0, (0.5, 0.0), (0.5, 0.9), (0.45, -0.2), (0.45, 0.2), (0.5, 0.05), 0.08)
    return make_requests({"robot": robot, "start": {"joints": {**joints, **OPEN}}}, bench, [0.0, 0.1, 0.1])


def make_g1(robots: Path, folder: Path) -> Mapping[str, Data]:
    """Return the requests of Unitree's G1."""
    source = robots / "g1_description/urdf/g1_29dof_rev_1_0.urdf"
    urdf = write_gripper(source, folder, "right_wrist_yaw_link", "0.17 0 0", "0 1.5707963 0")
    legs = {f"{side}_{name}_joint": value for side in ("left", "right") for name, value in STANDING.items()}
    arms = {"right_elbow_joint": -0.3, "left_elbow_joint": 0.5}
    arms |= {"right_shoulder_roll_joint": -0.2, "left_shoulder_roll_joint": 0.2}
    base: Data = {
        "robot": {
            "urdf": urdf, "package_dirs": [str(robots.parents[1]), str(robots)], "root": "floating",
            "hands": {"right": HAND}, "drawn_links": ["left_rubber_hand"],
        },
        "start": {"base": {"position": [0, 0, 0.78]}, "joints": {**legs, **arms, **OPEN}},
        "scene": {"floor": True},
        "options": {"feet": ["left_ankle_roll_link", "right_ankle_roll_link"]},
    }  # fmt: skip
    bench = Bench(0.66, (0.42, -0.1), (0.3, 0.6), (0.33, -0.2), (0.33, -0.02), (0.36, -0.12), 0.04)
    return make_requests(base, bench, [0.03, 0.0, 0.06])


def make_talos(robots: Path, folder: Path) -> Mapping[str, Data]:
    """Return the requests of PAL's Talos."""
    source = robots / "talos_data/robots/talos_reduced.urdf"
    urdf = write_gripper(source, folder, "gripper_right_base_link", "0 0 -0.14", "3.14159265 0 0")
    base: Data = {
        "robot": {
            "urdf": urdf, "srdf": str(robots / "talos_data/srdf/talos.srdf"),
            "package_dirs": [str(robots.parents[1])], "root": "floating", "hands": {"right": HAND},
            "locked": {"torso_2_joint": 0.05, "gripper_left_joint": -0.1, "gripper_right_joint": -0.1},
        },
        "start": {"posture": "half_sitting"},
        "scene": {"floor": True},
        "options": {"feet": ["leg_left_6_link", "leg_right_6_link"]},
    }  # fmt: skip
    bench = Bench(0.85, (0.65, -0.2), (0.5, 0.8), (0.5, -0.35), (0.5, -0.1), (0.55, -0.25), 0.08)
    return make_requests(base, bench, [0.03, 0.0, 0.08])


PUBLISHED: Mapping[str, Callable[[Path, Path], Mapping[str, Data]]] = {
    "ur5": make_ur5,
    "g1": make_g1,
    "talos": make_talos,
}
"""Makers of requests by robot: of the folder of the published robots, and one to write to."""
