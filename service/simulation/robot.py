"""A robot in MuJoCo behind the interface of a robot's driver."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from service.demands.resistance import SPRING_TRAVEL
from service.execution.driver import JointCommand, RobotReading
from service.simulation.model import PhysicsModel, import_mujoco
from service.simulation.options import SimulationOptions
from service.simulation.spec import TIME_STEP_S

# Standard deviations of the sensors at noise 1.
POSITION_NOISE, SPEED_NOISE, TORQUE_NOISE = 1e-4, 1e-2, 0.01  # [rad], [rad/s], share of the effort
TILT_NOISE, GYRO_NOISE, ACCELERATION_NOISE = 1e-3, 2e-3, 0.05  # [rad], [rad/s], [m/s^2]
FORCE_NOISE, MOMENT_NOISE = 5.0, 0.5  # [N], [N m]
LATCH_SHUT = 2e-3  # of a latched joint around 0, where the latch catches again [rad, m]


@dataclass(frozen=True)
class ContactForce:
    """Force between two bodies at one point.

    Attributes:
        first, second: link or piece.
        shapes: names of the convex bodies of the two that touch.
        point: (3,) in the world [m].
        force: (3,) on ``second``, world axes [N].
        normal: (3,) of the contact, from ``first`` to ``second``, in world axes.
    """

    first: str
    second: str
    shapes: tuple[str, str]
    point: Float[np.ndarray, "3"]
    force: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]


class SimulatedRobot:
    """A robot in physics; implements ``service.execution.RobotDriver``.

    The servos' law is eq. 8 of Liu et al., Humanoids 2015, at the torque at which the valve rests:
    ``Kp (q_d - q) + Kd (qd_d - qd) + Kf tau_d``, within the efforts. They follow at most the joints' speed limits.
    """

    def __init__(
        self,
        model: PhysicsModel,
        start: Float[np.ndarray, "n"],
        options: SimulationOptions | None = None,
        steps: int = 1,
    ) -> None:
        """Put the robot and its mechanism at a configuration of the plan, at rest.

        Args:
            model: from ``build_physics``.
            start: (n,) configuration of the plan's model: base, joints, mechanism.
            options: noise, delay, feed-forward.
            steps: of the physics, 1 ms each, per command.
        """
        self._steps = steps
        self.mujoco = import_mujoco()
        self.model, self.options = model, options or SimulationOptions()
        self.data: Any = self.mujoco.MjData(model.mj)
        self._random = np.random.default_rng(self.options.seed)
        self._columns = [model.motion.robot.joint_names.index(name) for name in model.joint_names]
        self._rest = np.zeros(len(model.moved_qpos))
        self._springs = self._list_springs()
        self._delayed: deque[JointCommand] = deque()
        self._planted = tuple(dict.fromkeys(c.link for phase in model.motion.phases for c in phase.contacts))
        frames = model.motion.robot.model
        self._planted_bodies = [int(model.mj.body(f"link:{link}").id) for link in self._planted]
        self._planted_offsets = np.array(
            [frames.frames[frames.getFrameId(link)].placement.translation for link in self._planted]
        ).reshape(-1, 3)
        places = {link: k for k, link in enumerate(self._planted)}
        self._foot_of_geom = np.array(
            [places.get(link, -1) if own else -1 for link, own in zip(model.link_of_geom, model.is_robot, strict=True)],
            dtype=int,
        )
        self._gyro, self._accelerometer = (int(model.mj.sensor(name).adr[0]) for name in ("gyro", "accelerometer"))
        self._delay_steps = round(self.options.delay_ms * 1e-3 / self.period_s)
        self._is_latched = [True] * len(model.latches)
        self.place(start)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Actuated joints, in the order of every array."""
        return self.model.joint_names

    @property
    def period_s(self) -> float:
        """Seconds between two commands."""
        return self._steps * TIME_STEP_S

    @property
    def time_s(self) -> float:
        """Seconds since the robot was placed."""
        return float(self.data.time)

    def place(self, configuration: Float[np.ndarray, "n"]) -> None:
        """Put robot and mechanism at rest at a configuration of the plan's model, at time 0."""
        model, data = self.model, self.data
        self.mujoco.mj_resetData(model.mj, data)
        n_moved = len(model.moved_qpos)
        n = len(configuration)
        if model.base_qpos >= 0:
            place = pin.Data(model.motion.robot.model)
            pin.forwardKinematics(model.motion.robot.model, place, np.asarray(configuration, dtype=float))
            base = place.oMi[1]
            xyzw = pin.Quaternion(base.rotation).coeffs()
            at = model.base_qpos
            data.qpos[at : at + 3] = base.translation
            data.qpos[at + 3 : at + 7] = [xyzw[3], *xyzw[:3]]
        data.qpos[model.qpos] = configuration[self._columns]
        data.qpos[model.moved_qpos] = configuration[n - n_moved :]
        for address, follower in model.followers:
            data.qpos[address] = follower.offset + follower.ratio * configuration[follower.column]
        self._rest = np.array(configuration[n - n_moved :], dtype=float)
        for k, name in enumerate(model.moved_names):  # the rest of a task may begin with a spring under tension
            stated = model.physics.joints.get(name)
            if stated is not None and stated.rest is not None:
                self._rest[k] = stated.rest
        self._desired = data.qpos[model.qpos].copy()
        data.ctrl[model.actuator] = model.stiffness * self._desired
        data.qpos[model.qpos] += model.perturbation.start
        self._is_latched = [True] * len(model.latches)
        self._update_latches()
        self._delayed.clear()
        self.mujoco.mj_forward(model.mj, data)
        self._acceleration = self._measure_acceleration()

    def read(self) -> RobotReading:
        """Return what the sensors say now."""
        model, data = self.model, self.data
        noise = self.options.noise
        q, qd = data.qpos[model.qpos].copy(), data.qvel[model.dof].copy()
        torque = data.actuator_force[model.actuator].copy()
        rotation = self.pose_world_base[:3, :3]
        gyro = np.array(data.sensordata[self._gyro : self._gyro + 3])
        acceleration = self._acceleration.copy()
        wrenches = self.measure_contact_wrenches()
        if noise > 0.0:
            draw = self._random.standard_normal
            q += noise * POSITION_NOISE * draw(len(q))
            qd += noise * SPEED_NOISE * draw(len(qd))
            torque += noise * TORQUE_NOISE * model.effort * draw(len(torque))
            rotation = pin.exp3(noise * TILT_NOISE * draw(3)) @ rotation
            gyro += noise * GYRO_NOISE * draw(3)
            acceleration += noise * ACCELERATION_NOISE * draw(3)
            sizes = np.array([FORCE_NOISE] * 3 + [MOMENT_NOISE] * 3)
            wrenches = {link: wrench + noise * sizes * draw(6) for link, wrench in wrenches.items()}
        base = self.pose_world_base if model.motion.sway else None
        return RobotReading(self.time_s, q, qd, rotation, gyro, acceleration, wrenches, torque, base)

    def command(self, command: JointCommand) -> None:
        """Hand a command to the servos; returns when the next one is due."""
        self._delayed.append(command)
        if len(self._delayed) > self._delay_steps:
            self._apply(self._delayed.popleft())
        self._acceleration[:] = 0.0
        for _ in range(self._steps):
            self._oppose()
            self.mujoco.mj_step(self.model.mj, self.data)
            self._acceleration += self._measure_acceleration() / self._steps  # inertial units integrate

    def sway(self, pose: Float[np.ndarray, "4 4"]) -> None:
        """Move the base of a robot that something else balances to a pose against that of the plan."""
        x, y, z, w = pin.Quaternion(np.asarray(pose[:3, :3])).coeffs()
        self.data.mocap_pos[0], self.data.mocap_quat[0] = pose[:3, 3], (w, x, y, z)

    def hold_grips(self, phase: int | None) -> None:
        """Close the grippers of a phase of the plan, by its number, and open all others; None opens all."""
        for k, grips in enumerate(self.model.grips):
            for index in grips:
                self.data.eq_active[index] = k == phase

    def _measure_acceleration(self) -> Float[np.ndarray, "3"]:
        """Return the acceleration at the inertial unit in the last step, gravity included [m/s^2]."""
        return np.array(self.data.sensordata[self._accelerometer : self._accelerometer + 3])

    def _apply(self, command: JointCommand) -> None:
        """Set the servos to follow a command, at most as fast as the joints may move."""
        model = self.model
        reach = model.velocity * self.period_s
        self._desired = np.minimum(np.maximum(command.q, self._desired - reach), self._desired + reach)
        speed = np.minimum(np.maximum(command.qd, -model.velocity), model.velocity)
        control = model.stiffness * self._desired + model.damping * speed + self.options.feed_forward * command.tau
        if self.options.noise > 0.0:  # the servos measure with the same sensors
            draw = self._random.standard_normal
            control -= self.options.noise * POSITION_NOISE * model.stiffness * draw(len(control))
        self.data.ctrl[model.actuator] = control

    def _list_springs(self) -> list[tuple[int, float, float]]:
        springs = []
        for k, name in enumerate(self.model.moved_names):
            resistance = self.model.physics.joints.get(name)
            if resistance is not None and (resistance.preload or resistance.stiffness):
                springs.append((k, resistance.preload, resistance.stiffness))
        return springs

    def _oppose(self) -> None:
        """Apply the springs of the mechanism, and its latches."""
        model, data = self.model, self.data
        for k, preload, stiffness in self._springs:
            travel = float(data.qpos[model.moved_qpos[k]] - self._rest[k])
            force = preload * float(np.clip(travel / SPRING_TRAVEL, -1.0, 1.0)) + stiffness * travel
            data.qfrc_applied[model.moved_dof[k]] = -force
        if model.latches:
            self._update_latches()

    def _update_latches(self) -> None:
        """Lock a latched joint at 0 until its latch releases it, and again when it is back."""
        model, values = self.model, self.mechanism
        for k, (release, equality) in enumerate(zip(model.motion.releases, model.latches, strict=True)):
            at = values[release.joint]
            latch = values[release.latch]
            is_released = latch * np.sign(release.latch_at) >= abs(release.latch_at)
            if self._is_latched[k]:
                self._is_latched[k] = not (is_released or abs(at) > release.free_beyond)
            elif not is_released and abs(at) < LATCH_SHUT:
                self._is_latched[k] = True
            self.data.eq_active[equality] = self._is_latched[k]

    @property
    def pose_world_base(self) -> Float[np.ndarray, "4 4"]:
        """(4, 4) true pose of the base link."""
        pose = np.eye(4)
        at = self.model.base_qpos
        if self.model.motion.sway:
            w, x, y, z = self.data.mocap_quat[0]
            pose[:3, :3], pose[:3, 3] = pin.Quaternion(w, x, y, z).matrix(), self.data.mocap_pos[0]
        if at >= 0:
            w, x, y, z = self.data.qpos[at + 3 : at + 7]
            pose[:3, :3] = pin.Quaternion(w, x, y, z).normalized().matrix()
            pose[:3, 3] = self.data.qpos[at : at + 3]
        return pose

    @property
    def mechanism(self) -> dict[str, float]:
        """True values of the mechanism's joints [rad, m]."""
        values = self.data.qpos[self.model.moved_qpos]
        return {name: float(value) for name, value in zip(self.model.moved_names, values, strict=True)}

    @property
    def is_latched(self) -> tuple[bool, ...]:
        """Whether each release of the motion still holds its joint."""
        return tuple(self._is_latched)

    @property
    def torque(self) -> Float[np.ndarray, "k"]:
        """(k,) true torques of the servos [N m, N]."""
        return np.array(self.data.actuator_force[self.model.actuator])

    def configuration(self) -> Float[np.ndarray, "n"]:
        """Return the true configuration in the coordinates of the plan's model (n,)."""
        robot = self.model.motion.robot
        q = np.zeros(robot.n)
        if self.model.base_qpos >= 0:
            pose = self.pose_world_base
            R = pose[:3, :3]
            q[:3] = pose[:3, 3]
            q[3] = np.arctan2(R[1, 0], R[0, 0])
            q[4] = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
            q[5] = np.arctan2(R[2, 1], R[2, 2])
        q[self._columns] = self.data.qpos[self.model.qpos]
        n_moved = len(self.model.moved_qpos)
        q[robot.n - n_moved :] = self.data.qpos[self.model.moved_qpos]
        return q

    def list_contact_forces(self) -> list[ContactForce]:
        """Return all contact forces of the last step; none between parts of the same link."""
        pairs, points, forces, normals = self._collect_contacts()
        names, shapes = self.model.link_of_geom, self.model.shape_of_geom
        return [
            ContactForce(names[first], names[second], (shapes[first], shapes[second]), point, force, normal)
            for (first, second), point, force, normal in zip(pairs.tolist(), points, forces, normals, strict=True)
        ]

    def list_pair_forces(self) -> list[tuple[str, str, Float[np.ndarray, "3"]]]:
        """Return per contact point a robot's link, what it touches, and the force on the link in world axes [N]."""
        pairs, _, forces, _ = self._collect_contacts()
        names, is_robot = self.model.link_of_geom, self.model.is_robot
        return [
            (names[second], names[first], force) if is_robot[second] else (names[first], names[second], -force)
            for (first, second), force in zip(pairs.tolist(), forces, strict=True)
            if is_robot[first] or is_robot[second]  # not of what an object rests on
        ]

    def locate_objects(self) -> dict[str, Float[np.ndarray, "7"]]:
        """Return the true poses of the movable objects: position, and quaternion w x y z."""
        return {name: np.array(self.data.qpos[at : at + 7]) for name, at in self.model.objects.items()}

    def list_grip_forces(self) -> list[tuple[str, str, Float[np.ndarray, "3"]]]:
        """Return per closed gripper its tool, the link that it holds, and the force on the tool in world axes [N]."""
        data, forces = self.data, []
        rows = np.asarray(data.efc_id)[: data.nefc]
        is_equality = np.asarray(data.efc_type)[: data.nefc] == int(self.mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        for phase, grips in zip(self.model.motion.phases, self.model.grips, strict=True):
            for index, load in zip(grips, phase.loads if grips else (), strict=True):
                held = np.flatnonzero(is_equality & (rows == index))
                if len(held):
                    forces.append((load.tool, load.link, np.array(data.efc_force[held])))
        return forces

    def measure_contact_wrenches(self) -> dict[str, Float[np.ndarray, "6"]]:
        """Return the true wrench of the world on every planted link at its origin, world axes [N, N m].

        Planted links are those that the plan plants in any phase.
        """
        pairs, points, forces, _ = self._collect_contacts()
        total = np.zeros((len(self._planted), 6))
        if len(pairs):
            turned = self.data.xmat[self._planted_bodies].reshape(-1, 3, 3)
            origins = self.data.xpos[self._planted_bodies] + (turned @ self._planted_offsets[:, :, None])[:, :, 0]
            about_origin = np.concatenate([forces, _cross(points, forces)], axis=1)
            is_robot = self.model.is_robot[pairs]
            foot = self._foot_of_geom[pairs]
            for k in range(len(total)):
                on_second = (foot[:, 1] == k) & ~is_robot[:, 0]
                on_first = (foot[:, 0] == k) & ~is_robot[:, 1]
                total[k] = (on_second * 1.0 - on_first * 1.0) @ about_origin
            total[:, 3:] -= _cross(origins, total[:, :3])
        return dict(zip(self._planted, total, strict=True))

    def _collect_contacts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return geoms (K, 2), points, forces on the second geom and normals towards it (K, 3) in world axes."""
        contact = self.data.contact
        active = np.flatnonzero(np.asarray(contact.efc_address) >= 0)
        if not len(active):
            return np.zeros((0, 2), dtype=int), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))
        rows = np.asarray(contact.efc_address)[active][:, None] + np.arange(3)
        local = np.asarray(self.data.efc_force)[rows]  # elliptic cones: normal and two tangents
        frames = np.asarray(contact.frame)[active].reshape(-1, 3, 3)
        forces = (local[:, None, :] @ frames)[:, 0]
        return np.asarray(contact.geom)[active], np.asarray(contact.pos)[active], forces, frames[:, 0]


def _cross(a: Float[np.ndarray, "K 3"], b: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
    """Return cross products by row; ``np.cross`` takes ten times as long on few rows."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def hold_still(robot: SimulatedRobot, command: JointCommand, seconds: float) -> Mapping[str, float]:
    """Let the robot follow one command for some time; return the mechanism's values after it."""
    for _ in range(round(seconds / robot.period_s)):
        robot.command(command)
    return robot.mechanism
