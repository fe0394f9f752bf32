"""Hands that push parts: those with a rod, and grippers, whose closed fingers push by their ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from costs.robot import RobotModel
from service.demands.grasping.gripper import list_grippers
from service.demands.hands import Hand, list_robot_hands
from service.demands.mechanism.given import GivenMechanism

APART_M = 5e-3  # of each pad of a closed gripper from the middle: fingers keep clear of each other


def list_pushing_hands(robot: RobotModel, given: GivenMechanism) -> Iterator[Hand]:
    """Yield the permitted hands of a robot that can push a mechanism.

    A hand with two fingers and no rod pushes by the ends of its closed fingers: parts that slide, with the handle's
    ``tool: tip``.  The pads are as near as fingers keep clear of each other, and as their joints let them be.
    """
    for hand in list_robot_hands(robot):
        if given.request.hand not in ("auto", hand.side):
            continue
        if all(robot.model.existFrame(frame) for frame in (hand.tool, hand.peg, hand.stub)):
            yield hand
        elif given.request.handle.tool == "tip" and not list_turning(given):
            closed = _close_fingers(robot, hand)
            if closed is not None:
                yield closed


def list_turning(given: GivenMechanism) -> list[str]:
    """Return the joints that carry a mechanism's handle and turn."""
    carriers = given.read.list_carriers(given.handle.joint)
    return [name for name in carriers if given.mechanism.joint(name).kind == "revolute"]


def _close_fingers(robot: RobotModel, hand: Hand) -> Hand | None:
    """Return a hand with its fingers closed; None where it has no two that slide."""
    gripper = next((made for made in list_grippers(robot, hand.side) if made.tool == hand.tool), None)
    if gripper is None:
        return None
    apart = 0.5 * (gripper.faces[1] - gripper.faces[0]) + APART_M
    values = {joint: round(max(least, apart), 9) for joint, least in zip(gripper.joints, gripper.least, strict=True)}
    return replace(hand, fingers=gripper.fingers, closed=tuple(values.items()), tip_m=gripper.tip)
