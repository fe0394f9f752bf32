"""Targets of the verifier for a program: along the whole motion and at single waypoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import Masked
from scopt import Residual
from service.body.holds import Hold
from service.demands.program import ProgramDemand
from service.trajopt.planted_links import group_equal_poses
from service.trajopt.problem import JointTerm, PoseTerm
from service.trajopt.program import JointRange, Program, Timeline
from service.trajopt.terms import make_pose_residuals
from service.verify import AxisTarget, JointTarget, PoseTarget, Target

HELD_AT_START = 1e-4  # a pose constraint at all later waypoints also holds between them if the start meets it [m, rad]
JOINT_TOLERANCE = 1e-3  # of joint values at waypoints [rad, m]
PLACE_TOLERANCE, TURN_TOLERANCE = 1e-3, float(np.deg2rad(0.5))  # of poses [m, rad]


@dataclass(frozen=True)
class Promises:
    """Promises of a program's motion besides its planted links.

    Attributes:
        along: pose constraints that hold along the whole motion; one term represents those of all waypoints.
        held: paths of all represented terms.
        notes: lines on held constraints, and on constraints that the verifier cannot check.
    """

    program: Program
    robot: RobotModel
    along: tuple[PoseTerm, ...]
    held: frozenset[str]
    notes: tuple[str, ...]

    @staticmethod
    def of(program: Program, robot: RobotModel) -> Promises:
        """Collect the promises of a program."""
        held = [terms for terms in group_equal_poses(program.problem) if _can_be_held(program, robot, terms[0])]
        notes = [f"{terms[0].title} and its like at every waypoint are held in between, too" for terms in held]
        unproven = _list_unproven_terms(program)
        if unproven:
            notes.append(f"kept at the waypoints, and no part of the proof: {', '.join(unproven)}")
        paths = frozenset(term.path for terms in held for term in terms)
        return Promises(program, robot, tuple(terms[0] for terms in held), paths, tuple(notes))

    def make_holds(self) -> tuple[Hold, ...]:
        """Make the equalities that the curve keeps between the waypoints by moving the free coordinates."""
        moves = np.zeros(self.robot.n, dtype=bool)
        moves[self.program.free] = True

        def make_hold(term: PoseTerm, kind: str) -> Callable[[Int[np.ndarray, "S"]], Residual[MotionState]]:
            return lambda waypoints: Masked(make_pose_residuals(self.robot, term, waypoints)[kind], moves)

        return tuple(
            make_hold(term, kind) for term in self.along for kind in make_pose_residuals(self.robot, term, [0])
        )

    def make_targets(self) -> tuple[Target, ...]:
        """Make the targets along the whole motion."""
        return tuple(target for term in self.along for target in _make_pose_targets(term, None))

    def make_waypoint_targets(self, timeline: Timeline, s: Float[np.ndarray, "T"]) -> tuple[Target, ...]:
        """Make the targets at single waypoints; ``s`` are the waypoints' path parameters."""
        at = [float(s[row]) for row in timeline.rows.tolist()]
        joints = [
            target
            for step, ranges in sorted(self.program.ranges.items())
            for target in _make_joint_targets(self.robot, ranges, at[step])
        ]
        poses = [
            target
            for term in _list_pose_constraints(self.program)
            if term.path not in self.held
            for target in _make_pose_targets(term, at[term.step])
        ]
        return (*joints, *poses)


def make_program_demand(program: Program, robot: RobotModel) -> ProgramDemand:
    """Return the demands of a program on a motion of ``robot``."""
    steps = tuple(
        (
            *_make_joint_targets(robot, program.ranges.get(step, {}), 0.0),
            *(
                target
                for term in _list_pose_constraints(program)
                if term.step == step
                for target in _make_pose_targets(term, 0.0)
            ),
        )
        for step in range(program.n_steps)
    )
    return ProgramDemand(steps, program.free, program.planted, program.is_balanced, _list_unproven_terms(program))


def _list_pose_constraints(program: Program) -> list[PoseTerm]:
    return [term for term in program.problem.terms if isinstance(term, PoseTerm) and not term.is_cost]


def _list_unproven_terms(program: Program) -> tuple[str, ...]:
    """Return the paths of the constraints for which the verifier has no target."""
    return tuple(
        term.path
        for term in program.problem.terms
        if not term.is_cost and not (isinstance(term, PoseTerm) and _make_pose_targets(term, None))
        if not (isinstance(term, JointTerm) and not term.order)
    )


def _make_pose_targets(term: PoseTerm, at: float | None) -> tuple[PoseTarget | AxisTarget, ...]:
    """Make the targets of a pose constraint; none for combinations of free axes that targets cannot express."""
    places, turns = term.position_axes, term.rotation_axes
    target, offset = term.target, term.offset
    is_whole = all(places) and all(turns)
    is_moved, is_turned = np.any(offset[:3, 3] != 0.0), np.any(offset[:3, :3] != np.eye(3))
    is_beyond = any(places) and not is_whole and (is_moved or (is_turned and not all(places)))
    if term.reference is not None or sum(turns) == 1 or is_beyond:
        return ()
    wanted = target @ np.linalg.inv(offset)
    place = np.where(places, PLACE_TOLERANCE, np.inf)
    turn = np.full(3, TURN_TOLERANCE if all(turns) else np.inf)
    targets: list[PoseTarget | AxisTarget] = []
    if any(places) or all(turns):
        targets.append(PoseTarget(term.frame, wanted[:3, 3], wanted[:3, :3], place, turn, at))
    if sum(turns) == 2:
        free = turns.index(False)
        targets.append(AxisTarget(term.frame, offset[:3, free], target[:3, free], TURN_TOLERANCE, at))
    return tuple(targets)


def _make_joint_targets(robot: RobotModel, ranges: Mapping[int, JointRange], at: float) -> list[JointTarget]:
    """Make the targets of one step's joint ranges at path parameter ``at``."""
    targets = []
    for column, wanted in sorted(ranges.items()):
        middle, half = 0.5 * (wanted.lower + wanted.upper), 0.5 * (wanted.upper - wanted.lower)
        targets.append(JointTarget(robot.joint_names[column], middle, half + JOINT_TOLERANCE, at))
    return targets


def _can_be_held(program: Program, robot: RobotModel, term: PoseTerm) -> bool:
    """Return whether a pose constraint at every later waypoint can be promised for the whole motion."""
    if 0 not in program.fixed or not _make_pose_targets(term, None):
        return False
    state = MotionState(KinematicsEngine(robot)(program.fixed[0][None]), Contacts.none())
    values = [residual.value(state) for residual in make_pose_residuals(robot, term, [0]).values()]
    return all(float(np.abs(value).max(initial=0.0)) <= HELD_AT_START for value in values)
