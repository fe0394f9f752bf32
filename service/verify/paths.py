"""Points and directions of the robot along the curve: values at poses, and how far they leave their chords between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.verify.chain import Chain, JointTree
from service.verify.errors import VerifyError
from service.verify.forward import placements
from service.verify.motion import Motion
from service.verify.rates import Intervals, intervals


@dataclass(frozen=True)
class FramePath:
    """Points (in a frame) and that frame's axes along the motion, as seen from the world or from another frame.

    Attributes:
        motion: the motion.
        joint: pinocchio joint that carries the frame.
        points: (C, 3) in the frame of that joint [m].
        rotation: (3, 3) rotation_joint_frame.
        holder: pinocchio joint that carries the frame they are seen from (0: the world).
        pose_holder_reference: that frame in its joint's.
        chain: joints that move the points as seen from there.
        turning: the same chain with unit reach, for directions fixed in the frame.
        rounding: error of a written coordinate.
    """

    motion: Motion
    joint: int
    points: Float[np.ndarray, "C 3"]
    rotation: Float[np.ndarray, "3 3"]
    holder: int
    pose_holder_reference: pin.SE3
    chain: Chain
    turning: Chain
    rounding: float

    @staticmethod
    def of(
        motion: Motion,
        tree: JointTree,
        frame: str,
        points: Float[np.ndarray, "C 3"],
        rounding: float,
        reference: str | None = None,
    ) -> FramePath:
        """Path of points given in the named frame, as seen from the frame ``reference`` (None: from the world).

        Raises:
            VerifyError: when the model has no such frame.
        """
        joint, pose_joint_frame = _carried(motion.robot.model, frame)
        holder, pose_holder_reference = (0, pin.SE3.Identity())
        if reference is not None:
            holder, pose_holder_reference = _carried(motion.robot.model, reference)
        placed = points @ pose_joint_frame.rotation.T + pose_joint_frame.translation
        chain = tree.chain(holder, joint, placed)
        reach = np.where(chain.is_revolute, 1.0, 0.0)
        turning = Chain(chain.coordinates, chain.joints, chain.is_revolute, reach, chain.base_rotations)
        rotation = np.array(pose_joint_frame.rotation)
        return FramePath(motion, joint, placed, rotation, holder, pose_holder_reference, chain, turning, rounding)

    def at(self, s: Float[np.ndarray, "S"]) -> tuple[Float[np.ndarray, "S C 3"], Float[np.ndarray, "S 3 3"]]:
        """Points and the frame's axes as seen from the reference (rotation_reference_frame)."""
        placed = placements(self.motion.robot.model, self.motion.curve(s))
        rotation, translation = placed.relative(self.holder, self.joint)
        points = self.points @ np.swapaxes(rotation, -1, -2) + translation[:, None]
        reference = self.pose_holder_reference
        points = (points - reference.translation) @ reference.rotation
        return points, reference.rotation.T @ rotation @ self.rotation

    def stretches(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Intervals:
        """Derivative bounds of the curve on these stretches."""
        return intervals(self.motion.curve, first, last, self.motion.samples)

    def point_deviation(self, over: Intervals) -> Float[np.ndarray, "I"]:
        """How far any of the points may leave its chord [m]."""
        return np.asarray(self.chain.deviation(over) + self.chain.sampling_slack(over, self.rounding))

    def direction_deviation(self, over: Intervals) -> Float[np.ndarray, "I"]:
        """How far the tip of a unit vector fixed in the frame may leave its chord [-]."""
        return np.asarray(self.turning.deviation(over) + self.turning.sampling_slack(over, self.rounding))


def _carried(model: pin.Model, frame: str) -> tuple[int, pin.SE3]:
    """The joint that carries a frame, and pose_joint_frame.

    Raises:
        VerifyError: when the model has no such frame.
    """
    if not model.existFrame(frame):
        raise VerifyError(f"unknown frame '{frame}'; the robot has {', '.join(f.name for f in model.frames)}")
    known = model.frames[model.getFrameId(frame)]
    return int(known.parentJoint), known.placement.copy()


class MassPath:
    """The centre of mass along the motion: the mass-weighted mean of the links' bounds."""

    def __init__(self, motion: Motion, tree: JointTree, rounding: float) -> None:
        """Collect the moving masses (a mechanism's links are not the robot's to balance)."""
        self._motion = motion
        self._rounding = rounding
        model: pin.Model = motion.robot.model
        owners = mechanism_joints(motion)
        self._joints = [j for j in range(1, model.njoints) if float(model.inertias[j].mass) > 0.0 and j not in owners]
        self._masses = np.array([float(model.inertias[j].mass) for j in self._joints])
        self._levers = np.array([model.inertias[j].lever for j in self._joints]).reshape(-1, 3)
        if len(self._joints) == 0:
            raise VerifyError("the robot has no mass, so its balance cannot be checked")
        self._chains = [tree.chain(0, j, lever[None]) for j, lever in zip(self._joints, self._levers, strict=True)]

    def at(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3"]:
        """Centre of mass in the world [m]."""
        placed = placements(self._motion.robot.model, self._motion.curve(s))
        centres = (placed.rotation[:, self._joints] @ self._levers[..., None])[..., 0]
        centres = centres + placed.translation[:, self._joints]
        return np.asarray((self._masses[:, None] * centres).sum(axis=1) / self._masses.sum())

    def deviation(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I"]:
        """How far the centre of mass may leave its chord [m]."""
        over = intervals(self._motion.curve, first, last, self._motion.samples)
        total = np.zeros(len(first))
        for mass, chain in zip(self._masses, self._chains, strict=True):
            total += mass * (chain.deviation(over) + chain.sampling_slack(over, self._rounding))
        return np.asarray(total / self._masses.sum())


def mechanism_joints(motion: Motion) -> frozenset[int]:
    """Joints that carry a mechanism's links and nothing of the robot."""
    return frozenset(b.joint for b in motion.robot.bodies if b.link in motion.mechanism_links and b.joint > 0)
