"""Forward kinematics and Jacobians of all waypoints at one iterate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float, Int

from costs.robot.model import RobotModel
from costs.rotation import cross, skew
from costs.work_space import borrow_work_space


@dataclass(frozen=True)
class Topology:
    """Parts of a robot's kinematics that do not depend on the configuration.

    A robot has ``m`` axes: one per coordinate, and one per joint that follows a coordinate (URDF's ``mimic``).

    Attributes:
        supports: (J, n) whether coordinate ``i`` moves joint ``j``.
        moves: (J, m) whether axis ``i`` moves joint ``j``; ``supports`` where no joint follows another.
        coordinate: (m,) the coordinate that each axis moves with.
        mass: (J,) mass carried by each joint [kg].
        lever: (J, 3) its centre in the joint's frame [m].
    """

    supports: Bool[np.ndarray, "J n"]
    moves: Bool[np.ndarray, "J m"]
    coordinate: Int[np.ndarray, "m"]
    mass: Float[np.ndarray, "J"]
    lever: Float[np.ndarray, "J 3"]

    @staticmethod
    def of(model: pin.Model) -> Topology:
        """Return the topology of a pinocchio model."""
        moves = np.zeros((model.njoints, model.nvExtended), dtype=bool)
        coordinate = np.zeros(model.nvExtended, dtype=int)
        for joint in range(1, model.njoints):
            made = model.joints[joint]
            own = np.arange(made.idx_vExtended, made.idx_vExtended + made.nvExtended)
            moves[joint] = moves[int(model.parents[joint])]
            moves[joint, own] = True
            coordinate[own] = made.idx_v + np.arange(made.nvExtended)
        supports = moves
        if model.nvExtended != model.nv:
            supports = np.zeros((model.njoints, model.nv), dtype=bool)
            for axis, column in enumerate(coordinate):
                supports[:, column] |= moves[:, axis]
        mass = np.array([inertia.mass for inertia in model.inertias])
        lever = np.array([inertia.lever for inertia in model.inertias])
        return Topology(supports, moves, coordinate, mass, lever)

    @cached_property
    def precedes(self) -> Bool[np.ndarray, "m m"]:
        """(m, m) whether axis ``i`` moves axis ``j``, or is the same."""
        m = self.moves.shape[1]
        own = self.moves.argmax(axis=0)  # joints are numbered from the root: an axis moves its own joint first
        return np.asarray(self.moves[own].T & (np.arange(m)[:, None] <= np.arange(m)))

    def add_followers(self, columns: Float[np.ndarray, "*S m"]) -> Float[np.ndarray, "*S n"]:
        """Return derivatives by the coordinates from derivatives by the axes: those of followers are added."""
        n = self.supports.shape[1]
        if columns.shape[-1] == n:
            return columns
        return np.asarray(columns @ (self.coordinate[:, None] == np.arange(n)).astype(float))


@dataclass(frozen=True)
class Kinematics:
    """Placements and Jacobians of all joints at all waypoints.

    Attributes:
        topology: of ``robot``.
        q: (T, n) the iterate.
        rotation: (T, J, 3, 3) world from joint.
        position: (T, J, 3) joint origins in the world [m].
        jacobian: (T, 6, m) spatial columns at the world's origin (linear, angular), one per axis; column ``i`` acts on
            the joints that axis ``i`` moves, and is the derivative by the axis's coordinate (``topology.coordinate``).
        engine: computed them.
    """

    robot: RobotModel
    topology: Topology
    q: Float[np.ndarray, "T n"]
    rotation: Float[np.ndarray, "T J 3 3"]
    position: Float[np.ndarray, "T J 3"]
    jacobian: Float[np.ndarray, "T 6 m"]
    engine: KinematicsEngine = field(repr=False)

    def at(self, q: Float[np.ndarray, "T n"]) -> Kinematics:
        """Return the robot's kinematics at other waypoints."""
        return self.engine(q)

    @property
    def n_waypoints(self) -> int:
        """T."""
        return len(self.q)

    def point_jacobian(
        self, waypoint: Int[np.ndarray, "m"], joint: Int[np.ndarray, "m"], point: Float[np.ndarray, "m 3"]
    ) -> Float[np.ndarray, "m 3 n"]:
        """Return d point / dq of world points that move with a joint, at one waypoint each."""
        return self.topology.add_followers(self.point_columns(waypoint, joint, point))

    def point_columns(
        self, waypoint: Int[np.ndarray, "k"], joint: Int[np.ndarray, "k"], point: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k 3 m"]:
        """Return the derivatives of world points by the axes, see ``point_jacobian``."""
        columns = self.jacobian[waypoint]
        linear = columns[:, :3] - skew(point) @ columns[:, 3:]
        return np.asarray(linear * self.topology.moves[joint][:, None, :])

    def directional_jacobian(
        self,
        waypoint: Int[np.ndarray, "m"],
        joint: Int[np.ndarray, "m"],
        point: Float[np.ndarray, "m 3"],
        direction: Float[np.ndarray, "m 3"],
    ) -> Float[np.ndarray, "m n"]:
        """Return ``direction . d point / dq``, one row per point; direction and point in the world."""
        wrench = np.concatenate([direction, cross(point, direction)], axis=1)
        rows = np.matmul(wrench[:, None, :], self.jacobian[waypoint])[:, 0]
        return self.topology.add_followers(np.asarray(rows * self.topology.moves[joint]))

    def angular_jacobian(self, joint: int) -> Float[np.ndarray, "T 3 n"]:
        """Return the world angular velocity of a joint's frame per dq, at every waypoint."""
        return self.topology.add_followers(np.asarray(self.jacobian[:, 3:] * self.topology.moves[joint]))

    @cached_property
    def com(self) -> Float[np.ndarray, "T 3"]:
        """Centre of mass in the world [m]."""
        mass = self.topology.mass
        return np.asarray(np.einsum("j,tjk->tk", mass, self._joint_centres) / mass.sum())

    @cached_property
    def com_jacobian(self) -> Float[np.ndarray, "T 3 n"]:
        """d com / dq: every coordinate moves the mass it supports about its axes."""
        return self.topology.add_followers(self.com_columns)

    @cached_property
    def com_columns(self) -> Float[np.ndarray, "T 3 m"]:
        """Derivative of the centre of mass by the axes."""
        mass = self.topology.mass
        supports = self.topology.moves.astype(float)
        moved_mass = supports.T @ mass
        moved_moment = np.einsum("ji,j,tjk->tki", supports, mass, self._joint_centres)
        linear, angular = self.jacobian[:, :3], self.jacobian[:, 3:]
        return np.asarray((linear * moved_mass + np.cross(angular, moved_moment, axis=1)) / mass.sum())

    @cached_property
    def _joint_centres(self) -> Float[np.ndarray, "T J 3"]:
        return np.asarray(np.einsum("tjkl,jl->tjk", self.rotation, self.topology.lever) + self.position)


class KinematicsEngine:
    """Computes ``Kinematics`` of one robot."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self.topology = Topology.of(robot.model)

    def __call__(self, q: Float[np.ndarray, "T n"]) -> Kinematics:
        """Compute the kinematics of all waypoints."""
        model = self.robot.model
        jacobian = np.empty((len(q), 6, model.nvExtended))

        def compute(data: pin.Data, t: int) -> None:
            # pinocchio hands out the Jacobian of a single coordinate as a vector
            jacobian[t] = pin.computeJointJacobians(model, data, q[t]).reshape(6, model.nvExtended)

        return self._collect(q, compute, jacobian)

    def place(self, q: Float[np.ndarray, "T n"]) -> Kinematics:
        """Compute placements alone: the Jacobian has no columns."""
        model = self.robot.model
        return self._collect(q, lambda data, t: pin.forwardKinematics(model, data, q[t]), np.empty((len(q), 6, 0)))

    def _collect(
        self,
        q: Float[np.ndarray, "T n"],
        compute: Callable[[pin.Data, int], None],
        jacobian: Float[np.ndarray, "T 6 n"],
    ) -> Kinematics:
        """Collect the placements that ``compute`` leaves in pinocchio's data, waypoint by waypoint."""
        space, n_joints = borrow_work_space(self.robot.model), self.robot.model.njoints
        block = np.empty((len(q), n_joints, 12))
        for t in range(len(q)):
            compute(space.data, t)
            block[t] = space.placements
        # Rotations are stored column by column.
        rotation = np.ascontiguousarray(np.swapaxes(block[..., :9].reshape(len(q), n_joints, 3, 3), -1, -2))
        position = np.ascontiguousarray(block[..., 9:])
        return Kinematics(self.robot, self.topology, np.array(q), rotation, position, jacobian, self)


def locate_frame(robot: RobotModel, name: str) -> tuple[int, Float[np.ndarray, "4 4"]]:
    """Find the joint that carries a frame (link) and ``pose_joint_frame``.

    Raises:
        KeyError: the robot has no frame of that name.
    """
    if not robot.model.existFrame(name):
        raise KeyError(f"unknown frame '{name}' of robot '{robot.name}'")
    frame = robot.model.frames[robot.model.getFrameId(name)]
    return int(frame.parentJoint), np.asarray(frame.placement.homogeneous)


def locate_links(
    engine: KinematicsEngine, q: Float[np.ndarray, "n"], links: Sequence[str]
) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Compute ``pose_world_link`` of the named links at one configuration."""
    kinematics = engine(q[None])
    poses = {}
    for link in links:
        joint, pose_joint_link = locate_frame(engine.robot, link)
        pose = np.eye(4)
        pose[:3, :3] = kinematics.rotation[0, joint]
        pose[:3, 3] = kinematics.position[0, joint]
        poses[link] = pose @ pose_joint_link
    return poses
