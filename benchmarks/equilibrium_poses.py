"""Atlas in static equilibrium on feet and hands: contact forces as variables of the optimiser.

``python -m benchmarks.equilibrium_poses [--guesses N] [--seed S]``

Each pose is solved from ``N`` perturbed standing postures.  Processor time is of one call, from the guess to the pose
with its exact forces.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.tables import print_table
from costs.contact import Contact
from costs.contact_points import Load
from costs.robot import RobotModel, load_robot
from costs.scene import Scene
from costs.state import MotionState
from costs.terms import CentreOfMassAt, ContactPlace
from scopt import Constraint, Sense
from service.body.equilibrium_pose import ForceLimits, make_planted_contacts, solve_equilibrium_pose
from service.body.whole_body import Aims, WholeBody

FEET = ("l_foot", "r_foot")
FRICTION = 0.7
FOOT_CAP_N, HAND_CAP_N = 2000.0, 600.0
BAR_X, BAR_Y, BAR_Z = 0.75, 0.3, 0.9  # where the hands hold a bar [m]
GUESSES = 5
JOINT_SPREAD = 0.05  # standard deviation of guesses [rad]
COLUMNS = (
    "pose", "force variables", "held", "steps", "CPU median [ms]", "CPU largest [ms]", "most loaded joint", "share",
    "reserve [N]", "misfit [N, N m]",
)  # fmt: skip
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Case:
    """A pose to solve.

    Attributes:
        name: for the table.
        feet, hands: that touch: planted soles, and tools on the bar.
        ahead: x of the centre of mass [m]; anywhere if None.
        limits: of the forces.
    """

    name: str
    feet: tuple[str, ...] = FEET
    hands: tuple[str, ...] = ()
    ahead: float | None = None
    limits: ForceLimits = field(default_factory=ForceLimits)


BOTH = ("l_tool", "r_tool")
CASES = (
    Case("two feet, centre of mass moved 7 cm", ahead=0.07),
    Case("two feet, both hands on a bar, centre of mass 35 cm ahead", hands=BOTH, ahead=0.35),
    Case("the same without torque limits", hands=BOTH, ahead=0.35, limits=ForceLimits(torque_share=None)),
    Case(
        "two feet, right hand pushes 80 N",
        limits=ForceLimits(loads=(Load("r_tool", np.array([-80.0, 0.0, 0.0])),)),
    ),
    Case("left foot, both hands on a bar", feet=("l_foot",), hands=BOTH),
    Case("two feet, both hands on a bar, centre of mass 1.5 m ahead", hands=BOTH, ahead=1.5),
)


def make_terms(robot: RobotModel, case: Case) -> tuple[list[Contact], list[Constraint[MotionState]]]:
    """Return the hands' contacts, and constraints that put hands and centre of mass in their places."""
    contacts, constraints = [], []
    for hand in case.hands:
        contacts.append(Contact(hand, np.zeros((1, 3)), UP[None], FRICTION, HAND_CAP_N))
        place = np.array([[BAR_X, BAR_Y if hand.startswith("l") else -BAR_Y, BAR_Z]])
        on_bar = ContactPlace.at(robot, hand, np.zeros((1, 3)), [0], place)
        constraints.append(Constraint(f"{hand} on the bar", on_bar, Sense.EQUAL_ZERO, 1e-4, unit="m"))
    if case.ahead is not None:
        moved = CentreOfMassAt(np.array([case.ahead, 0.0]), [0])
        constraints.append(Constraint("centre of mass", moved, Sense.EQUAL_ZERO, 1e-3, unit="m"))
    return contacts, constraints


def run(robot: RobotModel, case: Case, n_guesses: int, seed: int) -> tuple[str, ...]:
    """Return one row of the table."""
    stand = robot.postures["stand"]
    body = WholeBody.standing(robot, Scene(()), stand, case.feet, Aims())
    hands, constraints = make_terms(robot, case)
    contacts = (*make_planted_contacts(body, FRICTION, FOOT_CAP_N), *hands)
    bar = dict.fromkeys(range(len(contacts) - len(hands), len(contacts)), UP)
    limits = replace(case.limits, world_normals=bar)
    rng = np.random.default_rng(seed)
    poses, cpu = [], []
    for _ in range(n_guesses):
        guess = stand + np.concatenate([np.zeros(6), JOINT_SPREAD * rng.normal(size=robot.n - 6)])
        started = time.process_time()
        poses.append(solve_equilibrium_pose(body, contacts, guess, limits, constraints=constraints))
        cpu.append(1e3 * (time.process_time() - started))
    for line in sorted({line for pose in poses for line in pose.violations}):
        print(f"  {case.name}: {line}")
    steps: Sequence[int] = [len(pose.result.history) for pose in poses]
    worst = max(poses, key=lambda pose: pose.torque_share)
    return (
        case.name,
        str(3 * len(poses[0].forces_n)),
        f"{sum(pose.is_feasible for pose in poses)}/{n_guesses}",
        f"{min(steps)}-{max(steps)}",
        f"{statistics.median(cpu):.0f}",
        f"{max(cpu):.0f}",
        worst.most_loaded_joint,
        f"{100.0 * worst.torque_share:.1f} %",
        f"{min(pose.reserve_n for pose in poses):.1f}",
        f"{max(pose.misfit_n for pose in poses):.0e}",
    )


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--guesses", type=int, default=GUESSES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    robot = load_robot("atlas")
    rows = [run(robot, case, given.guesses, given.seed) for case in CASES]
    print_table("Atlas in static equilibrium", COLUMNS, rows)


if __name__ == "__main__":
    main()
