"""Poses that are known before a motion that changes contacts is planned: of an earlier motion, or of a chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.demands.rest.earlier_motion import EarlierMotion
from service.request.tasks.contacts import ContactsRequest
from service.start.configuration import make_posture


@dataclass(frozen=True)
class KnownPoses:
    """Configurations that are known already, and the earlier motion that led through them.

    Attributes:
        leave: by stance that they lead to: in which the contacts that stay hold the robot alone, before others leave.
        arrive: the same when the new contacts are in their places.
        there: in which the stance holds the robot.
        earlier: what an earlier plan did.
    """

    leave: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    arrive: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    there: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    earlier: EarlierMotion = field(default_factory=EarlierMotion)


def make_known_poses(robot: RobotModel, request: ContactsRequest, earlier: EarlierMotion) -> KnownPoses | None:
    """Return the postures that a request moves to and what the earlier motion did before them; None without any.

    An earlier motion of other joints, or without knots, says nothing.

    Raises:
        RequestError: an unknown posture or joint.
    """
    curves = dict(earlier.curves)
    there = {
        stance.name: make_posture(robot, stance.posture, f"task.contacts.stances[{k}].posture")
        for k, stance in enumerate(request.stances)
        if stance.posture is not None
    }
    for name in there:  # a last phase that led to a posture by name leads to it as a stance
        if name in curves:
            curves[f"{name}: move"] = curves[name]
    if not curves and not there:
        return None
    ends = {name: curve.positions[-1] for name, curve in curves.items()}
    leave, arrive = (
        {stance.name: ends[name] for stance in request.stances if (name := f"{stance.name}: {kind}") in ends}
        for kind in ("shift", "land")
    )
    return KnownPoses(leave, arrive, there, replace(earlier, curves=curves))
