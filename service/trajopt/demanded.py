"""What a TrajOpt problem demands of its waypoints, as targets of the verifier."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import RobotModel
from service.demands.program import ProgramDemand, StepTarget
from service.trajopt.problem import JointTerm, PoseTerm, Vector
from service.trajopt.program import JointRange, Program
from service.verify import AxisTarget, JointTarget, PoseTarget

JOINT_TOLERANCE = 1e-3  # of joint values at waypoints [rad, m]
PLACE_TOLERANCE, TURN_TOLERANCE = 1e-3, float(np.deg2rad(0.5))  # of poses [m, rad]


def program_demand(program: Program, robot: RobotModel) -> ProgramDemand:
    """What a program demands of a motion of ``robot``."""
    steps = tuple(_step_targets(program, robot, step) for step in range(program.n_steps))
    return ProgramDemand(steps, program.free, program.planted, program.is_balanced, unproven_terms(program))


def unproven_terms(program: Program) -> tuple[str, ...]:
    """Paths of the constraints that the optimiser keeps at its waypoints and the verifier has no target for."""
    return tuple(
        term.path
        for term in program.problem.terms
        if not term.is_cost and not (isinstance(term, PoseTerm) and pose_targets(term, None))
        if not (isinstance(term, JointTerm) and not term.order)
    )


def _step_targets(program: Program, robot: RobotModel, step: int) -> tuple[StepTarget, ...]:
    ranges = program.ranges.get(step, {})
    joints = [joint_target(robot.joint_names[column], asked, 0.0) for column, asked in sorted(ranges.items())]
    poses = [
        target
        for term in program.problem.terms
        if isinstance(term, PoseTerm) and not term.is_cost and term.step == step
        for target in pose_targets(term, 0.0)
    ]
    return (*joints, *poses)


def pose_matrix(xyz: Vector, wxyz: Vector) -> Float[np.ndarray, "4 4"]:
    """A pose of the file as a matrix; the quaternion is normalised."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(wxyz, scalar_first=True).as_matrix()
    matrix[:3, 3] = xyz
    return matrix


def pose_targets(term: PoseTerm, at: float | None) -> tuple[PoseTarget | AxisTarget, ...]:
    """A pose constraint as targets of the verifier; none where it has no such target (see the conditions)."""
    places, turns = [c > 0.0 for c in term.pos_coeffs], [c > 0.0 for c in term.rot_coeffs]
    target, offset = pose_matrix(term.xyz, term.wxyz), pose_matrix(term.offset_xyz, term.offset_wxyz)
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


def joint_target(joint: str, asked: JointRange, at: float) -> JointTarget:
    """A joint within its range at path parameter ``at``."""
    middle, half = 0.5 * (asked.lower + asked.upper), 0.5 * (asked.upper - asked.lower)
    return JointTarget(joint, middle, half + JOINT_TOLERANCE, at)
