"""Points and directions of the robot along the curve: values at poses, and how far they leave their chords between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.verify.chain import Chain
from service.verify.errors import VerifyError
from service.verify.motion import Motion
from service.verify.rates import Intervals
from service.verify.track import Track


@dataclass(frozen=True)
class FramePath:
    """Points (in a frame) and that frame's axes along the motion, as seen from the world or from another frame.

    Attributes:
        track: the motion.
        joint: pinocchio joint that carries the frame.
        points: (C, 3) in the frame of that joint [m].
        rotation: (3, 3) rotation_joint_frame.
        holder: pinocchio joint that carries the frame they are seen from (0: the world).
        pose_holder_reference: that frame in its joint's.
        chain: joints that move the points as seen from there.
        turning: the same chain with unit reach, for directions fixed in the frame.
        rounding: error of a written coordinate.
    """

    track: Track
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
        track: Track,
        frame: str,
        points: Float[np.ndarray, "C 3"],
        rounding: float,
        reference: str | None = None,
    ) -> FramePath:
        """Path of points given in the named frame, as seen from the frame ``reference`` (None: from the world).

        Raises:
            VerifyError: when the model has no such frame.
        """
        joint, pose_joint_frame = _carried(track.motion.robot.model, frame)
        holder, pose_holder_reference = (0, pin.SE3.Identity())
        if reference is not None:
            holder, pose_holder_reference = _carried(track.motion.robot.model, reference)
        placed = points @ pose_joint_frame.rotation.T + pose_joint_frame.translation
        chain = track.tree.chain(holder, joint, placed)
        reach = np.where(chain.is_revolute, 1.0, 0.0)
        turning = Chain(chain.coordinates, chain.joints, chain.is_revolute, reach, chain.base_rotations)
        rotation = np.array(pose_joint_frame.rotation)
        return FramePath(track, joint, placed, rotation, holder, pose_holder_reference, chain, turning, rounding)

    def at(self, s: Float[np.ndarray, "S"]) -> tuple[Float[np.ndarray, "S C 3"], Float[np.ndarray, "S 3 3"]]:
        """Points and the frame's axes as seen from the reference (rotation_reference_frame)."""
        placed, rows = self.track.at(s)
        rotation, translation = placed.relative(self.holder, self.joint, rows)
        points = self.points @ np.swapaxes(rotation, -1, -2) + translation[:, None]
        reference = self.pose_holder_reference
        points = (points - reference.translation) @ reference.rotation
        return points, reference.rotation.T @ rotation @ self.rotation

    def stretches(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Intervals:
        """Derivative bounds of the curve on these stretches."""
        return self.track.over(first, last)

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

    def __init__(self, track: Track, rounding: float) -> None:
        """Collect the moving masses (a mechanism's links are not the robot's to balance)."""
        self._track = track
        self._rounding = rounding
        model: pin.Model = track.motion.robot.model
        owners = mechanism_joints(track.motion)
        self._joints = [j for j in range(1, model.njoints) if float(model.inertias[j].mass) > 0.0 and j not in owners]
        self._masses = np.array([float(model.inertias[j].mass) for j in self._joints])
        self._levers = np.array([model.inertias[j].lever for j in self._joints]).reshape(-1, 3)
        if len(self._joints) == 0:
            raise VerifyError("the robot has no mass, so its balance cannot be checked")
        levers = zip(self._joints, self._levers, strict=True)
        self._chains = Chain.stack([track.tree.chain(0, j, lever[None]) for j, lever in levers])

    def at(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3"]:
        """Centre of mass in the world [m]."""
        placed, rows = self._track.at(s)
        each = rows[:, None], np.array(self._joints)
        centres = (placed.rotation[each] @ self._levers[..., None])[..., 0] + placed.translation[each]
        return np.asarray((self._masses[:, None] * centres).sum(axis=1) / self._masses.sum())

    def deviation(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I"]:
        """How far the centre of mass may leave its chord [m]."""
        stretch, mass = (index.ravel() for index in np.indices((len(first), len(self._masses))))
        over, chains = self._track.over(first, last).take(stretch), self._chains.take(mass)
        each = chains.deviation(over) + chains.sampling_slack(over, self._rounding)
        return np.asarray(each.reshape(len(first), -1) @ self._masses / self._masses.sum())


def mechanism_joints(motion: Motion) -> frozenset[int]:
    """Joints that carry a mechanism's links and nothing of the robot."""
    return frozenset(b.joint for b in motion.robot.bodies if b.link in motion.mechanism_links and b.joint > 0)
