"""Contact points of a stance and given loads as arrays: where they are, how they move, how hard they may be pressed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from costs.contact import GRAVITY, Contact
from costs.kinematics import Kinematics, locate_frame
from costs.robot.model import RobotModel
from costs.rotation import make_tangent_basis

_UP = np.array([0.0, 0.0, 1.0])
DOWN = np.array([0.0, 0.0, -1.0])  # the robot's weight in units of itself


def measure_weight(robot: RobotModel) -> float:
    """Return the robot's weight [N]; links of mechanisms have no mass.

    Raises:
        ValueError: the robot has no mass.
    """
    weight = GRAVITY * sum(float(inertia.mass) for inertia in robot.model.inertias)
    if not weight > 0.0:
        raise ValueError(f"robot '{robot.name}' has no mass; equilibrium needs the masses of its links")
    return weight


@dataclass(frozen=True)
class MovedPoints:
    """Points carried by joints.

    Attributes:
        joint: (C,) pinocchio joints; 0 is the world.
        local: (C, 3) in the frame of the joint [m].
    """

    joint: Int[np.ndarray, "C"]
    local: Float[np.ndarray, "C 3"]

    @staticmethod
    def on_links(robot: RobotModel, links: Sequence[str], points: Float[np.ndarray, "C 3"]) -> MovedPoints:
        """Return one point per link, given in the frame of the link.

        Raises:
            KeyError: the robot has no such link.
        """
        joint, local = np.zeros(len(links), dtype=int), np.zeros((len(links), 3))
        for i, link in enumerate(links):
            joint[i], pose = locate_frame(robot, link)
            local[i] = pose[:3, :3] @ points[i] + pose[:3, 3]
        return MovedPoints(joint, local)

    def locate(self, kinematics: Kinematics, waypoints: Int[np.ndarray, "S"]) -> Float[np.ndarray, "S C 3"]:
        """Return the points in the world [m]."""
        rotation = kinematics.rotation[waypoints][:, self.joint]
        return np.asarray(
            np.einsum("sckl,cl->sck", rotation, self.local) + kinematics.position[waypoints][:, self.joint]
        )

    def differentiate(self, kinematics: Kinematics, waypoints: Int[np.ndarray, "S"]) -> Float[np.ndarray, "S C 3 n"]:
        """Return d point / dq in the world."""
        return kinematics.topology.add_followers(self.differentiate_by_axes(kinematics, waypoints))

    def differentiate_by_axes(
        self, kinematics: Kinematics, waypoints: Int[np.ndarray, "S"]
    ) -> Float[np.ndarray, "S C 3 m"]:
        """Return the derivatives of the points by the robot's axes (``costs.kinematics.Topology``)."""
        count = len(self.joint)
        points = self.locate(kinematics, waypoints).reshape(-1, 3)
        rows = kinematics.point_columns(np.repeat(waypoints, count), np.tile(self.joint, len(waypoints)), points)
        return rows.reshape(len(waypoints), count, 3, kinematics.jacobian.shape[2])


@dataclass(frozen=True)
class Load:
    """A force and a moment that the surroundings exert on a link, in world axes whatever the link's pose.

    Attributes:
        link: that carries the load.
        force: (3,) [N].
        moment: (3,) about the point [N m].
        point: (3,) where the force acts, in the frame of the link [m].
    """

    link: str
    force: Float[np.ndarray, "3"]
    moment: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    point: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Loads:
    """Loads as arrays.

    Attributes:
        points: where the forces act.
        force: (C, 3) in world axes [robot's weight].
        moment: (C, 3) in world axes [robot's weight times m].
    """

    points: MovedPoints
    force: Float[np.ndarray, "C 3"]
    moment: Float[np.ndarray, "C 3"]

    @staticmethod
    def of(robot: RobotModel, loads: Sequence[Load]) -> Loads:
        """Return the loads of a robot.

        Raises:
            KeyError: the robot has no such link.
            ValueError: the robot has no mass, or a load is on a link of a mechanism.
        """
        for load in loads:
            _refuse_mechanism(robot, load.link, f"load on {load.link}")
        weight = measure_weight(robot)
        points, force, moment = (
            np.array([getattr(load, name) for load in loads], dtype=float).reshape(-1, 3)
            for name in ("point", "force", "moment")
        )
        return Loads(
            MovedPoints.on_links(robot, [load.link for load in loads], points), force / weight, moment / weight
        )


@dataclass(frozen=True)
class ContactPoints:
    """The points of all contacts of a stance; each has one force.

    Attributes:
        places: the points on the robot's links.
        normal: (C, 3) unit vectors along which the surroundings push, in the frames of ``normal_joint``.
        tangent: (C, 3) unit vectors across them: an edge of each friction pyramid leans to this side.
        normal_joint: (C,) joints that carry the normals: the link's own, or 0 for normals fixed in the world.
        friction: (C,) coefficients of friction.
        cap: (C,) largest normal force [robot's weight]; 0 for a point that is not in use.
        reference_joint: (C,) joints of the mechanism links that are touched; 0 for the world.
        contact: (C,) index of each point's contact in the stance.
    """

    places: MovedPoints
    normal: Float[np.ndarray, "C 3"]
    tangent: Float[np.ndarray, "C 3"]
    normal_joint: Int[np.ndarray, "C"]
    friction: Float[np.ndarray, "C"]
    cap: Float[np.ndarray, "C"]
    reference_joint: Int[np.ndarray, "C"]
    contact: Int[np.ndarray, "C"]

    @staticmethod
    def of(
        robot: RobotModel,
        contacts: Sequence[Contact],
        world_normals: Mapping[int, Float[np.ndarray, "3"] | Float[np.ndarray, "C 3"]] | None = None,
    ) -> ContactPoints:
        """Return the points of contacts in their order.

        Args:
            contacts: of the stance.
            world_normals: normal in the world (or one per point) by index of the contact, for contacts whose link may
                turn against the surface that it touches; the others' normals turn with their links.

        Raises:
            KeyError: the robot has no such link.
            ValueError: the robot has no mass, a normal in the world is zero, or a contact is not one of a robot's
                link with the world or with a mechanism's link.
        """
        weight = measure_weight(robot)
        fixed = {} if world_normals is None else world_normals
        links = [contact.link for contact in contacts for _ in contact.points]
        counts = np.array([len(contact.points) for contact in contacts], dtype=int)
        which = np.repeat(np.arange(len(contacts)), counts)
        local = np.concatenate([np.zeros((0, 3)), *(contact.points for contact in contacts)])
        normal, joint = np.zeros((len(which), 3)), np.zeros(len(which), dtype=int)
        reference = np.zeros(len(which), dtype=int)
        for k, contact in enumerate(contacts):
            rows = which == k
            _refuse_mechanism(robot, contact.link, f"contact of {contact.link}")
            if k in fixed:
                normal[rows] = fixed[k]
            else:
                joint[rows], pose = locate_frame(robot, contact.link)
                normal[rows] = np.asarray(contact.normals) @ pose[:3, :3].T
            if contact.reference is not None:
                reference[rows] = _find_reference(robot, contact.link, contact.reference)
        length = np.linalg.norm(normal, axis=1)
        if not (length > 0.0).all():
            k = int(which[int(np.argmin(length))])
            raise ValueError(f"world_normals[{k}] is zero; give the direction that pushes on {contacts[k].link}")
        friction = np.array([contact.friction for contact in contacts], dtype=float)[which]
        cap = np.array([contact.force_cap_n for contact in contacts], dtype=float)[which] / weight
        places = MovedPoints.on_links(robot, links, local)
        normal /= length[:, None]
        return ContactPoints(places, normal, _lean(normal, _UP), joint, friction, cap, reference, which)

    def lean_up(self, kinematics: Kinematics) -> ContactPoints:
        """Return the points with pyramids that lean up as far as friction allows at the first waypoint.

        On level ground they lean along the world's x axis.  Friction of a wall then carries its full share of weight.
        """
        rotation = kinematics.rotation[0, self.normal_joint]
        up = np.einsum("k,ckl->cl", _UP, rotation)
        ahead = np.einsum("k,ckl->cl", np.array([1.0, 0.0, 0.0]), rotation)
        is_level = np.abs(np.einsum("ck,ck->c", self.normal, up)) > 1.0 - 1e-6
        return replace(self, tangent=_lean(self.normal, np.where(is_level[:, None], ahead, up)))

    def __len__(self) -> int:
        return len(self.friction)

    def turn(
        self,
        kinematics: Kinematics,
        waypoints: Int[np.ndarray, "S"],
        point: Int[np.ndarray, "R"],
        directions: Float[np.ndarray, "R 3"],
    ) -> Float[np.ndarray, "S R 3"]:
        """Turn directions, given where the normals of ``point`` are given, to the world."""
        rotation = kinematics.rotation[waypoints][:, self.normal_joint[point]]
        return np.asarray(np.einsum("srkl,rl->srk", rotation, directions))


def _lean(normal: Float[np.ndarray, "C 3"], side: Float[np.ndarray, "#C 3"]) -> Float[np.ndarray, "C 3"]:
    """Return unit vectors across the normals, to a side where it is not along the normal."""
    tangent = np.stack([make_tangent_basis(n)[0] for n in normal]) if len(normal) else np.zeros((0, 3))
    across = side - np.einsum("ck,ck->c", normal, np.broadcast_to(side, normal.shape))[:, None] * normal
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.where(length > 1e-6, across / np.maximum(length, 1e-6), tangent)


def _find_reference(robot: RobotModel, link: str, reference: str) -> int:
    """Return the joint of a mechanism's link that a robot's link touches."""
    if reference not in robot.mechanism_links:
        known = ", ".join(sorted(robot.mechanism_links)) or "none"
        raise ValueError(
            f"contact of {link}: reference '{reference}' is no link of a mechanism; mechanism links: {known}"
        )
    return locate_frame(robot, reference)[0]


def _refuse_mechanism(robot: RobotModel, link: str, what: str) -> None:
    """Refuse a link of a mechanism where one of the robot is needed."""
    if link in robot.mechanism_links:
        raise ValueError(f"{what}: {link} belongs to a mechanism; name the robot's link")
