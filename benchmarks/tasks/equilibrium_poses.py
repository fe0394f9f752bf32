"""Atlas in static equilibrium on feet, hands and hip: contact forces as variables of the optimiser.

``python -m benchmarks.tasks.equilibrium_poses [--guesses N] [--seed S]``

Each pose is solved from ``N`` perturbed standing postures.  Processor time is of one call, from the guess to the pose
with its exact forces.  The last row draws a new place of the bar and of the centre of mass for every guess.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from benchmarks.tables import print_table
from costs.contact import Contact
from costs.contact_points import Load
from costs.robot import RobotModel, load_robot
from costs.scene import Scene
from costs.state import MotionState
from costs.terms import CentreOfMassAt, ContactPlace
from scopt import Constraint, Sense
from service.body.aims import Aims
from service.body.forces.equilibrium_pose import (
    EquilibriumPose,
    ForceLimits,
    make_planted_contacts,
    solve_equilibrium_pose,
)
from service.body.whole_body import WholeBody

FEET, TOOLS = ("l_foot", "r_foot"), ("l_tool", "r_tool")
FRICTION = 0.7
FOOT_CAP_N, HAND_CAP_N, RAIL_CAP_N, HIP_CAP_N = 2000.0, 600.0, 300.0, 1000.0  # of each contact point
BAR = (0.75, 0.3, 0.9)  # where the hands hold it: x, +-y, z [m]
SEAT_M, STEP_M = 0.7, -0.1  # heights of the seat and of the step beside the floor
PLACE_TOLERANCE_M, BALANCE_TOLERANCE_M = 1e-4, 1e-3
GUESSES = 5
JOINT_SPREAD = 0.05  # standard deviation of guesses [rad]
COLUMNS = (
    "pose", "force variables", "held", "steps", "CPU median [ms]", "CPU largest [ms]", "torque used", "needed",
    "reserve [N]", "misfit [N, N m]",
)  # fmt: skip
UP = np.array([0.0, 0.0, 1.0])
ORIGIN = np.zeros((1, 3))


@dataclass
class Stance:
    """A pose to solve: the body, contacts with their normals in the world, and what puts them in their places."""

    body: WholeBody
    contacts: list[Contact]
    places: list[Constraint[MotionState]] = field(default_factory=list)
    normals: dict[int, Float[np.ndarray, "3"]] = field(default_factory=dict)

    @staticmethod
    def on_feet(robot: RobotModel, feet: Sequence[str]) -> Stance:
        """Return a robot that stands on planted feet."""
        body = WholeBody.standing(robot, Scene(()), robot.postures["stand"], feet, Aims())
        return Stance(body, list(make_planted_contacts(body, FRICTION, FOOT_CAP_N)))

    def touch(self, link: str, points: Float[np.ndarray, "C 3"], normal: Float[np.ndarray, "3"], cap_n: float) -> None:
        """Add a contact whose normal is fixed in the world."""
        self.normals[len(self.contacts)] = normal
        self.contacts.append(Contact(link, points, np.tile(UP, (len(points), 1)), FRICTION, cap_n))

    def hold(self, link: str, place: Sequence[float], cap_n: float, normal: Float[np.ndarray, "3"] = UP) -> None:
        """Add a contact of a link's origin at a place."""
        self.touch(link, ORIGIN, normal, cap_n)
        term = ContactPlace.at(self.body.robot, link, ORIGIN, [0], np.array([place]))
        self.places.append(Constraint(f"{link} in its place", term, Sense.EQUAL_ZERO, PLACE_TOLERANCE_M, unit="m"))

    def rest(
        self, link: str, points: Float[np.ndarray, "C 3"], height: float, box: Sequence[float], cap_n: float
    ) -> None:
        """Add a contact of points anywhere on a level patch: a box of least x, most x, least y, most y [m]."""
        self.touch(link, points, UP, cap_n)
        robot = self.body.robot
        offsets = np.array([box[1], -box[0], box[3], -box[2]])
        edges = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
        level = ContactPlace.on_plane(robot, link, points, [0], UP, height)
        inside = ContactPlace.inside(robot, link, points, [0], edges, offsets)
        self.places += [
            Constraint(f"{link} on its plane", level, Sense.EQUAL_ZERO, PLACE_TOLERANCE_M, unit="m"),
            Constraint(f"{link} in its patch", inside, tolerance=PLACE_TOLERANCE_M, unit="m"),
        ]

    def move_centre(self, x: float, y: float = 0.0) -> None:
        """Require a place of the centre of mass."""
        term = CentreOfMassAt(np.array([x, y]), [0])
        self.places.append(Constraint("centre of mass", term, Sense.EQUAL_ZERO, BALANCE_TOLERANCE_M, unit="m"))


def stand(robot: RobotModel, ahead: float | None) -> Stance:
    """Return a robot on two feet."""
    stance = Stance.on_feet(robot, FEET)
    if ahead is not None:
        stance.move_centre(ahead)
    return stance


def lean(robot: RobotModel, feet: Sequence[str], ahead: float | None) -> Stance:
    """Return a robot on its feet and with both hands on a bar."""
    stance = Stance.on_feet(robot, feet)
    for tool, side in zip(TOOLS, (1.0, -1.0), strict=True):
        stance.hold(tool, (BAR[0], side * BAR[1], BAR[2]), HAND_CAP_N)
    if ahead is not None:
        stance.move_centre(ahead)
    return stance


def lean_anywhere(robot: RobotModel, rng: np.random.Generator) -> Stance:
    """Return a robot on its feet with both hands on a bar, bar and centre of mass drawn at random."""
    stance = Stance.on_feet(robot, FEET)
    x, y, z = rng.uniform((0.45, 0.2, 0.7), (0.85, 0.45, 1.3))
    for tool, side in zip(TOOLS, (1.0, -1.0), strict=True):
        stance.hold(tool, (x, side * y, z), HAND_CAP_N)
    stance.move_centre(*rng.uniform((0.0, -0.1), (0.3, 0.1)))
    return stance


def sit(robot: RobotModel) -> Stance:
    """Return a robot that sits, its right foot out on a lower step, its left hand on a slanted rail."""
    standing = Stance.on_feet(robot, FEET).body
    soles: Mapping[str, Float[np.ndarray, "C 3"]] = {foot.link: foot.sole for foot in standing.planted}
    stance = Stance(WholeBody.standing(robot, Scene(()), standing.nominal, (), Aims()), [])
    hip = np.array([[x, y, -0.095] for x in (-0.1, 0.1) for y in (-0.12, 0.12)])  # bottom of the pelvis
    stance.rest("pelvis", hip, SEAT_M, (-0.25, 0.1, -0.2, 0.2), HIP_CAP_N)
    stance.rest("l_foot", soles["l_foot"], 0.0, (0.1, 0.7, 0.0, 0.4), FOOT_CAP_N)
    stance.rest("r_foot", soles["r_foot"], STEP_M, (0.1, 0.55, -0.5, -0.2), FOOT_CAP_N)
    slant = np.array([0.0, -0.3, 1.0])
    stance.hold("l_tool", (0.5, 0.35, SEAT_M + 0.35), RAIL_CAP_N, slant / np.linalg.norm(slant))
    return stance


@dataclass(frozen=True)
class Case:
    """A row of the table.

    Attributes:
        name: of the pose.
        make: the stance for a random generator.
        torque_share: of the joint limits; None for any torque.
        loads: on the robot.
    """

    name: str
    make: Callable[[RobotModel, np.random.Generator], Stance]
    torque_share: float | None = 1.0
    loads: tuple[Load, ...] = ()


PUSH = Load("r_tool", np.array([-80.0, 0.0, 0.0]))
CASES = (
    Case("two feet, centre of mass moved 7 cm", lambda robot, rng: stand(robot, 0.07)),
    Case("two feet, both hands on a bar, centre of mass 35 cm ahead", lambda robot, rng: lean(robot, FEET, 0.35)),
    Case("the same, any torque", lambda robot, rng: lean(robot, FEET, 0.35), torque_share=None),
    Case("two feet, right hand pushes 80 N", lambda robot, rng: stand(robot, None), loads=(PUSH,)),
    Case("left foot, both hands on a bar", lambda robot, rng: lean(robot, FEET[:1], None)),
    Case("hip, both feet on patches, left hand on a rail", lambda robot, rng: sit(robot)),
    Case("two feet, both hands on a bar, centre of mass 1.5 m ahead", lambda robot, rng: lean(robot, FEET, 1.5)),
    Case("two feet, both hands on a bar, both places at random", lean_anywhere),
)


def run(robot: RobotModel, case: Case, n_guesses: int, seed: int) -> tuple[tuple[str, ...], Counter[str]]:
    """Return one row of the table, and how often each kind of violation occurred."""
    rng = np.random.default_rng(seed)
    poses: list[EquilibriumPose] = []
    cpu: list[float] = []
    for _ in range(n_guesses):
        stance = case.make(robot, rng)
        guess = stance.body.nominal + np.concatenate([np.zeros(6), JOINT_SPREAD * rng.normal(size=robot.n - 6)])
        limits = ForceLimits(case.torque_share, loads=case.loads, world_normals=stance.normals)
        started = time.process_time()
        poses.append(solve_equilibrium_pose(stance.body, stance.contacts, guess, limits, constraints=stance.places))
        cpu.append(1e3 * (time.process_time() - started))
    steps = [len(pose.result.history) for pose in poses]
    row = (
        case.name,
        str(3 * len(poses[0].forces_n)),
        f"{sum(pose.is_feasible for pose in poses)}/{n_guesses}",
        f"{min(steps)}-{max(steps)}",
        f"{statistics.median(cpu):.0f}",
        f"{max(cpu):.0f}",
        f"{100.0 * max(pose.torque_share for pose in poses):.1f} %",
        f"{100.0 * max(pose.least_torque_share for pose in poses):.1f} %",
        f"{min(pose.reserve_n for pose in poses):.1f}",
        f"{max(pose.misfit_n for pose in poses):.0e}",
    )
    return row, Counter(pose.violations[0] for pose in poses if pose.violations)


def main() -> None:
    """Print a table, and below it the first violation of every pose that is not held."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--guesses", type=int, default=GUESSES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    robot = load_robot("atlas")
    rows, below = [], []
    for case in CASES:
        row, violations = run(robot, case, given.guesses, given.seed)
        rows.append(row)
        below += [f"  {case.name}: {count} x {line}" for line, count in violations.most_common()]
    print_table("Atlas in static equilibrium", COLUMNS, rows)
    print("\n".join(below))


if __name__ == "__main__":
    main()
