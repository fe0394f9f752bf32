"""Poses and sequences of getting out of the shipped vehicle.

``python -m benchmarks.tasks.egress [--samples N] [--sequences K] [--seed S]``

Poses are solved from one cold start per drawn place.  Then complete sequences are chosen and linked: kept contacts
become the same points, and the poses between stances are solved.  The last table compares joint-torque limits as
constraints with the loop of Liu et al., Humanoids 2015: solve without them, compute torques, reweight, solve again.
Times are of the processor.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from costs.robot import RobotModel
from costs.scene import ConvexPiece, Scene
from service.body.forces.equilibrium_pose import EquilibriumPose
from service.demands.egress.demand import load_phases
from service.request.file import load_request
from service.request.tasks.egress import EgressRequest
from service.setup.world import build_obstacles
from service.start.robot import load_requested_robot
from service.tasks.egress.plan import PoseSet, find_sequences, make_all_stages, make_graph, solve_poses
from service.tasks.egress.poses import PoseSolver
from service.tasks.egress.stages import EgressStage

REQUEST = Path(__file__).resolve().parents[2] / "examples" / "requests" / "egress_model.yaml"
SAMPLES, SEQUENCES = 50, 12
GROUND_M = 3.0  # half the side of the ground
TIGHT_SHARE = 0.35  # of the torque limits, so that they bind
REWEIGHTS, REWEIGHT = 4, 5.0  # how often the paper's loop solves again, and by what its weights grow


def load_car() -> tuple[RobotModel, Scene, EgressRequest]:
    """Return the robot, the car on its ground, and the task of the shipped request."""
    request = load_request(REQUEST)
    assert request.task is not None
    assert request.task.egress is not None
    pieces, _ = build_obstacles(request)
    corners = np.array([[x, y, z] for x in (-GROUND_M, GROUND_M) for y in (-GROUND_M, GROUND_M) for z in (-0.1, 0.0)])
    return load_requested_robot(request), Scene((*pieces, ConvexPiece("ground", corners, "floor"))), request.task.egress


class TimedMap:
    """A serial map that records the processor time of each pose by its stage."""

    def __init__(self) -> None:
        self.cpu: list[tuple[int, bool, float]] = []

    def __call__(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        for item in items:
            started = time.process_time()
            pose = function(item)
            self.cpu.append((item[0], pose.is_feasible, time.process_time() - started))
            yield pose


def report_poses(stages: tuple[EgressStage, ...], poses: PoseSet, timed: TimedMap) -> None:
    """Print one row per stage, and the whole."""
    rows = []
    for count in poses.counts:
        k = next(i for i, stage in enumerate(stages) if stage.name == count.name)
        every = [cpu for stage, _, cpu in timed.cpu if stage == k]
        good = [cpu for stage, is_feasible, cpu in timed.cpu if stage == k and is_feasible]
        held = [node.pose for node in poses.nodes if node.stage == k]
        rows.append(
            (
                count.name,
                str(count.solved),
                f"{100.0 * count.feasible / count.solved:.0f} %",
                str(count.duplicates),
                f"{statistics.median(good) if good else np.nan:.2f}",
                f"{max(every):.2f}",
                f"{100.0 * max((pose.torque_share for pose in held), default=np.nan):.0f} %",
                f"{statistics.median([pose.reserve_n for pose in held]) if held else np.nan:.1f}",
            )
        )
    header = (
        "stage", "poses", "feasible", "duplicates", "median of feasible [s]", "largest [s]", "torque", "reserve [N]",
    )  # fmt: skip
    print_table("Poses in equilibrium, one cold start each", header, rows)
    feasible = [cpu for _, is_feasible, cpu in timed.cpu if is_feasible]
    total = sum(cpu for _, _, cpu in timed.cpu)
    print(f"  {len(timed.cpu)} poses in {total:.1f} s; median of the feasible {statistics.median(feasible):.2f} s")


def report_sequences(solver: PoseSolver, poses: PoseSet, count: int) -> None:
    """Print one row per complete sequence."""
    started = time.process_time()
    graph = make_graph(solver, poses)
    path = graph.find_sequence()
    spent = time.process_time() - started
    print(f"\n  graph of {len(poses.nodes)} poses and its cheapest sequence: {1e3 * spent:.1f} ms")
    if path is None:
        return
    rows, rejected = [], 0
    started = time.process_time()
    for k, found in enumerate(find_sequences(solver, poses, 2 * count)):
        named = [pose for _, pose in found.chain.list_poses()]
        residual = max(float(max(pose.result.violation.get(name, 0.0) for name in places(pose))) for pose in named)
        rows.append(
            (
                str(k + 1),
                f"{found.cost:.1f}",
                f"{1e3 * found.slip_m:.1f}",
                str(len(named)),
                f"{residual:.0e}",
                f"{100.0 * max(pose.torque_share for pose in named):.0f} %",
                f"{min(pose.reserve_n for pose in named):.1f}",
                f"{time.process_time() - started:.1f}",
            )
        )
        rejected = len(found.rejected)
        if len(rows) == count:
            break
        started = time.process_time()
    header = (
        "sequence", "cost", "slip before linking [mm]", "poses", "contact residual [m]", "torque", "reserve [N]",
        "CPU [s]",
    )  # fmt: skip
    print_table("Complete sequences, linked", header, rows)
    print(f"  {len(rows)} complete, {rejected} could not be linked")


def places(pose: EquilibriumPose) -> list[str]:
    """Return the names of the constraints that put contacts in their places."""
    return [name for name in pose.result.violation if name.endswith((": place", ": plane"))]


def solve_by_reweighting(solver: PoseSolver, stage: EgressStage, share: float) -> tuple[EquilibriumPose, bool]:
    """Solve as Liu et al. do, and return the pose and whether its torques are within a share of the limits."""
    free = replace(solver, torque_share=None)
    shape = stage.shapes[0]
    pose = free.solve(stage.aims, shape)
    for _ in range(REWEIGHTS):
        if not pose.is_feasible or pose.torque_share <= share:
            break
        weights = shape.weights
        heavier = replace(weights, torso=REWEIGHT * weights.torso, hand_forces=REWEIGHT * weights.hand_forces)
        shape = replace(shape, weights=heavier)
        pose = free.solve(stage.aims, shape, pose.q)
    return pose, pose.is_feasible and pose.torque_share <= share


def compare_with_reweighting(solver: PoseSolver, all_stages: tuple[tuple[EgressStage, ...], ...]) -> None:
    """Print how often and how fast both ways keep torque limits that bind."""
    rows = []
    for k, stage in enumerate(all_stages[0]):
        if not stage.is_sampled:
            continue
        tight = replace(solver, torque_share=TIGHT_SHARE)
        started = time.process_time()
        by_limits = sum(tight.solve(stages[k].aims, stages[k].shapes[0]).is_feasible for stages in all_stages)
        middle = time.process_time()
        by_loop = sum(solve_by_reweighting(solver, stages[k], TIGHT_SHARE)[1] for stages in all_stages)
        count, end = len(all_stages), time.process_time()
        rows.append(
            (
                stage.name,
                f"{by_limits}/{count}", f"{(middle - started) / count:.2f}",
                f"{by_loop}/{count}", f"{(end - middle) / count:.2f}",
            )
        )  # fmt: skip
    header = ("stage", "limits as constraints", "mean [s]", "reweighting", "mean [s]")
    print_table(f"Joint torques within {100.0 * TIGHT_SHARE:.0f} % of their limits", header, rows)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    parser.add_argument("--sequences", type=int, default=SEQUENCES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    robot, scene, task = load_car()
    task = replace(task, samples=given.samples)
    all_stages = make_all_stages(robot, scene, task, load_phases(task, robot), given.seed)
    solver, timed = PoseSolver.of(robot, scene, task.torque_share, task.margin_n), TimedMap()
    poses = solve_poses(solver, all_stages, timed)
    report_poses(all_stages[0], poses, timed)
    report_sequences(solver, poses, given.sequences)
    compare_with_reweighting(solver, all_stages[:10])


if __name__ == "__main__":
    main()
