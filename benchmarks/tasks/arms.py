"""Steps of robots by path with a gripper of two fingers: line, path on a face, peg into a hole, pick and place.

``python -m benchmarks.tasks.arms [--robots panda ur5 g1 talos]``: the Panda of the folder ``SCOPT_DATA`` (default:
``../shared/data``) with fingers that slide, the others of ``example-robot-data`` (the extra ``robots``, or
``EXAMPLE_ROBOT_DATA``, the prefix into which it is installed) with a gripper of our own at the right hand. What is not
there is left out.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.tables import print_table
from benchmarks.tasks.object_cases import make_hole
from benchmarks.tasks.published_robots import PUBLISHED, find_published
from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request

DATA = Path(os.environ.get("SCOPT_DATA", Path(__file__).resolve().parents[2].parent / "shared/data"))
FINGER = '<joint name="panda_finger_joint{}" type="fixed">'
SLIDES = '<limit lower="0" upper="0.04" velocity="0.2" effort="70"/></joint>'
TOP = 0.2
JOINTS = (0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.785)
TABLE = {"type": "box", "name": "table", "size": [0.7, 1.2, 0.1], "position": [0.6, 0.0, TOP - 0.05]}
PEG, PLAY, DEPTH = 0.04, 0.003, 0.05
FROM, INTO = (0.5, -0.2), (0.5, 0.2)


def write_panda(folder: Path) -> Path:
    """Write the arm's URDF with fingers that slide."""
    source = DATA / "robots/panda"
    text = (source / "panda.urdf").read_text(encoding="utf-8").replace('"meshes/', f'"{source}/meshes/')
    head, *fingers = text.split('<joint name="panda_finger_joint')
    for number, finger in enumerate(fingers, start=1):
        own, rest = finger.split("</joint>", 1)
        own = own.replace('type="fixed"', 'type="prismatic"').replace('<mimic joint="panda_finger_joint1" />', "")
        own = own.replace("0.065 0.0584", "0 0.0584").replace("-0 0.0584", "0 0.0584")
        head += f'<joint name="panda_finger_joint{number}"' + own[2:] + SLIDES + rest
    path = folder / "panda_slides.urdf"
    path.write_text(head, encoding="utf-8")
    return path


def make_requests(urdf: Path) -> Mapping[str, dict[str, Any]]:
    """Return a request per kind of step."""
    fingers = ["panda_leftfinger", "panda_rightfinger"]
    hand = {"link": "panda_hand", "hook": "panda_hand", "tool": "panda_grasptarget", "fingers": fingers}
    joints = {f"panda_joint{k}": value for k, value in enumerate(JOINTS, start=1)}
    base: dict[str, Any] = {
        "robot": {"urdf": str(urdf), "package_dirs": [str(DATA / "robots/panda")], "hands": {"right": hand}},
        "start": {"joints": {**joints, "panda_finger_joint1": 0.03, "panda_finger_joint2": 0.03}},
    }
    up = {"hand": "right", "by": {"translation": [0.05, 0.1, 0.1]}, "along": "line", "speed_m_s": 0.1}
    face = {"point": [0.5, 0.0, TOP], "normal": [0, 0, 1], "pieces": ["table"]}
    circle = {"hand": "right", "face": face, "circle": {"centre": [0.5, 0.0, TOP], "radius_m": 0.1}, "depth_m": -0.02}
    peg = {"name": "item", "type": "box", "size": [PEG, PEG, 0.14], "mass_kg": 0.4, "position": [*FROM, TOP + 0.07]}
    block = {**peg, "size": [0.05, 0.05, 0.1], "position": [*FROM, TOP + 0.05]}
    walls = [*make_hole("one", FROM, TOP, PEG + PLAY, DEPTH), *make_hole("two", INTO, TOP, PEG + PLAY, DEPTH)]
    plug = {
        "object": "item", "to": [*INTO, TOP + 0.07], "normal": [0, 0, 1], "depth": DEPTH, "clear": 0.03,
        "clearance": PLAY, "sockets": [wall["name"] for wall in walls],
    }  # fmt: skip
    put = {"object": "item", "to": [*INTO, TOP + 0.05]}
    press = {"at": [0.5, 0.1, TOP + 0.02], "normal": [0, 0, 1], "force_n": 10, "travel_m": 0.01, "height_m": 0.02}

    def scene(*walls: dict[str, Any], item: dict[str, Any] | None = None) -> dict[str, Any]:
        return {"scene": {"obstacles": [TABLE, *walls], **({} if item is None else {"objects": [item]})}}

    return {
        "line": {**base, **scene(), "task": {"steps": [{"move": up}]}},
        "follow": {**base, **scene(), "task": {"steps": [{"follow": circle}]}},
        "press": {**base, **scene(), "task": {"steps": [{"press": press}]}},
        "insert": {**base, **scene(*walls, item=peg), "task": {"use": "plug", "with": plug}},
        "pick_place": {**base, **scene(item=block), "task": {"use": "pick_place", "with": put}},
    }


def main() -> None:
    """Plan every request, print a row for each, and why one is not certified."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ("panda", *PUBLISHED)
    parser.add_argument("--robots", nargs="+", choices=names, default=names)
    given, published, rows = parser.parse_args(), find_published(), list[list[str]]()
    with tempfile.TemporaryDirectory() as scratch:
        for robot in given.robots:
            if robot == "panda" and (DATA / "robots/panda").is_dir():
                requests = make_requests(write_panda(Path(scratch)))
            elif robot != "panda" and published is not None:
                requests = PUBLISHED[robot](published, Path(scratch))
            else:
                print(f"no {robot}: SCOPT_DATA or EXAMPLE_ROBOT_DATA names its folder")
                continue
            for name, data in requests.items():
                started = time.process_time()
                try:
                    result = plan(parse_request(data))
                except RequestError as error:
                    print(f"{robot} {name}: {error}", flush=True)
                    continue
                cost = f"{time.process_time() - started:.1f}"
                rows.append([robot, name, result.verdict.value, cost, " ".join(result.explanation)[:160]])
                print(*rows[-1], flush=True)
    print_table("Steps of robots by path", ["robot", "steps", "verdict", "CPU [s]", "why not"], rows)


if __name__ == "__main__":
    main()
