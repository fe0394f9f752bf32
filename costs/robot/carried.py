"""Movable objects, and a robot some of whose links carry them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.names import would_do
from costs.primitive import Primitive
from costs.robot import shapes
from costs.robot.elements.inertia import LinkInertia
from costs.robot.errors import RobotError
from costs.robot.mesh.hull import make_outer_hull
from costs.robot.model import LinkBody, RobotModel


@dataclass(frozen=True, eq=False)
class MovableObject:
    """A rigid convex object that hands may carry.

    Attributes:
        name: of its frame and its body in a robot that carries it.
        vertices: (V, 3) of its hull, all of them extreme, in its own frame [m].
        inertia: mass in its own frame.
        start: (4, 4) its pose in the world at the start of a motion.
        exact: the round shape that the hull contains, in its own frame; None for any other shape.
    """

    name: str
    vertices: Float[np.ndarray, "V 3"]
    inertia: LinkInertia
    start: Float[np.ndarray, "4 4"]
    exact: Primitive | None = None


@dataclass(frozen=True)
class PlacedObject:
    """An object at its place.

    Attributes:
        item: the object.
        link: frame of the robot that carries it; None for the world.
        pose: (4, 4) of the object in that frame.
    """

    item: MovableObject
    link: str | None
    pose: Float[np.ndarray, "4 4"]


def with_objects(robot: RobotModel, placed: Sequence[PlacedObject]) -> RobotModel:
    """Return the robot with objects fixed to its links or to the world; its joints stay as they are.

    What a link carries adds to the robot's mass, what the world carries does not.  The robot's files do not have them.

    Raises:
        RobotError: a name in use, an unknown link, or an inertia that no body has.
    """
    if not placed:
        return robot
    model, bodies = robot.model.copy(), list(robot.bodies)
    still = set[str]()
    for each in placed:
        item = each.item
        if model.existFrame(item.name) or item.name in {body.name for body in bodies}:
            raise RobotError(f"object '{item.name}': the name is in use by {robot.name}; choose another")
        joint, pose = _locate(model, robot, each)
        model.addBodyFrame(item.name, joint, pin.SE3(pose), -1)
        if joint > 0:
            model.appendBodyToJoint(joint, item.inertia.make(f"object '{item.name}'"), pin.SE3(pose))
        else:
            still.add(item.name)
        vertices = np.asarray(item.vertices @ pose[:3, :3].T + pose[:3, 3])
        exact = None if item.exact is None else item.exact.move(pose)
        outer = make_outer_hull(vertices) if exact is None else shapes.make_swept_hull(exact, vertices)
        bodies.append(LinkBody(item.name, item.name, joint, vertices, outer, exact))
    return replace(robot, model=model, bodies=tuple(bodies), fixed_links=robot.fixed_links | still)


def _locate(model: pin.Model, robot: RobotModel, each: PlacedObject) -> tuple[int, Float[np.ndarray, "4 4"]]:
    """Return the joint that carries an object, and its pose in the frame of that joint.

    Raises:
        RobotError: the robot has no such link.
    """
    if each.link is None:
        return 0, each.pose
    if not model.existFrame(each.link):
        links = [frame.name for frame in model.frames]
        raise RobotError(
            f"object '{each.item.name}': unknown link '{each.link}' of {robot.name}; expected "
            f"{would_do(each.link, links)}"
        )
    frame = model.frames[model.getFrameId(each.link)]
    return int(frame.parentJoint), np.asarray(frame.placement.homogeneous @ each.pose)
