"""Mechanisms that a task moves (a wheel, a door with its lever), and a robot augmented by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.primitive import Primitive
from costs.robot.elements.inertia import LinkInertia
from costs.robot.errors import RobotError
from costs.robot.mesh.hull import find_hull_vertices, make_outer_hull
from costs.robot.model import LinkBody, RobotModel

JointKind = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class MechanismJoint:
    """A joint of a mechanism, with the link that it moves.

    Everything is described in the world with all joints of the mechanism at 0.

    Attributes:
        name: the joint's name.
        link: the name of its link, and of the link's frame, which has the world's axes at 0.
        origin: (3,) a point on the axis [m].
        axis: (3,) direction; a revolute joint turns right-handed about it, a prismatic one moves along it.
        bodies: vertices of the link's convex bodies by name [m].
        kind: ``revolute`` or ``prismatic``.
        parent: the link that carries the joint; None for the world.
        lower, upper: limits [rad, m].
        start: value at the start of a motion [rad, m].
        velocity, acceleration: limits [rad/s or m/s, rad/s^2 or m/s^2].
        exact: by name the round shapes that bodies contain.
        inertia: mass of the link, in the world with all joints at 0; None for a link without mass.
        friction: dry friction [N m, N].
        damping: [N m s/rad, N s/m].
    """

    name: str
    link: str
    origin: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    bodies: Mapping[str, Float[np.ndarray, "V 3"]]
    kind: JointKind = "revolute"
    parent: str | None = None
    lower: float = -np.pi
    upper: float = np.pi
    start: float = 0.0
    velocity: float = 1.0
    acceleration: float = 2.0
    exact: Mapping[str, Primitive] = field(default_factory=dict)
    inertia: LinkInertia | None = None
    friction: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class Release:
    """A rule of a latched mechanism: a joint stays at 0 until another one releases it.

    Attributes:
        joint: the joint that is locked at 0.
        latch: the joint that releases it.
        latch_at: value of ``latch`` from which on it releases; of its sign, and beyond it [rad, m].
        free_beyond: once past this value the joint moves freely, whatever the latch does [rad, m].
    """

    joint: str
    latch: str
    latch_at: float
    free_beyond: float = float(np.deg2rad(5.0))


@dataclass(frozen=True)
class Mechanism:
    """A tree of joints that a task moves.

    Attributes:
        name: of the whole, in messages (``valve``, ``door``); its links are named like it or ``NAME/...``.
        joints: parents before children.
        releases: rules of its latches.
    """

    name: str
    joints: tuple[MechanismJoint, ...]
    releases: tuple[Release, ...] = field(default=())

    @property
    def start(self) -> Float[np.ndarray, "k"]:
        """(k,) values of the joints at the start [rad, m]."""
        return np.array([joint.start for joint in self.joints])

    def joint(self, name: str) -> MechanismJoint:
        """Return the joint of a name (KeyError if there is none)."""
        return {joint.name: joint for joint in self.joints}[name]

    def locate(self, link: str, values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a link in the world, with the joints at ``values`` [rad, m]."""
        from scipy.spatial.transform import Rotation  # slow to import

        by_link = {joint.link: column for column, joint in enumerate(self.joints)}
        pose, above = np.eye(4), link
        while True:
            joint = self.joints[by_link[above]]
            value, axis = float(values[by_link[above]]), joint.axis / np.linalg.norm(joint.axis)
            step = np.eye(4)
            step[:3, 3] = joint.origin
            if joint.parent is not None:
                step[:3, 3] -= self.joints[by_link[joint.parent]].origin
            if joint.kind == "prismatic":
                step[:3, 3] += value * axis
            else:
                step[:3, :3] = Rotation.from_rotvec(value * axis).as_matrix()
            pose = step @ pose
            if joint.parent is None:
                return pose
            above = joint.parent


def with_mechanism(robot: RobotModel, joints: Sequence[MechanismJoint]) -> RobotModel:
    """Return the robot with the joints of a mechanism, fixed in the world, as its last coordinates.

    The new links have no mass, so that the model's weight, centre of mass and torques stay the robot's; what the
    mechanism's masses demand of a hand follows from ``make_mechanism_model``.

    Args:
        robot: the robot.
        joints: parents before children; the names become the last of ``joint_names``. Efforts are unlimited.

    Raises:
        RobotError: for names in use, an unknown parent, a zero axis, limits the wrong way round, a start beyond them,
            values that are not finite.
    """
    for joint in joints:
        robot = _with_joint(robot, joint)
    return robot


def make_mechanism_model(joints: Sequence[MechanismJoint]) -> pin.Model:
    """Return the joints and masses of a mechanism alone, fixed in the world, with gravity along -z.

    Args:
        joints: parents before children; their order is that of the coordinates.
    """
    model = pin.Model()
    for joint in joints:
        origin = np.asarray(joint.origin, dtype=float)
        parent, place = _locate_parent(model, joint, origin)
        index = model.addJoint(parent, _make_joint(joint), pin.SE3(np.eye(3), place), joint.name)
        own = joint.inertia
        inertia = pin.Inertia.Zero() if own is None else pin.Inertia(own.mass, own.centre - origin, own.moments)
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        model.addJointFrame(index)
        model.addBodyFrame(joint.link, index, pin.SE3.Identity(), -1)
    return model


def read_joint_axis(robot: RobotModel, joint: int) -> Float[np.ndarray, "6"]:
    """Return the motion axis (linear, angular) of a joint with one coordinate at 0, in its own frame."""
    made = robot.model.joints[joint]
    data = made.createData()
    made.calc(data, np.zeros(robot.n), np.zeros(robot.n))
    return np.asarray(data.S).reshape(6, -1)[:, -1]


def _with_joint(robot: RobotModel, joint: MechanismJoint) -> RobotModel:
    origin, axis = np.asarray(joint.origin, dtype=float), np.asarray(joint.axis, dtype=float)
    _check_names(robot, joint)
    _check_values(joint, origin, axis)
    model = robot.model.copy()
    parent, place = _locate_parent(model, joint, origin)
    index = model.addJoint(parent, _make_joint(joint), pin.SE3(np.eye(3), place), joint.name)
    model.appendBodyToJoint(index, pin.Inertia.Zero(), pin.SE3.Identity())
    model.addJointFrame(index)
    model.addBodyFrame(joint.link, index, pin.SE3.Identity(), -1)
    return replace(
        robot,
        model=model,
        joint_names=(*robot.joint_names, joint.name),
        lower=np.append(robot.lower, joint.lower),
        upper=np.append(robot.upper, joint.upper),
        velocity=np.append(robot.velocity, joint.velocity),
        acceleration=np.append(robot.acceleration, joint.acceleration),
        effort=np.append(robot.effort, np.inf),
        bodies=(*robot.bodies, *_make_bodies(joint, int(index), origin)),
        postures={key: np.append(posture, joint.start) for key, posture in robot.postures.items()},
        mechanism_links=robot.mechanism_links | {joint.link},
    )


def _make_joint(joint: MechanismJoint) -> pin.JointModel:
    unit = np.asarray(joint.axis, dtype=float) / np.linalg.norm(joint.axis)
    is_turning = joint.kind == "revolute"
    return pin.JointModelRevoluteUnaligned(unit) if is_turning else pin.JointModelPrismaticUnaligned(unit)


def _locate_parent(
    model: pin.Model, joint: MechanismJoint, origin: Float[np.ndarray, "3"]
) -> tuple[int, Float[np.ndarray, "3"]]:
    """Return the parent joint's index and the new joint's place in its frame; all frames have the world's axes at 0."""
    if joint.parent is None:
        return 0, origin
    parent = int(model.frames[model.getFrameId(joint.parent)].parentJoint)
    place, above = origin.copy(), parent
    while above > 0:
        place = place - np.array(model.jointPlacements[above].translation)
        above = int(model.parents[above])
    return parent, place


def _make_bodies(joint: MechanismJoint, index: int, origin: Float[np.ndarray, "3"]) -> tuple[LinkBody, ...]:
    made, to_joint = [], np.eye(4)
    to_joint[:3, 3] = -origin
    for name, points in joint.bodies.items():
        words = f"body '{name}' of link '{joint.link}'"
        vertices = find_hull_vertices(np.asarray(points, dtype=float) - origin, words)
        round_shape = joint.exact.get(name)
        exact = None if round_shape is None else round_shape.move(to_joint)
        made.append(LinkBody(name, joint.link, index, vertices, make_outer_hull(vertices), exact))
    return tuple(made)


def _check_names(robot: RobotModel, joint: MechanismJoint) -> None:
    if joint.name in robot.joint_names:
        raise RobotError(f"joint name '{joint.name}' is in use by {robot.name}; choose another")
    if robot.model.existFrame(joint.link):
        raise RobotError(f"link name '{joint.link}' is in use by {robot.name}; choose another")
    if joint.parent is not None and joint.parent not in robot.mechanism_links:
        raise RobotError(f"joint '{joint.name}': its parent '{joint.parent}' is no link of the mechanism before it")
    taken = {body.name for body in robot.bodies}
    for body, points in joint.bodies.items():
        if body in taken:
            raise RobotError(f"body name '{body}' is in use by {robot.name}; choose another")
        if not np.all(np.isfinite(points)):
            raise RobotError(f"body '{body}' of link '{joint.link}' has a vertex that is not finite")


def _check_values(joint: MechanismJoint, origin: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]) -> None:
    if joint.kind not in ("revolute", "prismatic"):
        raise RobotError(f"joint '{joint.name}' is {joint.kind!r}; expected revolute or prismatic")
    if origin.shape != (3,) or axis.shape != (3,) or not np.all(np.isfinite([origin, axis])):
        raise RobotError(f"joint '{joint.name}': origin and axis must be three finite numbers each")
    if np.linalg.norm(axis) < 1e-9:
        raise RobotError(f"joint '{joint.name}': axis is zero; give it a direction")
    limits = [joint.lower, joint.upper, joint.velocity, joint.acceleration]
    if not (joint.lower <= joint.upper and joint.velocity > 0.0 and joint.acceleration > 0.0):
        raise RobotError(
            f"joint '{joint.name}': lower must not exceed upper, velocity and acceleration must be positive; "
            f"got {limits}"
        )
    if not joint.lower <= joint.start <= joint.upper:
        raise RobotError(f"joint '{joint.name}' starts at {joint.start}, outside {joint.lower} to {joint.upper}")
