"""Phases of getting out on one side of a vehicle, mirrored for the other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from costs.robot import RobotModel
from service.request.tasks.contacts import PostureRequest
from service.request.tasks.egress import ContactRequest, PhaseRequest, SideRequest

OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}
SIDE_WORD = re.compile("(?<![A-Za-z])(left|right|l|r)(?![A-Za-z])")
FLIP_Y = np.array([1.0, -1.0, 1.0])


def mirror_phases(robot: RobotModel, phases: Sequence[PhaseRequest]) -> tuple[PhaseRequest, ...]:
    """Return the phases mirrored in the plane y = 0: left patches, links and joints for right ones, and y for -y.

    Names of surfaces stay.  What has no counterpart on the other side of the robot, such as its back, keeps its name.
    """
    signs = _find_signs(robot)
    return tuple(
        replace(
            phase,
            name=swap_sides(phase.name),
            contacts={swap_sides(patch): _mirror_contact(contact) for patch, contact in phase.contacts.items()},
            postures=tuple(_mirror_posture(posture, signs) for posture in phase.postures),
            sides=tuple(_mirror_side(side) for side in phase.sides),
        )
        for phase in phases
    )


def swap_sides(name: str) -> str:
    """Return a name with left for right and right for left, such as ``l_foot`` for ``r_foot``."""
    return SIDE_WORD.sub(lambda found: OTHER[found.group()], name)


def _find_signs(robot: RobotModel) -> dict[str, float]:
    """Return by joint the sign with which its mirrored position is that of its counterpart.

    The mirror image of a turn about an axis is one about the negative image of the axis.
    """
    model = robot.model
    data = model.createData()
    jacobians = pin.computeJointJacobians(model, data, np.zeros(model.nq))
    columns = {name: jacobians[:, i] for i, name in enumerate(robot.joint_names)}
    mirrored = np.concatenate([FLIP_Y, -FLIP_Y])
    return {
        name: -1.0 if float(columns[swap_sides(name)] @ (mirrored * column)) < 0.0 else 1.0
        for name, column in columns.items()
        if swap_sides(name) in columns
    }


def _mirror_contact(contact: ContactRequest) -> ContactRequest:
    yaw = None if contact.yaw_deg is None else -contact.yaw_deg
    return replace(contact, at=_mirror_point(contact.at), toe=_mirror_point(contact.toe), yaw_deg=yaw)


def _mirror_posture(posture: PostureRequest, signs: Mapping[str, float]) -> PostureRequest:
    x, y, z, yaw, pitch, roll = posture.base
    joints = {swap_sides(name): signs.get(name, 1.0) * value for name, value in posture.joints.items()}
    return replace(posture, base=(x, -y, z, -yaw, pitch, -roll), joints=joints)


def _mirror_side(side: SideRequest) -> SideRequest:
    normal, point = _mirror_point(side.normal), _mirror_point(side.point)
    assert normal is not None
    assert point is not None
    return replace(side, link=swap_sides(side.link), normal=normal, point=point)


def _mirror_point(point: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    return None if point is None else (point[0], -point[1], point[2])
