"""The physics model of a robot, its scene and its mechanism, built for MuJoCo from the recorded motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from costs.robot import read_joint_axis
from costs.robot.servo import DAMPING_S, default_stiffness, list_servo_joints
from service.demands.resistance import MechanismPhysics, Resistance
from service.errors import ResultError
from service.simulation.options import SimulationOptions
from service.simulation.perturb import Perturbation, draw_perturbation
from service.simulation.spec import BASE, Follower, SpecBuilder
from service.verify import Motion

MECHANISM_DAMPING = 0.2  # [N m s/rad, N s/m]
HELD_BY_FRICTION = 0.9999  # impedance of dry friction in joints: what it holds does not creep


@dataclass(frozen=True)
class PhysicsModel:
    """A compiled MuJoCo model and where the quantities of a plan are in it.

    Attributes:
        mj: the ``mujoco.MjModel``.
        motion: the motion whose robot, scene and mechanism it holds.
        joint_names: actuated joints in the order of the servos.
        qpos, dof, actuator: (k,) addresses of the actuated joints.
        base_qpos, base_dof: addresses of the floating base, or -1.
        moved_qpos, moved_dof: (m,) addresses of the mechanism's joints, in the order of the plan's last columns.
        link_of_geom: per geom the robot's or mechanism's link, or the piece that it belongs to.
        shape_of_geom: per geom the name of its convex body or piece.
        is_robot: (G,) whether a geom belongs to the robot.
        is_mechanism: (G,) whether it belongs to the mechanism.
        stiffness, damping, effort, velocity: (k,) of the servos.
        latches: per release of the motion the index of the equality that locks its joint.
        grips: per phase of the motion the indices of the equalities that hold a gripper at the mechanism.
        physics: what the mechanism opposes.
        base_link: the link that carries the inertial unit.
        perturbation: errors of the physics against the plan.
        followers: per joint that follows another one: address of its position, and the follower.
        objects: address of the pose of each movable object, by name.
    """

    mj: Any
    motion: Motion
    joint_names: tuple[str, ...]
    qpos: Int[np.ndarray, "k"]
    dof: Int[np.ndarray, "k"]
    actuator: Int[np.ndarray, "k"]
    base_qpos: int
    base_dof: int
    moved_qpos: Int[np.ndarray, "m"]
    moved_dof: Int[np.ndarray, "m"]
    link_of_geom: tuple[str, ...]
    shape_of_geom: tuple[str, ...]
    is_robot: np.ndarray
    is_mechanism: np.ndarray
    stiffness: Float[np.ndarray, "k"]
    damping: Float[np.ndarray, "k"]
    effort: Float[np.ndarray, "k"]
    velocity: Float[np.ndarray, "k"]
    latches: tuple[int, ...]
    grips: tuple[tuple[int, ...], ...]
    physics: MechanismPhysics
    base_link: str
    perturbation: Perturbation
    followers: tuple[tuple[int, Follower], ...]
    objects: Mapping[str, int] = field(default_factory=dict)

    @property
    def moved_names(self) -> tuple[str, ...]:
        """The mechanism's joints."""
        return self.motion.robot.joint_names[self.motion.robot.n - len(self.moved_qpos) :]


def import_mujoco() -> Any:
    """Return the module ``mujoco`` (ResultError, one line, where it is not installed)."""
    try:
        import mujoco
    except ImportError:
        raise ResultError("a simulation needs MuJoCo, which is not installed; pip install 'scopt[sim]'") from None
    return mujoco


def build_physics(
    motion: Motion,
    physics: MechanismPhysics,
    options: SimulationOptions,
    stiffness: Mapping[str, float] | None = None,
) -> PhysicsModel:
    """Build the physics model of a motion's robot, scene and mechanism.

    Joints carry their links as convex hulls. Robot and world touch, robot and mechanism touch, links of the robot touch
    unless the robot's description excludes the pair; the mechanism passes through the world, as its certificate covers
    what it meets. The floor is a plane.

    Args:
        motion: as recorded.
        physics: what the mechanism opposes.
        options: friction and factors of the servos.
        stiffness: per servo joint [N m/rad, N/m]; that of ``costs.robot.servo.default_stiffness`` by default.

    Raises:
        ResultError: MuJoCo is not installed, or cannot use the robot.
    """
    mujoco = import_mujoco()
    model = motion.robot.model
    names = list_servo_joints(motion.robot)
    is_turning = np.array([bool(np.any(read_joint_axis(motion.robot, model.getJointId(name))[3:])) for name in names])
    perturbation = draw_perturbation(motion, is_turning, options)
    builder = SpecBuilder(mujoco, motion, physics, options, perturbation)
    builder.add_world()
    builder.add_joints()
    builder.add_objects()
    builder.exclude_pairs()
    table = {**default_stiffness(motion.robot), **(stiffness or {})}
    kp = np.array([table[name] for name in names]) * options.stiffness_scale
    kd = DAMPING_S * kp
    columns = [motion.robot.joint_names.index(name) for name in names]
    effort = motion.robot.effort[columns]
    builder.add_servos(names, kp, kd, effort)
    latches = builder.add_latches()
    grips = builder.add_grips()
    followers = builder.add_followers()
    try:
        mj = builder.spec.compile()
    except ValueError as error:
        line = " ".join(str(error).split())
        raise ResultError(f"robot '{motion.robot.name}' cannot be simulated: {line}") from None

    def address(name: str) -> tuple[int, int]:
        joint = mj.joint(name)
        return int(joint.qposadr[0]), int(joint.dofadr[0])

    places = [address(name) for name in names]
    moved = [address(motion.robot.joint_names[column]) for column in builder.moved_columns]
    for index, anchors in (part for parts in grips for part in parts):
        mj.eq_data[index, :6] = anchors  # the compiler takes the second one from the pose at 0
    mj.dof_solimp[:, :2] = HELD_BY_FRICTION
    damped = [physics.joints.get(motion.robot.joint_names[column], Resistance()) for column in builder.moved_columns]
    # Versions differ in the field of a spec.
    mj.dof_damping[[place[1] for place in moved]] = [max(joint.damping, MECHANISM_DAMPING) for joint in damped]
    base = address(BASE) if motion.robot.is_floating else (-1, -1)
    owners = [builder.owner_of_geom[mj.geom(k).name] for k in range(mj.ngeom)]
    robot_geoms = np.array([owner[0] == "robot" for owner in owners], dtype=bool)
    mechanism_geoms = np.array([owner[0] == "mechanism" for owner in owners], dtype=bool)
    return PhysicsModel(
        mj=mj,
        motion=motion,
        joint_names=names,
        qpos=np.array([place[0] for place in places], dtype=int),
        dof=np.array([place[1] for place in places], dtype=int),
        actuator=np.array([mj.actuator(name).id for name in names], dtype=int),
        base_qpos=base[0],
        base_dof=base[1],
        moved_qpos=np.array([place[0] for place in moved], dtype=int),
        moved_dof=np.array([place[1] for place in moved], dtype=int),
        link_of_geom=tuple(owner[1] for owner in owners),
        shape_of_geom=tuple(mj.geom(k).name.split(":", 1)[1] for k in range(mj.ngeom)),
        is_robot=robot_geoms,
        is_mechanism=mechanism_geoms,
        stiffness=kp,
        damping=kd,
        effort=effort,
        velocity=motion.robot.velocity[columns],
        latches=latches,
        grips=tuple(tuple(index for index, _ in parts) for parts in grips),
        physics=physics,
        base_link=builder.base_link,
        perturbation=perturbation,
        followers=tuple((address(follower.joint)[0], follower) for follower in followers),
        objects={item.name: address(f"object:{item.name}")[0] for item in motion.objects},
    )
