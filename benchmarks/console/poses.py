"""Poses that are led by hand on Atlas: ``python -m benchmarks.console.poses [--repeat N]``.

Drags in steps of 1 cm before the scan of a door (``scenes/door_a`` of the folder ``SCOPT_DATA``, by default
``../shared/data``; without it, before a wall): processor time from event to checked pose, largest step of a joint,
bytes of an answer, how often the verifier refused what the optimiser proposed. The last column counts poses that the
whole certificate of a motion at rest, made anew, does not certify.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.tables import print_table
from costs.curve import Curve, TimeLaw
from costs.kinematics import locate_links
from service.demands.stance import Stance, make_standing_allowances
from service.posing.drag import Drag, DragTarget, StopKind
from service.posing.ground import PoseGround
from service.posing.numbers import PoseNumbers
from service.posing.reading import read_pose
from service.posing.session import PoseSession
from service.posing.world import PoseWorld
from service.request.file import parse_request
from service.start.robot import load_requested_robot
from service.verify import Motion, Phase, Status, verify
from service.wire.poses import pose_to_message

ROOT = Path(__file__).resolve().parents[2]
STEP_M = 0.01
WALL = {"type": "box", "name": "wall", "size": [0.1, 3.0, 2.0], "position": [0.75, 0.0, 1.0]}
COLUMNS = (
    "drag", "events", "CPU median [ms]", "p95", "worst", "joint step [rad]", "bytes", "stopped", "refused",
    "uncertified",
)  # fmt: skip


@dataclass(frozen=True)
class DragCase:
    """A drag: the way of each link for a centimetre of the drag.

    Attributes:
        name: of the row.
        ways: direction by link.
        events: of the drag, one a centimetre.
        turns: whether links keep their orientations.
    """

    name: str
    ways: Mapping[str, Sequence[float]]
    events: int = 57
    turns: bool = False


CASES = (
    DragCase("right hand into the door", {"r_hand": (1.0, 0.0, 0.0)}, turns=True),
    DragCase("right hand up", {"r_hand": (0.0, -0.3, 0.95)}),
    DragCase("left hand beyond reach", {"l_hand": (-0.3, 0.95, 0.0)}, 100),
    DragCase("pelvis down", {"pelvis": (0.0, 0.0, -1.0)}),
    DragCase("torso to the side", {"utorso": (0.2, 0.98, 0.0)}),
    DragCase(
        "hands, pelvis and torso together",
        {"l_hand": (0.9, 0.3, 0.2), "r_hand": (0.7, 0.0, 0.7), "pelvis": (0.0, 0.3, -0.5), "utorso": (0.3, 0.2, -0.5)},
    ),
)


def make_world() -> tuple[PoseWorld, PoseNumbers]:
    """Return Atlas before the scanned door, or a wall, and its first pose."""
    cloud = Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data")) / "scenes" / "door_a" / "scan0.pcd"
    scene: dict[str, Any] = {"cloud": str(cloud)} if cloud.is_file() else {"obstacles": [WALL]}
    request = parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "scene": scene})
    robot = load_requested_robot(request)
    ground = PoseGround.of(request, robot, lambda: False)
    assert ground is not None  # nobody stops it
    return ground.make_world(robot), ground.start


def run_case(world: PoseWorld, start: PoseNumbers, case: DragCase) -> tuple[list[str], list[float]]:
    """Return the row of a drag, and its processor times [ms]."""
    session = PoseSession(world, start)
    here = locate_links(world.body.engine, world.body.nominal, list(case.ways))
    times, steps, sizes = list[float](), list[float](), list[int]()
    stopped = refused = uncertified = 0
    for k in range(1, case.events + 1):
        drag = Drag(tuple(_place(link, here[link], np.asarray(way), k, case) for link, way in case.ways.items()))
        before, began = session.pose.numbers, time.process_time()
        pose = session.drag(drag)
        times.append(1e3 * (time.process_time() - began))
        steps.append(float(np.abs(np.subtract(pose.numbers.positions, before.positions)).max()))
        sizes.append(pose_to_message(pose, k, k, 1, 0).ByteSize())
        stopped += bool(pose.stops)
        refused += any(stop.kind is StopKind.REFUSED for stop in pose.stops)
        uncertified += not is_certified(world, pose.numbers)
    figures = [f"{value:.1f}" for value in (np.median(times), np.percentile(times, 95), max(times))]
    counts = [str(stopped), str(refused), str(uncertified)]
    return [case.name, str(case.events), *figures, f"{max(steps):.3f}", str(max(sizes)), *counts], times


def _place(link: str, here: np.ndarray, way: np.ndarray, k: int, case: DragCase) -> DragTarget:
    x, y, z = (here[:3, 3] + STEP_M * k * way / np.linalg.norm(way)).tolist()
    if not case.turns:
        return DragTarget(link, (x, y, z))
    qw, qx, qy, qz = Rotation.from_matrix(here[:3, :3]).as_quat(scalar_first=True).tolist()
    return DragTarget(link, (x, y, z), (qw, qx, qy, qz))


def is_certified(world: PoseWorld, numbers: PoseNumbers) -> bool:
    """Return whether the whole certificate of a motion that rests at a pose holds, from promises made anew."""
    robot, body = world.robot, world.body
    q = read_pose(robot, numbers)
    feet = [contact.link for contact in body.planted]
    stance = Stance.of(robot, body.nominal, feet, body.aims.balance_margin, robot.can_balance)
    support, touching = (
        stance.support("pose", body.nominal),
        make_standing_allowances(body.robot, stance.contacts, body.scene),
    )
    phase = Phase("pose", 0.0, 1.0, contacts=stance.contacts, support=support, allowances=touching)
    curve = Curve(np.array([0.0, 1.0]), np.stack([q, q]), np.zeros((2, len(q))))
    law = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.ones(2))
    return verify(Motion(robot, body.scene, curve, law, (phase,))).status is Status.CERTIFIED


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=1, help="runs of each drag, of which the quickest counts")
    repeat = max(1, parser.parse_args().repeat)
    world, start = make_world()
    world.verifier.check(world.body.nominal)
    PoseSession(world, start).drag(Drag((DragTarget("r_hand", (0.33, -0.41, 0.8)),)))  # what is made once
    rows = []
    for case in CASES:
        runs = [run_case(world, start, case) for _ in range(repeat)]
        rows.append(min(runs, key=lambda run: sum(run[1]))[0])
    print_table(f"Atlas, {len(world.body.scene.pieces)} pieces, steps of 1 cm", COLUMNS, rows)
    target = Drag((DragTarget("r_hand", (0.35, -0.41, 0.82)),))
    began = time.process_time()
    for _ in range(50):
        world.preview(start, target)
    print(f"  preview by damped least squares: {20.0 * (time.process_time() - began):.1f} ms")


if __name__ == "__main__":
    main()
