"""Paths of frames and of the centre of mass: values at poses, and bounds of their distance from chords between."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.verify.joint_chain import JointChain
from service.verify.motion import Motion, VerifyError
from service.verify.prepared_motion import ForwardKinematics, PreparedMotion


@dataclass(frozen=True)
class FramePath:
    """Points (in a frame) and that frame's axes along the motion, as seen from the world or from another frame.

    Attributes:
        joint: pinocchio joint that carries the frame.
        points: (C, 3) in the frame of that joint [m].
        rotation: (3, 3) rotation_joint_frame.
        holder: pinocchio joint that carries the frame they are seen from (0: the world).
        pose_holder_reference: that frame in its joint's.
        chain: joints that move the points as seen from there.
        turning: the same chain with unit reach, for directions fixed in the frame.
        rounding: error of a written coordinate.
    """

    prepared: PreparedMotion
    joint: int
    points: Float[np.ndarray, "C 3"]
    rotation: Float[np.ndarray, "3 3"]
    holder: int
    pose_holder_reference: pin.SE3
    chain: JointChain
    turning: JointChain
    rounding: float

    @staticmethod
    def of(
        prepared: PreparedMotion,
        frame: str,
        points: Float[np.ndarray, "C 3"],
        rounding: float,
        reference: str | None = None,
    ) -> FramePath:
        """Return the path of points given in a frame, as seen from the frame ``reference`` (None: from the world).

        Raises:
            VerifyError: when the model has no such frame.
        """
        joint, pose_joint_frame = _carrying_joint(prepared.motion.robot.model, frame)
        holder, pose_holder_reference = (0, pin.SE3.Identity())
        if reference is not None:
            holder, pose_holder_reference = _carrying_joint(prepared.motion.robot.model, reference)
        placed = points @ pose_joint_frame.rotation.T + pose_joint_frame.translation
        chain = prepared.tree.chain(holder, joint, placed)
        reach = np.where(chain.is_revolute, 1.0, 0.0)
        turning = replace(chain, reach=reach)
        rotation = np.array(pose_joint_frame.rotation)
        return FramePath(prepared, joint, placed, rotation, holder, pose_holder_reference, chain, turning, rounding)

    def at(self, s: Float[np.ndarray, "S"]) -> tuple[Float[np.ndarray, "S C 3"], Float[np.ndarray, "S 3 3"]]:
        """Return the points, and the frame's axes as seen from the reference (rotation_reference_frame)."""
        placed, rows = self.prepared.at(s)
        rotation, translation = placed.relative(self.holder, self.joint, rows)
        points = self.points @ np.swapaxes(rotation, -1, -2) + translation[:, None]
        reference = self.pose_holder_reference
        points = (points - reference.translation) @ reference.rotation
        return points, reference.rotation.T @ rotation @ self.rotation

    def origin_at(self, s: float) -> Float[np.ndarray, "3"]:
        """Return the first point at one path parameter."""
        return np.asarray(self.at(np.array([s]))[0][0, 0])

    def point_deviation(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I"]:
        """Bound the distance of any of the points from its chord on these intervals [m]."""
        return self._deviation(self.chain, first, last)

    def direction_deviation(
        self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]
    ) -> Float[np.ndarray, "I"]:
        """Bound the distance of the tip of a unit vector fixed in the frame from its chord on these intervals [-]."""
        return self._deviation(self.turning, first, last)

    def turning_angle(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I"]:
        """Bound the turns of the frame along these intervals, and to and from a pose read between samples [rad]."""
        over = self.prepared.over(first, last)
        slack = self.turning.sampling_slack(over, self.rounding)
        # An angle is at most pi / 2 times the chord between its arms, which is what the slack bounds.
        return np.asarray(self.turning.travel(over) + np.pi * slack)

    def _deviation(
        self, chain: JointChain, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]
    ) -> Float[np.ndarray, "I"]:
        over = self.prepared.over(first, last)
        return np.asarray(chain.deviation(over) + chain.sampling_slack(over, self.rounding))


def trace_frame(
    model: pin.Model, frame: str, q: Float[np.ndarray, "S n"]
) -> tuple[Float[np.ndarray, "S 3 3"], Float[np.ndarray, "S 3"]]:
    """Return a frame's rotations and positions in the world at configurations.

    Raises:
        VerifyError: when the model has no such frame.
    """
    joint, pose_joint_frame = _carrying_joint(model, frame)
    placed = ForwardKinematics(model).at(q)
    rotation, position = placed.rotation[:, joint], placed.translation[:, joint]
    return rotation @ pose_joint_frame.rotation, rotation @ pose_joint_frame.translation + position


def _carrying_joint(model: pin.Model, frame: str) -> tuple[int, pin.SE3]:
    """Return the joint that carries a frame, and pose_joint_frame.

    Raises:
        VerifyError: when the model has no such frame.
    """
    if not model.existFrame(frame):
        raise VerifyError(f"unknown frame '{frame}'; the robot has {', '.join(f.name for f in model.frames)}")
    known = model.frames[model.getFrameId(frame)]
    return int(known.parentJoint), known.placement.copy()


class MassPath:
    """Centre of mass along the motion; its bound is the mass-weighted mean of the links' bounds."""

    def __init__(self, prepared: PreparedMotion, rounding: float) -> None:
        """Collect the moving masses; those of a mechanism do not count."""
        self._prepared_motion = prepared
        self._rounding = rounding
        model: pin.Model = prepared.motion.robot.model
        owners = find_mechanism_joints(prepared.motion)
        self._joints = [j for j in range(1, model.njoints) if float(model.inertias[j].mass) > 0.0 and j not in owners]
        self._masses = np.array([float(model.inertias[j].mass) for j in self._joints])
        self._levers = np.array([model.inertias[j].lever for j in self._joints]).reshape(-1, 3)
        if len(self._joints) == 0:
            raise VerifyError("the robot has no mass, so its balance cannot be checked")
        levers = zip(self._joints, self._levers, strict=True)
        self._chains = JointChain.stack([prepared.tree.chain(0, j, lever[None]) for j, lever in levers])

    def at(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3"]:
        """Return the centre of mass in the world [m]."""
        placed, rows = self._prepared_motion.at(s)
        each = rows[:, None], np.array(self._joints)
        centres = (placed.rotation[each] @ self._levers[..., None])[..., 0] + placed.translation[each]
        return np.asarray((self._masses[:, None] * centres).sum(axis=1) / self._masses.sum())

    def deviation(self, first: Float[np.ndarray, "I"], last: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I"]:
        """Bound the distance of the centre of mass from its chord on these intervals [m]."""
        interval, mass = (index.ravel() for index in np.indices((len(first), len(self._masses))))
        over, chains = self._prepared_motion.over(first, last).take(interval), self._chains.take(mass)
        each = chains.deviation(over) + chains.sampling_slack(over, self._rounding)
        return np.asarray(each.reshape(len(first), -1) @ self._masses / self._masses.sum())


def find_mechanism_joints(motion: Motion) -> frozenset[int]:
    """Return the joints that carry a mechanism's links."""
    return frozenset(b.joint for b in motion.robot.bodies if b.link in motion.mechanism_links and b.joint > 0)
