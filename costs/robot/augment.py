"""A robot together with the joint of a mechanism it handles, as one augmented model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot.errors import RobotError
from costs.robot.hull import find_hull_vertices, make_outer_hull
from costs.robot.model import LinkBody, RobotModel


def with_revolute(
    robot: RobotModel,
    *,
    name: str,
    origin: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    bodies: Mapping[str, Float[np.ndarray, "V 3"]],
    link: str,
    lower: float,
    upper: float,
    velocity: float,
    acceleration: float,
) -> RobotModel:
    """Return the robot with one more revolute joint, fixed in the world, as its last coordinate.

    The new joint's frame stands at ``origin`` with the world's axes at angle 0. Its link has no mass, so that the
    model's centre of mass stays the robot's.

    Args:
        name: the joint's name, which becomes the last of ``joint_names``.
        origin: a point on the axis, in the world [m].
        axis: direction of the axis in the world; angles turn right-handed about it.
        bodies: vertices in the world at angle 0 by body name [m].
        link: the new link's name; also the name of its frame, which is the joint's.
        lower, upper: limits [rad].
        velocity, acceleration: limits [rad/s, rad/s^2]; the effort is unlimited.

    Raises:
        RobotError: for names in use, a zero axis, limits the wrong way round, values that are not finite.
    """
    origin, axis = np.asarray(origin, dtype=float), np.asarray(axis, dtype=float)
    _check_names(robot, name, link, bodies)
    _check_values(name, origin, axis, np.array([lower, upper, velocity, acceleration]))
    model = robot.model.copy()
    joint = model.addJoint(
        0, pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis)), pin.SE3(np.eye(3), origin), name
    )
    model.appendBodyToJoint(joint, pin.Inertia.Zero(), pin.SE3.Identity())
    model.addJointFrame(joint)
    model.addBodyFrame(link, joint, pin.SE3.Identity(), -1)
    return replace(
        robot,
        model=model,
        joint_names=(*robot.joint_names, name),
        lower=np.append(robot.lower, lower),
        upper=np.append(robot.upper, upper),
        velocity=np.append(robot.velocity, velocity),
        acceleration=np.append(robot.acceleration, acceleration),
        effort=np.append(robot.effort, np.inf),
        bodies=(*robot.bodies, *_make_bodies(bodies, link, int(joint), origin)),
        postures={key: np.append(posture, 0.0) for key, posture in robot.postures.items()},
        mechanism_links=robot.mechanism_links | {link},
    )


def _make_bodies(
    bodies: Mapping[str, Float[np.ndarray, "V 3"]], link: str, joint: int, origin: Float[np.ndarray, "3"]
) -> tuple[LinkBody, ...]:
    made = []
    for name, points in bodies.items():
        vertices = find_hull_vertices(np.asarray(points, dtype=float) - origin, f"body '{name}' of link '{link}'")
        outer = make_outer_hull(vertices)
        made.append(LinkBody(name, link, joint, vertices, outer))
    return tuple(made)


def _check_names(robot: RobotModel, name: str, link: str, bodies: Mapping[str, Float[np.ndarray, "V 3"]]) -> None:
    if name in robot.joint_names:
        raise RobotError(f"joint name '{name}' is in use by {robot.name}; choose another")
    if robot.model.existFrame(link):
        raise RobotError(f"link name '{link}' is in use by {robot.name}; choose another")
    taken = {body.name for body in robot.bodies}
    for body, points in bodies.items():
        if body in taken:
            raise RobotError(f"body name '{body}' is in use by {robot.name}; choose another")
        if not np.all(np.isfinite(points)):
            raise RobotError(f"body '{body}' of link '{link}' has a vertex that is not finite")


def _check_values(
    name: str, origin: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], limits: Float[np.ndarray, "4"]
) -> None:
    if origin.shape != (3,) or axis.shape != (3,) or not np.all(np.isfinite([origin, axis])):
        raise RobotError(f"joint '{name}': origin and axis must be three finite numbers each")
    if np.linalg.norm(axis) < 1e-9:
        raise RobotError(f"joint '{name}': axis is zero; give it a direction")
    lower, upper, velocity, acceleration = limits
    if not (lower <= upper and velocity > 0.0 and acceleration > 0.0):
        raise RobotError(
            f"joint '{name}': lower must not exceed upper, velocity and acceleration must be positive; got {limits}"
        )
