"""Joint servos of a robot: stiffness by default, damping, and how a table of stiffness by group is read."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from costs.robot.model import BASE_NAMES, RobotModel

DAMPING_S = 0.03  # damping of a servo, per stiffness [s]
GRAVITY = 9.81
ATLAS_STIFFNESS: Mapping[str, float] = {"leg": 16_000.0, "back": 12_000.0, "arm": 3_200.0, "neck": 3_200.0}
# Of a robot without a table: full effort at this deflection, and legs that hold it upright with a reserve.
FULL_EFFORT_AT = 0.05  # [rad]
FULL_EFFORT_AT_M = 0.005  # of a prismatic joint [m]
UPRIGHT_RESERVE = 8.0  # stiffness of a leg's joint, in units of weight times height of the centre of mass


def list_servo_joints(robot: RobotModel) -> tuple[str, ...]:
    """Return the actuated joints: all but the base's and those of a task's mechanism."""
    first = len(BASE_NAMES) if robot.is_floating else 0
    carried = {int(body.joint) for body in robot.bodies if body.link in robot.mechanism_links}
    moved = {robot.model.names[joint] for joint in carried}
    return tuple(name for name in robot.joint_names[first:] if name not in moved)


def default_stiffness(robot: RobotModel) -> dict[str, float]:
    """Return the stiffness of every servo by joint [N m/rad, N/m].

    The bundled Atlas has a table by joint group.  Any other robot reaches its effort at 0.05 rad (5 mm), and the joints
    between its base and its feet are stiff enough to hold its weight upright with a reserve.
    """
    names = list_servo_joints(robot)
    if robot.name == "atlas":
        table = {name: next((k for part, k in ATLAS_STIFFNESS.items() if part in name), None) for name in names}
        if all(value is not None for value in table.values()):
            return {name: float(value) for name, value in table.items() if value is not None}
    upright = _weigh_upright(robot)
    legs = _list_leg_joints(robot)
    stiffness = {}
    for name in names:
        index = robot.joint_names.index(name)
        effort = float(robot.effort[index])
        effort = effort if np.isfinite(effort) else 0.0
        is_turning = _is_revolute(robot, name)
        stiffness[name] = effort / (FULL_EFFORT_AT if is_turning else FULL_EFFORT_AT_M)
        if name in legs and is_turning:
            stiffness[name] = max(stiffness[name], UPRIGHT_RESERVE * upright)
    return stiffness


def make_stiffness(robot: RobotModel, groups: Mapping[str, float]) -> Float[np.ndarray, "k"]:
    """Return the stiffness of the servos in their order, with some groups or joints given [N m/rad, N/m].

    Args:
        robot: the robot.
        groups: stiffness by joint, by group of the robot (SRDF), or by a part of joint names (``leg``, ``arm``).

    Raises:
        ValueError: a name that no joint has, with the names that are known.
    """
    table = default_stiffness(robot)
    for group, value in groups.items():
        members = list_group_joints(robot, group)
        if not members:
            known = sorted({*robot.groups, *(ATLAS_STIFFNESS if robot.name == "atlas" else ())})
            raise ValueError(f"unknown joint group '{group}'; expected {', '.join(known) or 'the name of a joint'}")
        table |= dict.fromkeys(members, float(value))
    return np.array([table[name] for name in list_servo_joints(robot)])


def list_group_joints(robot: RobotModel, group: str) -> tuple[str, ...]:
    """Return the servo joints of a group: of that name, of an SRDF group, or with that word in their names."""
    names = list_servo_joints(robot)
    if group in names:
        return (group,)
    if group in robot.groups:
        return tuple(name for name in names if name in robot.groups[group])
    return tuple(name for name in names if group in name.split("_"))


def _weigh_upright(robot: RobotModel) -> float:
    """Return weight times a height of the centre of mass, half the longest way from the base to a foot [N m]."""
    mass = sum(float(inertia.mass) for inertia in robot.model.inertias)
    model = robot.model
    longest = 0.0
    for foot in robot.link_groups.get("feet", ()):
        joint = int(model.frames[model.getFrameId(foot)].parentJoint) if model.existFrame(foot) else 0
        length = 0.0
        while joint > 0 and int(model.parents[joint]) > 0:
            length += float(np.linalg.norm(model.jointPlacements[joint].translation))
            joint = int(model.parents[joint])
        longest = max(longest, length)
    return mass * GRAVITY * longest


def _list_leg_joints(robot: RobotModel) -> frozenset[str]:
    """Return the joints between the base and the feet."""
    model, legs = robot.model, set[str]()
    for foot in robot.link_groups.get("feet", ()):
        joint = int(model.frames[model.getFrameId(foot)].parentJoint) if model.existFrame(foot) else 0
        while joint > 0 and int(model.parents[joint]) > 0:
            legs.add(str(model.names[joint]))
            joint = int(model.parents[joint])
    return frozenset(legs)


def _is_revolute(robot: RobotModel, name: str) -> bool:
    return "P" not in robot.model.joints[robot.model.getJointId(name)].shortname().replace("JointModel", "")[:1]
