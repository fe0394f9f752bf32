"""Robots on their feet whose hand has to go from one gap of a fence of bars to another one.

    python -m benchmarks.planning.fences [--robots atlas g1] [--cases N] [--seed S] [--time-limit S] [--folder FOLDER]

Start and goal are random configurations on both feet with the hand beyond the fence.  All bars of a regular fence stay
that neither touches, and at least two of them block the straight line between both.  Whether there is a way is not
known.  The time limit counts processor time, so that a busy machine decides nothing.
G1 comes from the package example-robot-data (``pip install 'scopt[robots]'``).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from benchmarks.planning.arms_in_boxes import Run
from benchmarks.planning.crowded_scenes import boxes_near, standing_near
from benchmarks.planning.robots import find_data_folder
from benchmarks.tables import print_table
from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.robot import RobotModel
from scopt import EffortClock
from service.body.aims import Aims
from service.body.paths import straight_path
from service.body.sampling import free_coordinates
from service.body.whole_body import WholeBody
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.setup.prepare import prepare
from service.start.robot import load_requested_robot

AIMS = Aims(0.02, 0.03)  # of start and goal: clearance, balance margin [m]
CLEAR_M = 0.022  # of start and goal from the bars
SHARE = 0.8  # of the joints' ranges that is drawn
LEAST_TRAVEL = 0.7  # of the hand in the fence's plane, in gaps
LEAST_HITS = 2  # bars in the way
TIME_LIMIT_S = 20.0
COLUMNS = ("robot", "goal", "cases", "certified", "by a tree", "CPU median [s]", "CPU max [s]")


@dataclass(frozen=True)
class Stander:
    """Robot of the benchmark, on the ground.

    Attributes:
        name: of the robot.
        section: of its requests.
        start: section of the start.
        hands: links that reach.
        beyond: least distance of a hand ahead of the pelvis [m].
        fence: distances of the fence ahead of the pelvis that are drawn from [m].
        gap: between two bars [m].
        bar: thickness [m].
        options: of its requests.
    """

    name: str
    section: dict[str, Any]
    start: dict[str, Any]
    hands: tuple[str, str]
    beyond: float
    fence: tuple[float, float]
    gap: float
    bar: float
    options: dict[str, Any]

    def make_request(self, start: dict[str, Any], boxes: list[dict[str, Any]], goal: dict[str, Any]) -> PlanRequest:
        """Return a request on level ground."""
        return parse_request({
            "robot": self.section,
            "start": start,
            "scene": {"floor": True, "obstacles": boxes},
            "goal": goal,
            "options": self.options,
        })  # fmt: skip


@dataclass(frozen=True)
class Case:
    """Problem at a fence.

    Attributes:
        name: robot and number.
        requests: by kind of goal.
    """

    name: str
    requests: dict[str, PlanRequest]


def make_atlas() -> Stander:
    """Return the bundled robot."""
    return Stander(
        "atlas", {"name": "atlas"}, {"posture": "reach_ready"}, ("l_tool", "r_tool"), 0.6, (0.4, 0.5), 0.15, 0.03,
        {"time_limit_s": TIME_LIMIT_S},
    )  # fmt: skip


def make_g1(folder: Path) -> Stander:
    """Return Unitree's G1 on bent knees, from the package in a folder."""
    urdf = folder / "example-robot-data/robots/g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf"
    section = {"urdf": str(urdf), "package_dirs": [str(folder)], "root": "floating", "torque": {"check": False}}
    bend = {
        f"{side}_{joint}_joint": value
        for side in ("left", "right")
        for joint, value in (("hip_pitch", -0.3), ("knee", 0.6), ("ankle_pitch", -0.3))
    }
    feet = ["left_ankle_roll_link", "right_ankle_roll_link"]
    robot = load_requested_robot(parse_request({"robot": section, "goal": {"joints": {"any": 0.0}}}))
    lowest = _find_lowest(robot, bend, feet)
    start = {"joints": bend, "base": {"position": [0.0, 0.0, -lowest]}}
    options = {"time_limit_s": TIME_LIMIT_S, "feet": feet}
    hands = ("left_hand_palm_link", "right_hand_palm_link")
    return Stander("g1", section, start, hands, 0.28, (0.18, 0.22), 0.13, 0.02, options)


def _find_lowest(robot: RobotModel, joints: dict[str, float], feet: list[str]) -> float:
    """Return the height of the lowest point of the feet with the base at the origin [m]."""
    q = np.zeros(robot.n)
    for name, value in joints.items():
        q[robot.joint_names.index(name)] = value
    placed = KinematicsEngine(robot)(q[None])
    heights = [
        float((placed.rotation[0, body.joint] @ body.vertices.T + placed.position[0, body.joint][:, None])[2].min())
        for body in robot.bodies
        if body.link in feet
    ]
    return min(heights)


def draw_cases(stander: Stander, robot: RobotModel, seed: int = 0) -> Iterator[Case]:
    """Yield cases without end, the same for the same seed."""
    rng = np.random.default_rng([seed, sum(stander.name.encode())])
    empty = stander.make_request(stander.start, [], {"joints": {robot.joint_names[-1]: 0.0}})
    setup = prepare(empty, robot=robot)
    body = WholeBody.standing(robot, setup.scene, setup.start, setup.contacts, AIMS)
    number = 0
    while True:
        hand = stander.hands[int(rng.integers(2))]
        ends = [draw_reach(stander, body, hand, rng) for _ in range(2)]
        boxes, hits = make_fence(stander, body, ends[0], ends[1], rng)
        places = [locate_links(body.engine, q, [hand])[hand] for q in ends]
        apart = float(np.linalg.norm((places[1] - places[0])[1:3, 3]))
        if hits < LEAST_HITS or apart < LEAST_TRAVEL * stander.gap:
            continue
        number += 1
        start = write_start(robot, ends[0])
        yield Case(
            f"{stander.name}/{number}",
            {kind: stander.make_request(start, boxes, goal) for kind, goal in list_goals(hand, places[1])},
        )


def draw_reach(stander: Stander, body: WholeBody, hand: str, rng: np.random.Generator) -> Float[np.ndarray, "n"]:
    """Return a random configuration on both feet with the hand ahead."""
    robot = body.robot
    joint, _ = locate_frame(robot, hand)
    chain: Int[np.ndarray, "k"] = np.flatnonzero(body.engine.topology.supports[joint])
    chain = np.intersect1d(chain, free_coordinates(body))
    lower, upper = robot.lower[chain], robot.upper[chain]
    middle, half = 0.5 * (lower + upper), 0.5 * SHARE * (upper - lower)
    while True:
        q = body.nominal.copy()
        q[chain] = middle + half * rng.uniform(-1.0, 1.0, len(chain))
        if locate_links(body.engine, q, [hand])[hand][0, 3] < body.nominal[0] + stander.beyond:
            continue
        found = standing_near(body, q)
        if found is not None and locate_links(body.engine, found, [hand])[hand][0, 3] > found[0] + stander.beyond:
            return found


def make_fence(
    stander: Stander,
    body: WholeBody,
    start: Float[np.ndarray, "n"],
    goal: Float[np.ndarray, "n"],
    rng: np.random.Generator,
) -> tuple[list[dict[str, Any]], int]:
    """Return the bars that neither start nor goal touches, and how many block the straight line between them."""
    gap, thick = stander.gap, stander.bar
    x = float(body.nominal[0] + rng.uniform(*stander.fence))
    top = 2.0 * float(body.nominal[2])
    across = np.arange(-6.0 * gap, 6.1 * gap, gap) + rng.uniform(0.0, gap)
    up = np.arange(0.5 * float(body.nominal[2]), top, 1.1 * gap) + rng.uniform(0.0, gap)
    bars = [([thick, thick, top], [x, float(y), 0.75 * top]) for y in across]
    bars += [([thick, 14.0 * gap, thick], [x, 0.0, float(z)]) for z in up]
    direct = body.engine(straight_path(start, goal, 12))
    boxes: list[dict[str, Any]] = []
    hits = 0
    for size, position in bars:
        box = {"size": size, "position": position, "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
        if any(boxes_near(body, [box], body.engine(q[None]), CLEAR_M) for q in (start, goal)):
            continue
        hits += bool(boxes_near(body, [box], direct, 0.0))
        boxes.append({"name": f"bar{len(boxes)}", "type": "box", **box})
    return boxes, hits


def write_start(robot: RobotModel, q: Float[np.ndarray, "n"]) -> dict[str, Any]:
    """Return the section of a request that starts at a configuration of a floating base."""
    turn = Rotation.from_euler("ZYX", q[3:6]).as_quat(scalar_first=True)
    return {
        "joints": dict(zip(robot.joint_names[6:], q[6:].tolist(), strict=True)),
        "base": {"position": q[:3].tolist(), "quaternion_wxyz": turn.tolist()},
    }


def list_goals(hand: str, place: Float[np.ndarray, "4 4"]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the hand's goals by kind."""
    position = {"link": hand, "position": place[:3, 3].tolist(), "position_tolerance_m": 0.005}
    yield "position", {"poses": [position]}
    turn = Rotation.from_matrix(place[:3, :3]).as_quat(scalar_first=True).tolist()
    yield "pose", {"poses": [{**position, "quaternion_wxyz": turn, "rotation_tolerance_deg": 2.0}]}


def summarize(robot: str, goal: str, runs: list[Run]) -> tuple[str, ...]:
    """Return one row of the table."""
    cpu = [run.cpu_s for run in runs]
    certified = [run for run in runs if run.is_certified]
    trees = sum("tree" in str(run.result.found_from) for run in certified)
    return (robot, goal, str(len(runs)), str(len(certified)), str(trees),
            f"{statistics.median(cpu):.2f}", f"{max(cpu):.1f}")  # fmt: skip


def main() -> None:
    """Print a line for every plan, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=["atlas", "g1"], default=["atlas", "g1"])
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, help="processor time of a plan [s]")
    parser.add_argument("--folder", type=Path, default=None, help="holds the package example-robot-data")
    given = parser.parse_args()
    folder = given.folder or find_data_folder()
    if "g1" in given.robots and folder is None:
        sys.exit("example-robot-data is not installed; pip install 'scopt[robots]'")
    rows = []
    for name in given.robots:
        stander = make_atlas() if name == "atlas" or folder is None else make_g1(folder)
        stander.options["time_limit_s"] = given.time_limit
        robot = load_requested_robot(stander.make_request(stander.start, [], {"joints": {"any": 0.0}}))
        runs: dict[str, list[Run]] = {}
        for case, _ in zip(draw_cases(stander, robot, given.seed), range(given.cases), strict=False):
            for kind, request in case.requests.items():
                began = time.process_time()
                run = Run(plan(request, robot=robot, clock=EffortClock()), time.process_time() - began)
                runs.setdefault(kind, []).append(run)
                print(f"  {case.name} {kind}: {run.cpu_s:.2f} s {run.line}", flush=True)
        rows += [summarize(name, kind, made) for kind, made in runs.items()]
    print_table(f"Hands from gap to gap of a fence, limit {given.time_limit:g} s of processor time", COLUMNS, rows)


if __name__ == "__main__":
    main()
