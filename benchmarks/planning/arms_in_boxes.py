"""Arms among 20 random boxes: goals in joints that RRT-Connect reaches, and goals as poses that exist by construction.

    python -m benchmarks.planning.arms_in_boxes [--robots ur5 ur10 xarm7 so101] [--cases N] [--seed S]
        [--folder FOLDER] [--each]

Robots come from the package example-robot-data (``pip install 'scopt[robots]'``).  In every case the straight line
between start and goal is blocked.  A case with a goal in joints counts if a plain RRT-Connect (Kuffner and LaValle,
ICRA 2000) without any shortcuts solves it within ``TREE_LIMIT_S``; it uses pinocchio and coal alone.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.planning.robots import find_data_folder
from benchmarks.tables import print_table
from costs.collision import PairMargins, PoseChecker
from costs.kinematics import KinematicsEngine, locate_links
from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import PlanRequest
from service.result.result import PlanResult, Verdict
from service.setup.world import build_obstacles
from service.start.robot import load_requested_robot

# URDF and SRDF below the package's ``robots``, and the link that has to arrive.
ROBOTS: dict[str, tuple[str, str | None, str]] = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf", "tool0"),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", None, "tool0"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "xarm_description/srdf/xarm7.srdf", "link7"),
    "so101": ("so_arm_description/urdf/so101.urdf", None, "gripper_frame_link"),
}
N_BOXES = 20
SIZES, PLACES = (0.05, 0.25), (0.3, 1.0)  # of boxes, as shares of the arm's reach
CLEAR_M = 5e-3  # clearance of start and goal
TREE_CLEAR_M, TREE_STEP, TREE_EDGE, TREE_LIMIT_S = 1e-3, 0.4, 0.03, 12.0  # [m], [rad], [rad], [s]
TIME_LIMIT_S = 20.0
LEAST_SHARE = 0.98
COLUMNS = ("robot", "goal", "cases", "certified", "goal found", "CPU median [s]", "CPU p95 [s]", "CPU max [s]")


@dataclass(frozen=True)
class Case:
    """Problem among boxes.

    Attributes:
        name: robot and number.
        start, goal: (n,) configurations.
        boxes: as obstacles of a request.
        checker: of poses, with ``TREE_CLEAR_M``.
    """

    name: str
    start: Float[np.ndarray, "n"]
    goal: Float[np.ndarray, "n"]
    boxes: list[dict[str, Any]]
    checker: PoseChecker


@dataclass(frozen=True)
class Arm:
    """Robot of the benchmark."""

    name: str
    section: dict[str, Any]
    robot: RobotModel
    checked: RobotModel  # leaves out only the pairs that a certificate may leave out
    engine: KinematicsEngine
    link: str

    @staticmethod
    def load(name: str, folder: Path) -> Arm:
        """Load a robot of ``ROBOTS``; ``folder`` holds the package."""
        urdf, srdf, link = ROBOTS[name]
        robots = folder / "example-robot-data" / "robots"
        bare: dict[str, Any] = {"urdf": str(robots / urdf), "package_dirs": [str(folder)]}
        section = bare if srdf is None else {**bare, "srdf": str(robots / srdf)}
        robot, alone = (
            load_requested_robot(parse_request({"robot": made, "goal": {"joints": {"any": 0.0}}}))
            for made in (section, bare)
        )
        checked = replace(robot, ignored_pairs=robot.ignored_pairs & alone.ignored_pairs)
        return Arm(name, section, robot, checked, KinematicsEngine(robot), link)

    def draw(self, rng: np.random.Generator) -> Float[np.ndarray, "n"]:
        """Return a random configuration within the limits and a turn."""
        lower, upper = np.maximum(self.robot.lower, -np.pi), np.minimum(self.robot.upper, np.pi)
        return np.asarray(lower + rng.uniform(0.05, 0.95, self.robot.n) * (upper - lower))

    def make_request(self, case: Case, goal: dict[str, Any], time_limit_s: float = TIME_LIMIT_S) -> PlanRequest:
        """Return a case with its goal in joints or as a pose."""
        return parse_request({
            "robot": self.section,
            "start": {"joints": dict(zip(self.robot.joint_names, case.start.tolist(), strict=True))},
            "scene": {"obstacles": case.boxes},
            "goal": goal,
            "options": {"time_limit_s": time_limit_s, "timed": False},
        })  # fmt: skip

    def list_goals(self, case: Case) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the two goals of a case by name."""
        yield "joints", {"joints": dict(zip(self.robot.joint_names, case.goal.tolist(), strict=True))}
        place = locate_links(self.engine, case.goal, [self.link])[self.link]
        quaternion = Rotation.from_matrix(place[:3, :3]).as_quat(scalar_first=True)
        pose = {"link": self.link, "position": place[:3, 3].tolist(), "quaternion_wxyz": quaternion.tolist()}
        yield "pose", {"poses": [pose]}


def draw_cases(arm: Arm, seed: int) -> Iterator[Case]:
    """Yield cases without end, the same for the same seed."""
    rng = np.random.default_rng([seed, sum(arm.name.encode())])
    alone = make_checker(arm.checked, Scene(()), CLEAR_M)
    reach = max(
        float(np.linalg.norm(locate_links(arm.engine, arm.draw(rng), [arm.link])[arm.link][:3, 3])) for _ in range(300)
    )
    number = 0
    while True:
        start, goal = (draw_clear(arm, alone, rng) for _ in range(2))
        boxes = draw_boxes(arm, start, goal, reach, rng)
        checker = make_checker(arm.checked, make_scene(arm, boxes), TREE_CLEAR_M)
        if is_edge_clear(arm, checker, start, goal):
            continue
        yield Case(f"{arm.name}/{number}", start, goal, boxes, checker)
        number += 1


def draw_clear(arm: Arm, checker: PoseChecker, rng: np.random.Generator) -> Float[np.ndarray, "n"]:
    """Return a random configuration without a collision."""
    for _ in range(2000):
        q = arm.draw(rng)
        if checker.are_clear(q[None]):
            return q
    sys.exit(f"{arm.name}: no configuration without self-collision was found; links overlap at rest")


def draw_boxes(
    arm: Arm, start: Float[np.ndarray, "n"], goal: Float[np.ndarray, "n"], reach: float, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """Return boxes within reach that keep clear of start and goal."""
    boxes: list[dict[str, Any]] = []
    ends = np.stack([start, goal])
    while len(boxes) < N_BOXES:
        way = rng.normal(size=3)
        way[2] = abs(way[2]) if way[2] < -0.3 * np.linalg.norm(way) else way[2]
        turn = rng.normal(size=4)
        box = {
            "name": f"box{len(boxes)}",
            "type": "box",
            "size": (reach * rng.uniform(*SIZES, 3)).tolist(),
            "position": (reach * rng.uniform(*PLACES) * way / np.linalg.norm(way)).tolist(),
            "quaternion_wxyz": (turn / np.linalg.norm(turn)).tolist(),
        }
        if make_checker(arm.checked, make_scene(arm, [box]), CLEAR_M).are_clear(ends):
            boxes.append(box)
    return boxes


def make_scene(arm: Arm, boxes: Sequence[dict[str, Any]]) -> Scene:
    """Return boxes of a request as the planner sees them."""
    request = parse_request(
        {"robot": arm.section, "scene": {"obstacles": list(boxes)}, "goal": {"joints": {"any": 0.0}}}
    )
    pieces: tuple[ConvexPiece, ...] = build_obstacles(request)[0]
    return Scene(pieces)


def make_checker(robot: RobotModel, scene: Scene, margin: float) -> PoseChecker:
    """Return a checker of poses with one margin for all pairs [m]."""
    return PoseChecker(KinematicsEngine(robot), scene, PairMargins.of(robot, scene, margin))


def is_edge_clear(arm: Arm, checker: PoseChecker, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]) -> bool:
    """Return whether poses ``TREE_EDGE`` apart on a straight line are clear."""
    count = max(int(np.ceil(np.abs(last - first).max() / TREE_EDGE)), 1)
    poses = first + (np.arange(1, count + 1) / count)[:, None] * (last - first)
    # In parts of growing length: an edge in collision mostly ends at once.
    return all(checker.are_clear(part) for part in np.array_split(poses, max(count // 8, 1)))


def connect(arm: Arm, case: Case, seed: int) -> bool:
    """Return whether RRT-Connect joins start and goal within ``TREE_LIMIT_S``."""
    rng = np.random.default_rng(seed)
    near, far = [case.start], [case.goal]
    deadline = time.process_time() + TREE_LIMIT_S

    def extend(tree: list[np.ndarray], target: np.ndarray) -> bool | None:
        """Take one step towards a target: True where it is reached, None where the step is blocked."""
        gaps = np.linalg.norm(np.array(tree) - target, axis=1)
        nearest, gap = tree[int(gaps.argmin())], float(gaps.min())
        step = target if gap <= TREE_STEP else nearest + TREE_STEP / gap * (target - nearest)
        if not is_edge_clear(arm, case.checker, nearest, step):
            return None
        tree.append(step)
        return gap <= TREE_STEP

    while time.process_time() < deadline:
        if extend(near, arm.draw(rng)) is not None:
            target = near[-1]
            while (reached := extend(far, target)) is False:
                pass
            if reached:
                return True
        near, far = far, near
    return False


@dataclass(frozen=True)
class Run:
    """One plan."""

    result: PlanResult
    cpu_s: float

    @property
    def is_certified(self) -> bool:
        return self.result.verdict is Verdict.CERTIFIED

    @property
    def has_goal(self) -> bool:
        """Whether a configuration at the goal was found."""
        return self.is_certified or self.result.found_from != "goal pose"

    @property
    def line(self) -> str:
        result = self.result
        reason = next(iter(result.explanation), "") if result.conflict is None else result.conflict.brief
        return f"{result.verdict.value} {result.found_from} {'' if self.is_certified else reason}"


def measure(arm: Arm, case: Case, goal: dict[str, Any], time_limit_s: float = TIME_LIMIT_S) -> Run:
    """Plan one case."""
    request = arm.make_request(case, goal, time_limit_s)
    began = time.process_time()
    result = plan(request, robot=arm.robot)
    return Run(result, time.process_time() - began)


def summarize(name: str, goal: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return one row of the table."""
    cpu, n = [run.cpu_s for run in runs], len(runs)
    certified, found = (sum(made) for made in ([r.is_certified for r in runs], [r.has_goal for r in runs]))
    shares = (f"{count} ({100.0 * count / n:.0f} %, target {100.0 * LEAST_SHARE:.0f})" for count in (certified, found))
    return (name, goal, str(n), *shares, f"{statistics.median(cpu):.2f}", f"{np.percentile(cpu, 95):.2f}",
            f"{max(cpu):.1f}")  # fmt: skip


def main() -> None:
    """Print a table, and every plan that was not certified."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS))
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, help="of a plan [s]")
    parser.add_argument("--folder", type=Path, default=None, help="holds the package example-robot-data")
    parser.add_argument("--each", action="store_true", help="a line for every plan")
    given = parser.parse_args()
    folder = given.folder or find_data_folder()
    if folder is None:
        sys.exit("example-robot-data is not installed; pip install 'scopt[robots]'")
    rows = []
    for name in given.robots:
        arm = Arm.load(name, folder)
        runs: dict[str, list[Run]] = {"joints": [], "pose": []}
        unsolved = 0
        for number, case in enumerate(draw_cases(arm, given.seed)):
            if number == given.cases:
                break
            is_solved = connect(arm, case, given.seed)
            unsolved += not is_solved
            for kind, goal in arm.list_goals(case) if is_solved else ():
                run = measure(arm, case, goal, given.time_limit)
                runs[kind].append(run)
                if given.each or not run.is_certified:
                    print(f"  {case.name} {kind}: {run.cpu_s:.2f} s {run.line}", flush=True)
        print(f"  {name}: RRT-Connect did not solve {unsolved} of {given.cases} cases", flush=True)
        rows += [summarize(name, kind, made) for kind, made in runs.items() if made]
    print_table(f"Arms among {N_BOXES} boxes, straight line blocked, time limit {given.time_limit:g} s", COLUMNS, rows)


if __name__ == "__main__":
    main()
