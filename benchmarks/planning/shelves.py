"""Stock PR2 among a bookshelf and a table: how many reaches of the right arm are certified, and their processor time.

    python -m benchmarks.planning.shelves [--count 20] [--seed 0]

Problems are drawn as those of Schulman et al., IJRR 2014, sec. VIII: from one collision-free configuration of seven
joints to another, in a shelf or above and below a table.  The robot is that of the package example-robot-data with its
SRDF; the base stands, and the other joints are locked.  Each problem is a request of its own; the robot is loaded once.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.planning.robots import find_data_folder

if TYPE_CHECKING:
    from costs.robot import RobotModel

# Links of the URDF without a collision shape that are more than frames.
DRAWN = [
    *(f"{end}_caster_{side}_wheel_link" for end in ("bl", "br", "fl", "fr") for side in "lr"),
    "base_footprint", "sensor_mount_link", "narrow_stereo_link", "wide_stereo_link", "l_wrist_roll_link",
    "r_wrist_roll_link",
]  # fmt: skip
LOCKED = {
    "torso_lift_joint": 0.2, "head_pan_joint": 0.0, "head_tilt_joint": 0.0, "laser_tilt_mount_joint": 0.0,
    "l_shoulder_pan_joint": 1.5, "l_shoulder_lift_joint": 0.8, "l_upper_arm_roll_joint": 1.0,
    "l_elbow_flex_joint": -1.5, "l_forearm_roll_joint": 0.0, "l_wrist_flex_joint": -0.5, "l_wrist_roll_joint": 0.0,
    "l_gripper_l_finger_joint": 0.1, "r_gripper_l_finger_joint": 0.1,
}  # fmt: skip
LOW, HIGH = np.array([0.45, -0.75, 0.35]), np.array([0.95, 0.25, 1.45])  # where the hand begins and ends [m]
APART_RAD = 1.0  # between start and goal, of some joint


def make_robot() -> dict[str, Any]:
    """Return the robot's part of the requests.

    Raises:
        SystemExit: the package example-robot-data is not installed.
    """
    folder = find_data_folder()
    if folder is None:
        sys.exit("example-robot-data is not installed; pip install 'scopt[robots]'")
    data = folder / "example-robot-data" / "robots" / "pr2_description"
    return {
        "urdf": str(data / "urdf" / "pr2.urdf"),
        "srdf": str(data / "srdf" / "pr2.srdf"),
        "package_dirs": [str(folder)],
        "drawn_links": DRAWN,
        "locked": LOCKED,
        "torque": {"check": False},  # springs carry the arms
    }


def _box(name: str, size: list[float], position: list[float]) -> dict[str, Any]:
    return {"type": "box", "name": name, "size": size, "position": position}


SHELF = [
    *(_box(f"board_{k}", [0.3, 1.1, 0.02], [0.85, -0.25, z]) for k, z in enumerate((0.3, 0.65, 1.0, 1.35))),
    *(_box(f"side_{k}", [0.3, 0.02, 1.5], [0.85, y, 0.75]) for k, y in enumerate((-0.8, -0.25, 0.3))),
    _box("back", [0.02, 1.1, 1.5], [1.01, -0.25, 0.75]),
]
TABLE = [
    _box("top", [0.7, 1.4, 0.04], [0.85, -0.2, 0.72]),
    *(_box(f"leg_{k}", [0.05, 0.05, 0.7], [x, y, 0.35]) for k, (x, y) in enumerate(((0.55, -0.85), (0.55, 0.45)))),
    _box("box", [0.15, 0.15, 0.25], [0.75, -0.25, 0.865]),
    _box("tin", [0.1, 0.1, 0.15], [0.65, 0.1, 0.815]),
]
SCENES = {"bookshelf": SHELF, "table": TABLE}


def draw_problems(
    robot: RobotModel, data: dict[str, Any], count: int, seed: int
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield names of scenes and requests, one scene after the other."""
    from costs.scene import Scene
    from service.request.file import parse_request
    from service.setup.world import build_obstacles
    from service.start.overlaps import find_overlaps
    from service.verify import place_frames

    rng = np.random.default_rng(seed)
    names = list(SCENES)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    for k in range(count):
        scene = {"floor": 0.0, "obstacles": SCENES[names[k % 2]]}
        parsed = parse_request({"robot": data, "scene": scene, "goal": {"joints": {robot.joint_names[0]: 0.0}}})
        world = Scene(build_obstacles(parsed)[0])
        ends: list[np.ndarray] = []
        while len(ends) < 2:
            q = rng.uniform(lower, upper)
            place = place_frames(robot, q, ["r_gripper_palm_link"])["r_gripper_palm_link"][:3, 3]
            is_there = bool(np.all((place > LOW) & (place < HIGH)))
            is_another = not ends or bool(np.abs(q - ends[0]).max() > APART_RAD)
            if is_there and is_another and not find_overlaps(robot, q, world, ()):
                ends.append(q)
        start, goal = (dict(zip(robot.joint_names, q.tolist(), strict=True)) for q in ends)
        yield names[k % 2], {"robot": data, "start": {"joints": start}, "scene": scene, "goal": {"joints": goal}}


def main() -> None:
    """Print one line per problem and the sums."""
    from service.planner import plan
    from service.request.file import parse_request
    from service.start.robot import load_requested_robot

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    data = make_robot()
    robot = load_requested_robot(parse_request({"robot": data, "goal": {"joints": {"any": 0.0}}}))
    seconds, verdicts = [], []
    for name, request in draw_problems(robot, data, arguments.count, arguments.seed):
        started = time.process_time()
        result = plan(parse_request(request), robot=robot)
        seconds.append(time.process_time() - started)
        verdicts.append(result.verdict.value)
        words = "" if verdicts[-1] == "CERTIFIED" else " ".join(result.explanation)[:200]
        print(f"{name:10} {verdicts[-1]:20} {seconds[-1]:6.2f} s  {words}", flush=True)
    certified = verdicts.count("CERTIFIED")
    print(f"{certified} of {len(verdicts)} certified; median {np.median(seconds):.2f} s, longest {max(seconds):.2f} s")


if __name__ == "__main__":
    main()
