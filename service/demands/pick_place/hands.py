"""The closed chain of two hands that carry one object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.rotation import pose_matrix
from service.demands.grasping.gripper import Gripper
from service.demands.pick_place.work import LIFT, PickPlace
from service.verify import Motion, Phase, RelativePoseTarget, place_frames

CHAIN_M, CHAIN_RAD = 1e-3, 5e-3  # by which the second hand may move against the first
GRASP_M, GRASP_RAD = 5e-3, 0.035  # of a tool from a grasp of the request


def make_closed_chain(motion: Motion, grippers: Sequence[Gripper]) -> tuple[RelativePoseTarget, ...]:
    """Return the promises that further hands keep their poses against the first, which a record chooses.

    Any pose will do that the grips hold; where the record names none, it is that in which the hands lift.
    """
    named = [target for phase in motion.phases for target in phase.targets if isinstance(target, RelativePoseTarget)]
    leading = grippers[0].tool
    chain = []
    for gripper in grippers[1:]:
        own = [target for target in named if (target.frame, target.reference) == (gripper.tool, leading)]
        if own:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = own[0].rotation, own[0].position
        else:
            at = next((phase.first for phase in motion.phases if phase.name == LIFT), float(motion.curve.knots[0]))
            poses = place_frames(motion.robot, motion.curve(np.array([at]))[0], [leading, gripper.tool])
            pose = np.linalg.inv(poses[leading]) @ poses[gripper.tool]
        chain.append(hold_against(leading, gripper.tool, pose))
    return tuple(chain)


def hold_against(reference: str, tool: str, pose: Float[np.ndarray, "4 4"]) -> RelativePoseTarget:
    """Return the promise that a tool keeps its pose against another one."""
    return RelativePoseTarget(tool, reference, pose[:3, 3], pose[:3, :3], CHAIN_M, CHAIN_RAD)


def make_grasp_targets(
    work: PickPlace, motion: Motion, phase: Phase, grippers: Sequence[Gripper]
) -> tuple[RelativePoseTarget, ...]:
    """Return the promises that tools are at grasps of the request, the nearest to where a phase begins."""
    q = motion.curve(np.array([phase.first]))[0]
    poses = place_frames(motion.robot, q, [gripper.tool for gripper in grippers])
    given = [pose_matrix(grasp.position, grasp.quaternion_wxyz) for grasp in work.given.grasps]
    targets = []
    for gripper in grippers:
        own = np.linalg.inv(work.item.start) @ poses[gripper.tool]
        targets.append(hold_grasp(work, gripper, min(given, key=lambda pose: float(np.abs(pose - own).max()))))
    return tuple(targets)


def hold_grasp(work: PickPlace, gripper: Gripper, pose: Float[np.ndarray, "4 4"]) -> RelativePoseTarget:
    """Return the promise that a tool is at a grasp."""
    return RelativePoseTarget(gripper.tool, work.item.name, pose[:3, 3], pose[:3, :3], GRASP_M, GRASP_RAD)
