"""Kept regions and sets of goals on drawn problems: certified or not, at what cost.

``python -m benchmarks.planning.regions [--count N] [--seed S] [--groups cup tray keep goals]``

A Panda among a pole and two boxes, from the folder ``SCOPT_DATA``.  At start and goal the hand is upright, and both are
clear; whether a motion exists between them is not known beforehand.

- cup: the hand's axis stays within 5 to 15 deg of upright, its position is free.
- tray: the same within 3 to 6 deg, at a height within 15 cm of the start and of the goal, along a part of the motion.
- keep: the hand stays within a box about start and goal, and turns about its own axes by limits of each.
- goals: half-spaces and boxes to end in, the nearest of several, a place to look at, places on the way.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.planning.starts import find_panda
from benchmarks.tables import print_table
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import RobotModel
from scopt import EffortClock
from service import clearance
from service.planner import plan
from service.request.file import parse_request
from service.setup.world import build_obstacles
from service.start.robot import load_requested_robot

HAND = "panda_hand"
DOWN = Rotation.from_euler("x", 180.0, degrees=True)
LOW, HIGH = np.array([0.3, -0.5, 0.25]), np.array([0.65, 0.5, 0.7])  # of the hand [m]
LEAST_APART_M = 0.35
DRAWN = {0: (-1.2, 1.2), 1: (-0.9, 0.5), 3: (-2.6, -1.4), 6: (-1.5, 2.5)}  # joints of both ends [rad]
CLEAR_M = 0.003  # of both ends, own links included
COLUMNS = ("group", "plans", "certified", "CPU median [s]", "CPU max [s]")
Draw = Callable[[np.random.Generator, dict[str, Any], Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]], None]


def draw_scene(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return a pole and two boxes in front of the robot."""
    scene: list[dict[str, Any]] = [
        {
            "name": "pole",
            "type": "cylinder",
            "radius": float(rng.uniform(0.02, 0.05)),
            "height": 0.8,
            "position": [float(rng.uniform(0.4, 0.6)), float(rng.uniform(-0.15, 0.15)), 0.4],
        }
    ]
    for k in range(2):
        place = rng.uniform(LOW - np.array([0.0, 0.1, 0.2]), HIGH + np.array([0.15, 0.1, 0.15]))
        size = rng.uniform(0.05, 0.15, 3)
        scene.append({"name": f"box{k}", "type": "box", "size": size.tolist(), "position": place.tolist()})
    return scene


def draw_problem(
    rng: np.random.Generator, robot: RobotModel, files: Mapping[str, Any]
) -> tuple[dict[str, Any], Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]]:
    """Return a request with a joint goal between two poses of the upright hand, and ``pose_world_hand`` at both."""
    engine = KinematicsEngine(robot)
    while True:
        data: dict[str, Any] = {"robot": dict(files), "scene": {"floor": False, "obstacles": draw_scene(rng)}}
        request = parse_request({**data, "goal": {"joints": {robot.joint_names[0]: 0.0}}})
        pieces = build_obstacles(request)[0]
        ends = np.zeros((2, robot.n))
        for column, (low, high) in DRAWN.items():
            ends[:, column] = rng.uniform(low, high, 2)
        ends[:, 5] = ends[:, 1] - ends[:, 3]  # the hand points down
        first, last = (locate_links(engine, q, [HAND])[HAND] for q in ends)
        if np.linalg.norm(last[:3, 3] - first[:3, 3]) < LEAST_APART_M:
            continue
        if min(clearance(robot, q, pieces).distance_m for q in ends) <= CLEAR_M:
            continue
        names = robot.joint_names
        data["start"] = {"joints": dict(zip(names, ends[0].tolist(), strict=False))}
        data["goal"] = {"joints": dict(zip(names, ends[1].tolist(), strict=False))}
        return data, first, last


def draw_cup(rng: np.random.Generator, data: dict[str, Any], first: np.ndarray, last: np.ndarray) -> None:
    """Keep the hand upright."""
    lean = float(rng.uniform(5.0, 15.0))
    data["keep"] = [{"link": HAND, "free_axis": "z", "rotation_tolerance_deg": lean, "position_tolerance_m": 1.0}]


def draw_tray(rng: np.random.Generator, data: dict[str, Any], first: np.ndarray, last: np.ndarray) -> None:
    """Keep the hand upright and within a band of heights, up to a share of the motion."""
    low, high = sorted((float(first[2, 3]), float(last[2, 3])))
    band = {"z_min_m": low - 0.15, "z_max_m": high + 0.15}
    lean = float(rng.uniform(3.0, 6.0))
    own = {"link": HAND, "until": float(rng.uniform(0.7, 1.0))}
    turned = DOWN.as_quat(scalar_first=True).tolist()
    data["keep"] = [
        {
            **own,
            "free_axis": "z",
            "quaternion_wxyz": turned,
            "rotation_tolerance_deg": lean,
            "position_tolerance_m": 1.0,
        },
        {
            **own,
            "position": [0.0, 0.0, 0.0],
            "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0],
            "rotation_tolerance_deg": 180.0,
            "region": band,
        },
    ]


def draw_keep(rng: np.random.Generator, data: dict[str, Any], first: np.ndarray, last: np.ndarray) -> None:
    """Keep the hand in a box about both ends and its turns about each axis within limits."""
    spare = rng.uniform(0.12, 0.25, 3)
    low, high = np.minimum(first[:3, 3], last[:3, 3]) - spare, np.maximum(first[:3, 3], last[:3, 3]) + spare
    box = {
        f"{axis}_{end}_m": float(bound[k])
        for k, axis in enumerate("xyz")
        for end, bound in (("min", low), ("max", high))
    }
    turns = {"about_x_deg": float(rng.uniform(10.0, 20.0)), "about_y_deg": float(rng.uniform(10.0, 20.0))}
    data["keep"] = [
        {
            "link": HAND,
            "position": [0.0, 0.0, 0.0],
            "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0],
            "rotation_tolerance_deg": 180.0,
            "region": box,
        },
        {"link": HAND, "free_axis": "z", "rotation_tolerance_deg": turns["about_x_deg"], "position_tolerance_m": 1.0},
    ]


def draw_goals(rng: np.random.Generator, data: dict[str, Any], first: np.ndarray, last: np.ndarray) -> None:
    """Demand an end in a region, at the nearest of several, with a view of a place, or by places on the way."""
    place, joints = last[:3, 3], data["goal"]["joints"]
    turned = Rotation.from_matrix(last[:3, :3]).as_quat(scalar_first=True).tolist()
    half = rng.uniform(0.02, 0.08, 3)
    box = {
        f"{axis}_{end}_m": float(sign * half[k])
        for k, axis in enumerate("xyz")
        for end, sign in (("min", -1), ("max", 1))
    }
    pose = {"link": HAND, "position": place.tolist(), "quaternion_wxyz": turned}
    turns = {f"about_{axis}_deg": float(angle) for axis, angle in zip("xyz", rng.uniform(5.0, 60.0, 3), strict=True)}
    middle = (0.5 * (first[:3, 3] + place) + [0.0, 0.0, 0.12]).tolist()
    match int(rng.integers(5)):
        case 0:
            data["goal"] = {"poses": [{**pose, "region": {**box, **turns}}]}
        case 1:
            side = {"y_min_m": float(place[1])} if place[1] > first[1, 3] else {"y_max_m": float(place[1])}
            data["goal"] = {"poses": [{"link": HAND, "region": {**side, "z_min_m": 0.2}}]}
        case 2:
            far = {"poses": [{"link": HAND, "position": [3.0, 0.0, 0.0]}]}
            data["goal"] = {"any_of": [far, {"joints": joints}, {"poses": [{**pose, "free_axis": "z"}]}]}
        case 3:
            seen = (place + last[:3, 2] * 0.3).tolist()
            look = {"look_at": seen, "look_axis": "z", "rotation_tolerance_deg": 3.0}
            data["goal"] = {"poses": [{"link": HAND, "position": place.tolist(), "position_tolerance_m": 0.03, **look}]}
        case _:
            via = {"poses": [{"link": HAND, "position": middle, "position_tolerance_m": 0.08}]}
            data["goal"] = {"joints": joints, "via": [via]}


GROUPS: Mapping[str, Draw] = {"cup": draw_cup, "tray": draw_tray, "keep": draw_keep, "goals": draw_goals}


def list_problems(
    group: str, count: int, seed: int, robot: RobotModel, files: Mapping[str, Any]
) -> Iterator[dict[str, Any]]:
    """Yield the drawn requests of a group."""
    for k in range(count):
        rng = np.random.default_rng([seed, list(GROUPS).index(group), k])
        data, first, last = draw_problem(rng, robot, files)
        GROUPS[group](rng, data, first, last)
        yield data


def main() -> None:
    """Print a line for every plan that is not certified, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--groups", nargs="+", choices=list(GROUPS), default=list(GROUPS))
    given = parser.parse_args()
    known = find_panda()
    if known is None:
        print("no Panda: SCOPT_DATA has no mbm_panda")
        return
    files = known[1].to_request()
    robot = load_requested_robot(parse_request({"robot": files, "goal": {"joints": {"panda_joint1": 0.0}}}))
    rows = []
    for group in given.groups:
        seconds, certified = [], 0
        for k, data in enumerate(list_problems(group, given.count, given.seed, robot, files)):
            request = parse_request(data)
            began = time.process_time()
            result = plan(request, clock=EffortClock())
            seconds.append(time.process_time() - began)
            certified += result.verdict.value == "CERTIFIED"
            if result.verdict.value != "CERTIFIED":
                print(
                    f"  {group} {k}: {result.verdict.value} {seconds[-1]:.1f} s: {'; '.join(result.explanation)[:200]}",
                    flush=True,
                )
        rows.append(
            (group, str(len(seconds)), str(certified), f"{statistics.median(seconds):.2f}", f"{max(seconds):.2f}")
        )
    print_table("Regions and sets of goals", COLUMNS, rows)


if __name__ == "__main__":
    main()
