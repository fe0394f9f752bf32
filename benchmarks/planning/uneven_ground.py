"""Reaches of robots that stand on anything flat: mats, boards, boxes, slopes up to 15 degrees, and on two levels.

    python -m benchmarks.planning.uneven_ground [--robots atlas g1] [--cases N] [--seed S] [--folder FOLDER]

The ground and a random configuration of the robot on it are drawn; its hand's place there is the goal.  The feet stand
where least squares put them on the ground.  Times are of the processor.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.planning.arms_in_boxes import Run
from benchmarks.planning.fences import AIMS, Stander, draw_reach, list_goals, make_atlas, make_g1, write_start
from benchmarks.planning.robots import find_data_folder
from benchmarks.tables import print_table
from costs.kinematics import locate_links
from costs.robot import RobotModel
from costs.scene import Scene
from costs.terms import JointTarget
from scopt import EffortClock
from service.body.holds import Hold, project_onto_holds, project_within_limits
from service.body.whole_body import WholeBody
from service.planner import plan
from service.request.file import parse_request
from service.setup.prepare import prepare
from service.start.robot import load_requested_robot

KINDS = ("mat", "board", "box", "slope", "two levels")
HEIGHTS = {"mat": (0.005, 0.02), "board": (0.015, 0.05), "box": (0.1, 0.4), "two levels": (0.03, 0.1)}  # [m]
MOST_SLOPE = np.deg2rad(15.0)
BENT_M = 0.02  # by which the base is lowered, so that no knee is stretched
WIDTH_M = 1.5  # of what both feet stand on
COLUMNS = ("robot", "ground", "cases", "certified", "CPU median [s]", "CPU max [s]")


@dataclass(frozen=True)
class Ground:
    """Boxes below the feet.

    Attributes:
        boxes: obstacles of a request.
        moves: pose_world_world that brings each foot, standing on the floor at 0, onto its box.
    """

    boxes: list[dict[str, Any]]
    moves: tuple[Float[np.ndarray, "4 4"], ...]


def draw_ground(kind: str, feet: Float[np.ndarray, "F 3"], rng: np.random.Generator) -> Ground:
    """Return ground of a kind below the middles of feet that stand on the floor at 0."""
    move = np.eye(4)
    if kind == "slope":
        angle, way = rng.uniform(0.1, 1.0) * MOST_SLOPE, rng.uniform(-np.pi, np.pi)
        move[:3, :3] = Rotation.from_rotvec(angle * np.array([np.cos(way), np.sin(way), 0.0])).as_matrix()
        return Ground([_make_box("slope", move, (WIDTH_M, WIDTH_M, 0.2))], (move,) * len(feet))
    move[2, 3] = rng.uniform(*HEIGHTS[kind])
    if kind != "two levels":
        return Ground([_make_box(kind, move, (WIDTH_M, WIDTH_M, move[2, 3]))], (move,) * len(feet))
    raised = int(rng.integers(len(feet)))
    step = move.copy()
    step[:2, 3] = feet[raised, :2] + [0.0, 0.12 * np.sign(feet[raised, 1])]
    moves = tuple(move if foot == raised else np.eye(4) for foot in range(len(feet)))
    return Ground([_make_box("step", step, (0.5, 0.4, move[2, 3]))], moves)


def _make_box(name: str, top: Float[np.ndarray, "4 4"], size: tuple[float, float, float]) -> dict[str, Any]:
    """Return a box whose upper side's middle has the given pose."""
    turn = Rotation.from_matrix(top[:3, :3]).as_quat(scalar_first=True)
    middle = top[:3, 3] - 0.5 * size[2] * top[:3, 2]
    return {"name": name, "type": "box", "size": list(size), "position": middle.tolist(),
            "quaternion_wxyz": turn.tolist()}  # fmt: skip


def stand_on(body: WholeBody, ground: Ground) -> Float[np.ndarray, "n"]:
    """Return the configuration of a robot on level ground moved onto other ground, by least squares."""
    planted = tuple(
        replace(foot, pose_world_link=move @ foot.pose_world_link)
        for foot, move in zip(body.planted, ground.moves, strict=True)
    )
    moved = replace(body, planted=planted)
    q = body.nominal.copy()
    q[2] += np.concatenate([foot.points for foot in planted])[:, 2].mean() - BENT_M
    height, column = q[2:3].copy(), np.array([2])
    lowered: Hold = lambda waypoints: JointTarget(len(waypoints), body.robot.n, waypoints, column, height)  # noqa: E731
    holds = [*moved.holds(), *moved.hold_in_balance(), lowered]
    # Joints whose range begins where they stand, such as fingers, stay there.
    q = project_within_limits(body.engine, q[None], holds, body.robot.lower, body.robot.upper)[0]
    stuck = (q <= body.robot.lower) | (q >= body.robot.upper)
    return np.asarray(project_onto_holds(body.engine, q[None], holds, stuck)[0])


def draw_cases(stander: Stander, robot: RobotModel, kinds: list[str], seed: int) -> Iterator[tuple[str, Any]]:
    """Yield the kind of ground and a request, without end, the same for the same seed."""
    rng = np.random.default_rng([seed, sum(stander.name.encode())])
    empty = stander.make_request(stander.start, [], {"joints": {robot.joint_names[-1]: 0.0}})
    setup = prepare(empty, robot=robot)
    level = WholeBody.standing(robot, setup.scene, setup.start, setup.contacts, AIMS)
    feet = np.stack([foot.points.mean(axis=0) for foot in level.planted])
    while True:
        for kind in kinds:
            ground = draw_ground(kind, feet, rng)
            start = stand_on(level, ground)
            if not np.all((start >= robot.lower) & (start <= robot.upper)):
                print(f"  {stander.name} cannot stand on {ground.boxes[0]}", flush=True)
                continue
            scene = {"floor": kind != "slope", "obstacles": ground.boxes}
            standing = WholeBody.standing(robot, Scene(()), start, setup.contacts, AIMS)
            hand = stander.hands[int(rng.integers(2))]
            there = draw_reach(stander, standing, hand, rng)
            place = locate_links(level.engine, there, [hand])[hand]
            goal = dict(list_goals(hand, place))["position" if rng.integers(2) else "pose"]
            section = {"robot": stander.section, "start": write_start(robot, start), "scene": scene, "goal": goal}
            yield kind, parse_request({**section, "options": stander.options})


def main() -> None:
    """Print a line for every plan, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=["atlas", "g1"], default=["atlas", "g1"])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=None, help="holds the package example-robot-data")
    given = parser.parse_args()
    folder = given.folder or find_data_folder()
    if "g1" in given.robots and folder is None:
        sys.exit("example-robot-data is not installed; pip install 'scopt[robots]'")
    rows = []
    for name in given.robots:
        stander = make_atlas() if name == "atlas" or folder is None else make_g1(folder)
        robot = load_requested_robot(stander.make_request(stander.start, [], {"joints": {"any": 0.0}}))
        runs: dict[str, list[Run]] = {}
        for (kind, request), k in zip(
            draw_cases(stander, robot, given.kinds, given.seed), range(given.cases), strict=False
        ):
            began = time.process_time()
            run = Run(plan(request, robot=robot, clock=EffortClock()), time.process_time() - began)
            runs.setdefault(kind, []).append(run)
            print(f"  {name}/{k} {kind}: {run.cpu_s:.2f} s {run.line}", flush=True)
        rows += [_summarize(name, kind, made) for kind, made in runs.items()]
    print_table("Reaches on anything flat", COLUMNS, rows)


def _summarize(robot: str, kind: str, runs: list[Run]) -> tuple[str, ...]:
    cpu = [run.cpu_s for run in runs]
    certified = sum(run.is_certified for run in runs)
    return (robot, kind, str(len(runs)), str(certified), f"{statistics.median(cpu):.2f}", f"{max(cpu):.1f}")


if __name__ == "__main__":
    main()
