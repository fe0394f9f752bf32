"""Solvers of a robot with the objects where they are: margins beside what hands take, torques of what they carry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import BodyRef
from costs.robot import RobotModel
from costs.state import MotionState
from costs.terms import HeldTorque
from scopt import Constraint, Cost
from service.body.phases import PhaseSolver
from service.demands.grasping.gripper import list_grippers
from service.demands.hands import list_robot_hands
from service.demands.steps.holding import Hold, Holding
from service.verify import GRAVITY, place_frames

HAND_MARGIN_M, GROUND_MARGIN_M = 4e-3, 1e-3  # between a hand and what it takes, and what that rests on
BETWEEN_M = 4e-3  # between an object and what it passes close by as it is lifted and put down
TORQUE_SHARE, TORQUE_TOLERANCE = 0.93, 0.01  # of the limits at rest while an object is carried


def place_objects(
    solver: PhaseSolver, holding: Holding, at: Float[np.ndarray, "n"], near: Sequence[str]
) -> PhaseSolver:
    """Return the solver of the robot with the objects where they are.

    Args:
        solver: without objects.
        holding: the objects.
        at: (n,) the robot's configuration.
        near: pieces that objects and the hands about them pass close by.
    """
    if not holding.items:
        return replace(solver, body=replace(solver.body, nominal=at))
    body = solver.body
    placed = body.with_robot(holding.place(body.robot), at)
    own = replace(solver, body=placed, overrides=(*solver.overrides, *_list_margins(solver, holding, near)))
    for name, hold in holding.held.items():
        own = _limit_torques(own, holding, name, hold)
    return own


def limit_own_torques(solver: PhaseSolver) -> PhaseSolver | None:
    """Return the solver that limits the torques at rest of empty arms; None where each holds itself in any pose."""
    weak = list_weak_arms(solver.body.robot)
    if not weak:
        return None
    others = solver.terms

    def add(phase: str, robot: RobotModel, count: int) -> Sequence[Cost[MotionState] | Constraint[MotionState]]:
        limits = (HeldTorque(robot, tool, np.arange(count), np.zeros((count, 3)), TORQUE_SHARE) for tool in weak)
        own = (Constraint(f"torque of {tool}", limit, tolerance=TORQUE_TOLERANCE, unit="1")
               for tool, limit in zip(weak, limits, strict=True) if len(limit.limited))  # fmt: skip
        return (*others(phase, robot, count), *own)

    return replace(solver, terms=add)


def list_weak_arms(robot: RobotModel) -> tuple[str, ...]:
    """Return the tools of hands whose arms may need more than their torques to hold themselves."""
    tools = (hand.tool for hand in list_robot_hands(robot) if robot.model.existFrame(hand.tool))
    return tuple(tool for tool in tools if bound_own_share(robot, tool) > TORQUE_SHARE)


def bound_own_share(robot: RobotModel, tool: str) -> float:
    """Return a bound of the share of its torque that any joint before a tool needs for what is beyond it."""
    model = robot.model
    share, joint = 0.0, int(model.frames[model.getFrameId(tool)].parentJoint)
    moments = np.zeros(model.njoints)  # of all beyond a joint about it, stretched out [kg m]
    masses = np.array([inertia.mass for inertia in model.inertias])
    for own in range(model.njoints - 1, 0, -1):
        moments[own] += model.inertias[own].mass * float(np.linalg.norm(model.inertias[own].lever))
        before = int(model.parents[own])
        moments[before] += moments[own] + masses[own] * float(np.linalg.norm(model.jointPlacements[own].translation))
        masses[before] += masses[own]
    while joint > 0:
        made = model.joints[joint]
        effort = robot.effort[made.idx_v]
        if made.nv == 1 and np.isfinite(effort) and effort > 0.0:
            share = max(share, GRAVITY * float(moments[joint]) / float(effort))
        joint = int(model.parents[joint])
    return share


def _list_margins(
    solver: PhaseSolver, holding: Holding, near: Sequence[str]
) -> Iterator[tuple[BodyRef, BodyRef, float]]:
    """Yield the margins between hands, objects and the pieces beside them."""
    items, pieces = [BodyRef.of_link(name) for name in holding.items], [BodyRef.of_piece(name) for name in near]
    for gripper in list_grippers(holding.robot, "auto"):
        for link in dict.fromkeys((gripper.link, gripper.front, *gripper.fingers)):
            yield from ((BodyRef.of_link(link), item, HAND_MARGIN_M) for item in items)
            yield from ((BodyRef.of_link(link), piece, GROUND_MARGIN_M) for piece in pieces)
    for number, item in enumerate(items):
        for ref in (*items[:number], *pieces):
            yield item, ref, BETWEEN_M


def _limit_torques(solver: PhaseSolver, holding: Holding, name: str, hold: Hold) -> PhaseSolver:
    """Return the solver that limits the torques at rest of arms that carry an object; two hands share its weight."""
    body, item = solver.body, holding.items[name].body
    loads = [(hold.tools[0], 0.0)]
    for tool, chain in list(hold.chain.items())[:1]:
        link = hold.grippers[0].link
        rest = np.zeros(holding.robot.n)
        poses = place_frames(holding.robot, rest, [link, hold.tools[0]])
        leading = np.linalg.inv(hold.pose) @ np.linalg.inv(poses[link]) @ poses[hold.tools[0]]
        places = [leading[:3, 3], (leading @ chain)[:3, 3]]
        along = places[1] - places[0]
        share = float(np.clip((item.inertia.centre - places[0]) @ along / (along @ along), 0.0, 1.0))
        weight = share * GRAVITY * item.inertia.mass
        model = body.robot.model
        frame = model.frames[model.getFrameId(name)]
        spot = frame.placement * pin.SE3(np.eye(3), places[1])
        shared = f"{name}/shared"
        if not model.existFrame(shared):
            model.addFrame(pin.Frame(shared, frame.parentJoint, spot, pin.FrameType.OP_FRAME))
        loads = [(shared, weight), (tool, -weight)]
    others = solver.terms

    def add(phase: str, robot: RobotModel, count: int) -> Sequence[Cost[MotionState] | Constraint[MotionState]]:
        own = []
        for frame_name, force in loads:
            forces = np.tile([0.0, 0.0, force], (count, 1))
            limit = HeldTorque(robot, frame_name, np.arange(count), forces, TORQUE_SHARE)
            if len(limit.limited):
                own.append(
                    Constraint(f"torque of {frame_name} with {name}", limit, tolerance=TORQUE_TOLERANCE, unit="1")
                )
        return (*others(phase, robot, count), *own)

    return replace(solver, terms=add)
