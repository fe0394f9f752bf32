"""Hands that push parts: those with a rod, and grippers, whose closed fingers push by their ends and sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from costs.robot import RobotModel
from service.demands.grasping.gripper import list_grippers
from service.demands.hands import Hand, list_robot_hands
from service.demands.mechanism.given import GivenMechanism
from service.demands.phase import AXIS

APART_M = 5e-3  # of each pad of a closed gripper from the middle: fingers keep clear of each other


def list_pushing_hands(robot: RobotModel, given: GivenMechanism) -> Iterator[Hand]:
    """Yield the permitted hands of a robot that can push a mechanism.

    A hand with two fingers and no rod pushes by its closed fingers: by their ends (the handle's ``tool: tip``), by
    either side of both (``peg``), or by that and the hand's front at once (``stub``).  The pads are as near as fingers
    keep clear of each other, and as their joints let them be.
    """
    for hand in list_robot_hands(robot):
        if given.request.hand not in ("auto", hand.side):
            continue
        if all(robot.model.existFrame(frame) for frame in (hand.tool, hand.peg, hand.stub)):
            yield hand
            continue
        closed = _close_fingers(robot, hand)
        if closed is not None:
            yield closed
            if given.request.handle.tool != "tip":
                yield replace(closed, flank=(-closed.flank[0], -closed.flank[1], -closed.flank[2]))


def _close_fingers(robot: RobotModel, hand: Hand) -> Hand | None:
    """Return a hand with its fingers closed; None where it has no two that slide."""
    gripper = next((made for made in list_grippers(robot, hand.side) if made.tool == hand.tool), None)
    if gripper is None:
        return None
    apart = 0.5 * (gripper.faces[1] - gripper.faces[0]) + APART_M
    values = {joint: round(max(least, apart), 9) for joint, least in zip(gripper.joints, gripper.least, strict=True)}
    x, y, z = np.cross(AXIS, gripper.closing).tolist()
    return replace(
        hand,
        palm=gripper.front,
        fingers=gripper.fingers,
        peg_radius=gripper.flank_m,
        closed=tuple(values.items()),
        tip_m=gripper.tip,
        palm_m=gripper.palm,
        flank=(x, y, z),
    )
