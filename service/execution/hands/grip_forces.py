"""Forces with which the fingers of a gripper press what they hold, as torques of their joints over a plan."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import read_joint_axis
from costs.work_space import borrow_data
from service.verify import Carrier, Held, Motion, Phase, PreparedMotion

RAMP_S = 0.2  # in which a grip tightens before it lifts, and loosens after it has put down


class GripForces:
    """The grips of a motion's phases."""

    def __init__(self, motion: Motion) -> None:
        self._torques = np.zeros((max(len(motion.phases), 1), motion.robot.n))
        if not motion.objects:
            return
        prepared = PreparedMotion(motion)
        for k, phase in enumerate(prepared.phases):
            for carrier in phase.carriers:
                if carrier.link is not None:
                    self._torques[k] += _press(prepared.in_phase(phase), phase, carrier)

    def list_torques(self, k: int, t: Float[np.ndarray, "S"], begin_s: float, end_s: float) -> Float[np.ndarray, "S n"]:
        """Return the torques of the fingers' joints at times of a phase [N, N m]."""
        own = self._torques[k]
        if own.any():
            return np.tile(own, (len(t), 1))
        ramp = min(RAMP_S, max(0.5 * (end_s - begin_s), 1e-6))
        total = np.zeros((len(t), len(own)))
        if k + 1 < len(self._torques):
            total += np.clip(1.0 - (end_s - t) / ramp, 0.0, 1.0)[:, None] * self._torques[k + 1]
        if k:
            total += np.clip(1.0 - (t - begin_s) / ramp, 0.0, 1.0)[:, None] * self._torques[k - 1]
        return total


def _press(prepared: PreparedMotion, phase: Phase, carrier: Carrier) -> Float[np.ndarray, "n"]:
    """Return the torques with which the fingers of a carrier press along the normals of their pads."""
    motion = prepared.motion
    item = next(item for item in motion.objects if item.name == carrier.item)
    held = Held(prepared, item, carrier, ())
    robot, model = motion.robot, motion.robot.model
    data, torque = borrow_data(model), np.zeros(robot.n)
    pin.forwardKinematics(model, data, motion.curve(np.array([phase.first]))[0])
    holder = np.array(data.oMi[held.body.joint].rotation)
    for pad in held.list_pads(phase.first):
        joint = int(model.frames[model.getFrameId(pad.finger)].parentJoint)
        axis = read_joint_axis(robot, joint)
        along = np.array(data.oMi[joint].rotation) @ axis[:3]
        torque[int(model.joints[joint].idx_v)] += pad.grip.force_n * float(along @ holder @ pad.normal)
    return torque
