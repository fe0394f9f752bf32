"""Hands and the mechanism that they handle, as they are at the start: which hands to try, and what is inside what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.kinematics import locate_frame, locate_links
from costs.robot import RobotModel
from service.body.whole_body import WholeBody
from service.demands.hands import Hand, list_robot_hands
from service.demands.phase import AXIS

FARTHER = "; start farther away"  # what helps against a collision with the mechanism


def list_hands(body: WholeBody, side: str, at: Float[np.ndarray, "3"], frames: Sequence[str]) -> tuple[Hand, ...]:
    """Return the hands of a side that a robot has, the nearest to a place first.

    Args:
        body: at its start.
        side: ``left``, ``right``, or ``auto`` for both.
        at: (3,) what is to be held, in the world [m].
        frames: names of the fields of ``Hand`` whose frames are needed.
    """
    model = body.robot.model
    known = [
        hand
        for hand in list_robot_hands(body.robot)
        if side in ("auto", hand.side) and all(model.existFrame(getattr(hand, frame)) for frame in frames)
    ]
    return sort_hands(body, known, at)


def sort_hands(body: WholeBody, hands: Sequence[Hand], at: Float[np.ndarray, "3"]) -> tuple[Hand, ...]:
    """Return hands, the nearest to a place (3,) in the world first [m]."""
    poses = locate_links(body.engine, body.nominal, [hand.tool for hand in hands])
    return tuple(sorted(hands, key=lambda hand: float(np.linalg.norm(poses[hand.tool][:3, 3] - at))))


def find_collisions(body: WholeBody, touches: Sequence[Allowance] = (), remedy: str = "") -> Iterator[str]:
    """Yield a sentence for each link that is deeper in the mechanism than it may be at the start.

    Args:
        body: augmented by the mechanism.
        touches: pairs that may touch.
        remedy: ends the sentences.
    """
    contacts = body.make_checker(touches)(body.engine(body.nominal[None]))
    bodies, moved = body.robot.bodies, body.robot.mechanism_links
    for row in np.flatnonzero(contacts.is_self & (contacts.distance < np.minimum(contacts.margin, 0.0))):
        pair = [bodies[contacts.body[row]], bodies[contacts.other[row]]]
        if sum(member.link in moved for member in pair) == 1:
            link, part = (member.name for member in sorted(pair, key=lambda member: member.link in moved))
            depth = -float(contacts.distance[row])
            yield f"start is in collision: {link} is {depth:.3f} m inside {part}{remedy}"


def list_arm_joints(robot: RobotModel, tool: str) -> list[int]:
    """Return the joints between the trunk and a tool, the shoulder's first: those that no other limb hangs on."""
    model = robot.model
    chain: list[int] = []
    joint = locate_frame(robot, tool)[0]
    while joint > 0 and (not chain or len(model.children[joint]) == 1):
        chain.insert(0, joint)
        joint = int(model.parents[joint])
    return chain


def find_turn_joint(body: WholeBody, tool: str) -> tuple[int, float]:
    """Return the coordinate that turns a hand about its axis, and its sense about the tool's z axis."""
    robot = body.robot
    joint, pose_joint_tool = locate_frame(robot, tool)
    column = int(robot.model.joints[joint].idx_vExtended)
    kinematics = body.engine(np.zeros((1, robot.n)))
    turns = kinematics.jacobian[0, 3:, column]
    axis = kinematics.rotation[0, joint] @ pose_joint_tool[:3, :3] @ AXIS
    return column, float(np.sign(turns @ axis))
