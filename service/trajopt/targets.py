"""What a program promises of the whole motion: what the verifier can be held to, and in words what it cannot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from costs.collision import Contacts
from costs.kinematics import KinematicsEngine
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import FramePose, Masked
from scopt import Residual
from service.body.holds import Hold
from service.trajopt.demanded import joint_target, pose_matrix, pose_targets, unproven_terms
from service.trajopt.problem import PoseTerm
from service.trajopt.program import Program, Timeline
from service.trajopt.standing import held_alike
from service.trajopt.terms import turn_residual
from service.verify import Target

HELD_AT_START = 1e-4  # a pose that is asked for throughout is held in between if it holds at the start, too [m, rad]


@dataclass(frozen=True)
class Promises:
    """What is held and checked besides what stands.

    Attributes:
        program: whose promises they are.
        robot: that moves.
        along: pose constraints that hold along the whole motion; one term stands for all waypoints.
        held: paths of all the terms that these stand for.
        notes: what is kept by the optimiser but no part of the proof.
    """

    program: Program
    robot: RobotModel
    along: tuple[PoseTerm, ...]
    held: frozenset[str]
    notes: tuple[str, ...]

    @staticmethod
    def of(program: Program, robot: RobotModel) -> Promises:
        """The promises of a program."""
        held = [terms for terms in held_alike(program.problem) if _can_be_held(program, robot, terms[0])]
        notes = [f"{terms[0].title} and its like at every waypoint are held in between, too" for terms in held]
        unproven = unproven_terms(program)
        if unproven:
            notes.append(f"kept at the waypoints, and no part of the proof: {', '.join(unproven)}")
        paths = frozenset(term.path for terms in held for term in terms)
        return Promises(program, robot, tuple(terms[0] for terms in held), paths, tuple(notes))

    def holds(self) -> tuple[Hold, ...]:
        """What the curve keeps at zero between the waypoints, moved by the free coordinates alone."""
        moves = np.zeros(self.robot.n, dtype=bool)
        moves[self.program.free] = True
        return tuple(hold for term in self.along for hold in _holds(self.robot, term, moves))

    def targets(self) -> tuple[Target, ...]:
        """What holds along the whole motion."""
        return tuple(target for term in self.along for target in pose_targets(term, None))

    def at_waypoints(self, timeline: Timeline, s: Float[np.ndarray, "T"]) -> tuple[Target, ...]:
        """What holds at single waypoints, whose path parameters are ``s``."""
        at = [float(s[row]) for row in timeline.rows.tolist()]
        names = self.robot.joint_names
        joints = [
            joint_target(names[column], asked, at[step])
            for step, ranges in sorted(self.program.ranges.items())
            for column, asked in sorted(ranges.items())
        ]
        poses = [
            target
            for term in self.program.problem.terms
            if isinstance(term, PoseTerm) and not term.is_cost and term.path not in self.held
            for target in pose_targets(term, at[term.step])
        ]
        return (*joints, *poses)


def _residuals(robot: RobotModel, term: PoseTerm, waypoints: Int[np.ndarray, "S"]) -> list[Residual[MotionState]]:
    """What a pose constraint keeps at zero."""
    found: list[Residual[MotionState]] = []
    if any(term.pos_coeffs):
        axes = (*(c > 0.0 for c in term.pos_coeffs), False, False, False)
        target, offset = pose_matrix(term.xyz, term.wxyz), pose_matrix(term.offset_xyz, term.offset_wxyz)
        found.append(FramePose(robot, term.frame, waypoints, target, axes, term.reference, offset))
    turn = turn_residual(robot, term, waypoints)
    return found if turn is None else [*found, turn]


def _holds(robot: RobotModel, term: PoseTerm, moves: Bool[np.ndarray, "n"]) -> Sequence[Hold]:
    def hold_of(index: int) -> Callable[[Int[np.ndarray, "S"]], Residual[MotionState]]:
        return lambda waypoints: Masked(_residuals(robot, term, waypoints)[index], moves)

    return [hold_of(index) for index in range(len(_residuals(robot, term, np.zeros(1, dtype=int))))]


def _can_be_held(program: Program, robot: RobotModel, term: PoseTerm) -> bool:
    """Whether a pose that is asked for at every later waypoint can be promised for the whole motion."""
    state = MotionState(KinematicsEngine(robot)(program.fixed.get(0, program.start)[None]), Contacts.none())
    values = [residual.value(state) for residual in _residuals(robot, term, np.zeros(1, dtype=int))]
    is_there = all(float(np.abs(value).max(initial=0.0)) <= HELD_AT_START for value in values)
    return 0 in program.fixed and is_there and bool(pose_targets(term, None))
