"""Joints that follow others (URDF's ``mimic``) in a pinocchio model."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

import pinocchio as pin

from costs.robot.errors import RobotError


def let_follow(model: pin.Model, followers: Mapping[str, tuple[str, float, float]], where: str) -> pin.Model:
    """Return the model in which joints follow others.

    Args:
        model: with every joint moving by itself.
        followers: by name of the joint, the joint it follows, multiplier and offset; none follows a follower.
        where: names the robot in messages.

    Raises:
        RobotError: a joint follows one that it carries, directly or through another follower.
    """
    if not followers:
        return model
    order = _order_joints(model, followers, where)
    if order != sorted(order):
        model = _reorder(model, order)
    for name, (leader, multiplier, offset) in followers.items():
        model = pin.transformJointIntoMimic(model, model.getJointId(leader), model.getJointId(name), multiplier, offset)
    return model


def _order_joints(model: pin.Model, followers: Mapping[str, tuple[str, float, float]], where: str) -> list[int]:
    """Return the joints in an order with parents before children and leaders before followers, else as they are."""
    before = {joint: {int(model.parents[joint])} - {0} for joint in range(1, model.njoints)}
    for name, (leader, _, _) in followers.items():
        before[model.getJointId(name)].add(model.getJointId(leader))
    after: dict[int, list[int]] = {joint: [] for joint in before}
    for joint, needed in before.items():
        for other in needed:
            after[other].append(joint)
    ready = [joint for joint, needed in before.items() if not needed]
    order: list[int] = []
    while ready:
        joint = heapq.heappop(ready)
        order.append(joint)
        for other in after[joint]:
            before[other].discard(joint)
            if not before[other]:
                heapq.heappush(ready, other)
    if len(order) < model.njoints - 1:
        stuck = next(name for name in followers if model.getJointId(name) not in order)
        words = f"joint '{stuck}' mimics '{followers[stuck][0]}', which it carries"
        raise RobotError(f"{where}: {words}; let the one further out mimic the other")
    return order


def _reorder(model: pin.Model, order: Sequence[int]) -> pin.Model:
    """Return the model with its joints in another order; it keeps names, inertias and frames, not limits."""
    made = pin.Model()
    made.name, made.gravity = model.name, model.gravity
    made.inertias[0] = model.inertias[0]
    joint_of, frame_of = {0: 0}, {0: 0}
    for joint in order:
        place = model.jointPlacements[joint]
        joint_of[joint] = made.addJoint(
            joint_of[int(model.parents[joint])], model.joints[joint], place, model.names[joint]
        )
        made.appendBodyToJoint(joint_of[joint], model.inertias[joint], pin.SE3.Identity())
    for index, frame in enumerate(model.frames):
        if index == 0:
            continue
        moved = pin.Frame(
            frame.name, joint_of[int(frame.parentJoint)], frame_of[int(frame.parentFrame)], frame.placement, frame.type
        )
        frame_of[index] = made.addFrame(moved)
    return made
