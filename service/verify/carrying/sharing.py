"""How hands share the weight of what they carry together: a split of forces that does not change the ground's.

The robot's model has the whole object on the leading hand.  Every further hand takes a share of its weight as a force
upwards at the middle of its fingers, the shares being those of a beam on two supports; the leading hand keeps the rest.
Stiff servos could also press the hands against each other; the split that is commanded here does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.stopping import poll
from costs.work_space import borrow_data
from service.verify.carrying.carriers import Carrier, Grip
from service.verify.motion import Motion, Phase

GRAVITY = 9.81

Carried = Callable[[int, Float[np.ndarray, "S 6"]], Float[np.ndarray, "S n"]]
"""Returns the generalised forces of wrenches about the world's origin on what a joint carries."""


@dataclass(frozen=True)
class _Spot:
    """Middle of a grip's fingers.

    Attributes:
        joint: that carries the hand.
        fingers: joint and (3,) place in its frame, of each finger.
    """

    joint: int
    fingers: tuple[tuple[int, Float[np.ndarray, "3"]], ...]

    def locate(self, data: pin.Data) -> Float[np.ndarray, "3"]:
        return np.asarray(np.mean([data.oMi[joint].act(place) for joint, place in self.fingers], axis=0))


def share_weight(
    motion: Motion, phase: Phase, q: Float[np.ndarray, "S n"], carried: Carried
) -> Float[np.ndarray, "S n"] | None:
    """Return what the sharing of hands adds to the torques of a phase; None where no two hands carry anything.

    Args:
        motion: with its objects as links of the robot.
        phase: of it.
        q: (S, n) configurations.
        carried: of the robot.
    """
    shared = [carrier for carrier in phase.carriers if len(carrier.grips) > 1]
    if not shared:
        return None
    torque = np.zeros((len(q), motion.robot.n))
    for carrier in shared:
        for joint, wrench in _list_wrenches(motion, carrier, q):
            torque += carried(joint, wrench)
    return torque


def _list_wrenches(
    motion: Motion, carrier: Carrier, q: Float[np.ndarray, "S n"]
) -> Iterator[tuple[int, Float[np.ndarray, "S 6"]]]:
    """Yield joints with the wrenches that they make besides those of the model, about the world's origin [N, N m]."""
    model = motion.robot.model
    data = borrow_data(model)
    item = next(item for item in motion.objects if item.name == carrier.item)
    frame = model.frames[model.getFrameId(item.name)]
    lead = int(frame.parentJoint)
    centre = frame.placement.act(item.inertia.centre)
    first, *others = (_find_spot(motion, grip) for grip in carrier.grips)
    weight = GRAVITY * item.inertia.mass / len(others)
    wrenches = np.zeros((len(others), len(q), 6))
    for k, row in enumerate(q):
        poll()
        pin.forwardKinematics(model, data, row)
        here, middle = first.locate(data), data.oMi[lead].act(centre)
        for number, spot in enumerate(others):
            there = spot.locate(data)
            along = there - here
            share = float(np.clip((middle - here) @ along / max(float(along @ along), 1e-12), 0.0, 1.0))
            force = np.array([0.0, 0.0, share * weight])
            wrenches[number, k] = np.concatenate([force, np.cross(there, force)])
    for spot, wrench in zip(others, wrenches, strict=True):
        yield spot.joint, wrench
        yield lead, -wrench


def _find_spot(motion: Motion, grip: Grip) -> _Spot:
    """Return the middle of a grip's fingers, and the joint that carries them."""
    bodies = [body for body in motion.robot.bodies if body.link in grip.fingers]
    parents = motion.robot.model.parents
    return _Spot(int(parents[bodies[0].joint]), tuple((body.joint, body.vertices.mean(axis=0)) for body in bodies))
