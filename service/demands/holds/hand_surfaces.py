"""Surfaces by which a hand presses: its rod, its front, the pads of its fingers, or any link of an arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float

from costs.robot import LinkBody, RobotModel
from service.demands.hands import Hand
from service.demands.phase import TaskPhase
from service.verify import HAND_CAP_N, place_frames, shrink_hull

Surface = tuple[str, str, Float[np.ndarray, "K 3"], float]
"""Frame, name, core [m] and radius [m] of a surface that presses."""


def place_fingers(robot: RobotModel, hand: Hand | None, spec: TaskPhase) -> Mapping[str, Float[np.ndarray, "4 4"]]:
    """Return the poses of fingers that a phase keeps closed, in the tool's frame; none of fingers that grip."""
    motion = spec.hand
    if hand is None or motion is None or motion.grips or not spec.joints:
        return {}
    q = np.zeros(robot.n)
    for joint, (value, _) in spec.joints.items():
        q[robot.joint_names.index(joint)] = value
    poses = place_frames(robot, q, [motion.tool, *hand.fingers])
    return {finger: np.linalg.inv(poses[motion.tool]) @ poses[finger] for finger in hand.fingers}


def find_cap(robot: RobotModel, hand: Hand, link: str) -> float:
    """Return the largest force of a surface along its normal: of a finger its actuator's [N]."""
    if link not in hand.fingers:
        return HAND_CAP_N
    joint = robot.model.joints[robot.model.frames[robot.model.getFrameId(link)].parentJoint]
    effort = float(robot.effort[int(joint.idx_q)])
    return effort if 0.0 < effort < np.inf else HAND_CAP_N


def list_hand_surfaces(robot: RobotModel, hand: Hand, link: str) -> list[Surface]:
    """Return a link's surface: the rod, the hand's front or a pad; empty for a link that is no part of the hand."""
    if link == hand.hook:
        bodies = [_to_frame(robot, body, hand.tool) for body in robot.bodies if body.link == hand.hook]
        if not bodies:
            return []
        first = min(float(vertices[:, 2].min()) for vertices in bodies)
        ends = np.array([[0.0, 0.0, first + hand.peg_radius], [0.0, 0.0, -hand.peg_radius]])
        return [(hand.tool, "the rod", ends, hand.peg_radius)]
    if link in (hand.link, hand.palm, *hand.fingers):
        frame, words = (link, f"the pad of {link}") if link in hand.fingers else (hand.tool, "the hand's front")
        bodies = [_to_frame(robot, body, frame) for body in robot.bodies if body.link == link]
        if not bodies:
            return []
        foremost = max(bodies, key=lambda vertices: float(vertices[:, 2].max()))
        return [(frame, words, *shrink_hull(foremost))]
    return []


def list_link_surfaces(robot: RobotModel, link: str) -> Iterator[Surface]:
    """Yield the surface of each body of a link."""
    for body in robot.bodies:
        if body.link == link:
            yield link, f"the {link}", *shrink_hull(_to_frame(robot, body, link))


def _to_frame(robot: RobotModel, body: LinkBody, frame: str) -> Float[np.ndarray, "V 3"]:
    """Return the vertices of a body in a frame that the same joint carries [m]."""
    placement = robot.model.frames[robot.model.getFrameId(frame)].placement
    own = robot.model.frames[robot.model.getFrameId(body.link)]
    here = robot.model.frames[robot.model.getFrameId(frame)]
    if int(own.parentJoint) != int(here.parentJoint):
        return np.zeros((0, 3))
    return np.asarray((body.vertices - placement.translation) @ placement.rotation)
