"""Estimate of the pelvis: position and speed from a point that is at rest, orientation from the IMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.errors import ExecutionError
from service.execution.driver import RobotReading
from service.execution.sensing.filters import find_share, low_pass
from service.execution.sensing.kalman import SteadyKalmanFilter, make_steady_filter

GRAVITY = np.array([0.0, 0.0, -9.81])
PELVIS = "pelvis"  # name of the reference point on the floating base itself
LOADED_SHARE = 0.05  # of the robot's weight, below which a foot counts as lifted
REST_S = 0.5  # in which a foot that was put down comes to rest [s]


@dataclass(frozen=True)
class ReferencePoint:
    """Point of the robot that may be at rest in the world.

    Attributes:
        link: frame that it belongs to.
        place: (3,) in that frame [m].
    """

    link: str
    place: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations that the filters' gains are computed from.

    Attributes:
        acceleration: of the IMU, and of the pelvis between two samples [m/s^2].
        position: of the pelvis from the joints and a point at rest [m].
        speed: of the same from the joints' speeds [m/s].
        pelvis_speed: of the pelvis while the pelvis counts as the point at rest [m/s].
    """

    acceleration: float = 0.5
    position: float = 0.001
    speed: float = 0.02
    pelvis_speed: float = 0.005


@dataclass(frozen=True)
class PelvisEstimate:
    """Pelvis in the world.

    Attributes:
        position: (3,) [m].
        speed: (3,) [m/s].
        rotation: (3, 3) pelvis to world, as the IMU gives it.
        reference: name of the point that counts as at rest.
        anchors: (3,) place in the world per point that may be at rest [m].
        loaded_s: time for which each of these points has carried force [s].
        joint_speeds: (n,) filtered.
    """

    position: Float[np.ndarray, "3"]
    speed: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    reference: str
    anchors: Mapping[str, np.ndarray]
    loaded_s: Mapping[str, float]
    joint_speeds: Float[np.ndarray, "n"]


@dataclass(frozen=True)
class _PointMotion:
    """A reference point relative to the pelvis, in world axes: offset [m] and speed [m/s]."""

    offset: Float[np.ndarray, "3"]
    speed: Float[np.ndarray, "3"]


class PelvisEstimator:
    """Multiple-model Kalman filter on points at rest (Liu et al., Humanoids 2015, II.B).

    One steady-state filter per point: left toe, right toe, pelvis.  The state of each axis is position and speed of the
    pelvis, the input its acceleration from the IMU, the measurement the pelvis as the joints give it from the point
    that is at rest.  The pelvis itself is that point while both feet carry less than half of the weight, else the toe
    with the larger upright force.  A foot has half a second to come to rest after it was put down; from then on its
    toe keeps its place in the world until the foot is lifted, so that changing between two loaded feet does not drift.
    """

    def __init__(
        self,
        robot: RobotModel,
        joint_names: Sequence[str],
        period_s: float,
        noise: SensorNoise | None = None,
        speed_cutoff_hz: float = 50.0,
    ) -> None:
        """Prepare the filters.

        Args:
            robot: with a floating base and two feet.
            joint_names: order of the readings' joints.
            period_s: between two readings [s].
            noise: of the sensors.
            speed_cutoff_hz: of the low-pass filter of the joints' speeds.

        Raises:
            ExecutionError: the robot has no floating base or not two feet, or a joint is unknown.
        """
        feet = robot.link_groups.get("feet", ())
        if not robot.is_floating or len(feet) != 2:
            raise ExecutionError(f"{robot.name}: the pelvis estimator needs a floating base and two feet")
        unknown = sorted(set(joint_names) - set(robot.joint_names))
        if unknown:
            raise ExecutionError(f"joint_names: {robot.name} has no joint {unknown[0]!r}")
        noise = noise or SensorNoise()
        self.robot = robot
        self.period_s = period_s
        self.points = {foot: find_toe(robot, foot) for foot in feet}
        self.weight_n = pin.computeTotalMass(robot.model) * float(-GRAVITY[2])
        self._columns = np.array([robot.joint_names.index(name) for name in joint_names])
        self._data = robot.model.createData()
        self._share = find_share(speed_cutoff_hz, period_s)
        toe = make_pelvis_filter(period_s, noise.acceleration, noise.position, noise.speed)
        rest = make_pelvis_filter(period_s, noise.acceleration, noise.position, noise.pelvis_speed)
        self.filters = {**dict.fromkeys(feet, toe), PELVIS: rest}

    def start(self, reading: RobotReading, position: Float[np.ndarray, "3"]) -> PelvisEstimate:
        """Return the estimate of a robot at rest with its pelvis at a known position [m]."""
        motions = self._measure(reading, reading.qd)
        reference = self.choose_reference(reading)
        places = {name: np.asarray(position + motions[name].offset) for name in self._list_loaded(reading)}
        return PelvisEstimate(
            position=np.asarray(position, dtype=float),
            speed=np.zeros(3),
            rotation=reading.imu_rotation,
            reference=reference,
            anchors=places,
            loaded_s=dict.fromkeys(places, REST_S),
            joint_speeds=reading.qd,
        )

    def step(self, estimate: PelvisEstimate, reading: RobotReading) -> PelvisEstimate:
        """Return the estimate after one more reading."""
        speeds = low_pass(estimate.joint_speeds, reading.qd, self._share)
        motions = self._measure(reading, speeds)
        reference = self.choose_reference(reading)
        predicted = estimate.position + self.period_s * estimate.speed
        loaded = {name: estimate.loaded_s.get(name, 0.0) + self.period_s for name in self._list_loaded(reading)}
        anchors = {
            name: estimate.anchors[name]
            if name in estimate.anchors and (time > REST_S or name == estimate.reference)
            else np.asarray(predicted + motions[name].offset)
            for name, time in loaded.items()
        }
        point = motions[reference]
        measured = np.stack([anchors[reference] - point.offset, -point.speed])
        acceleration = reading.imu_rotation @ reading.imu_acceleration + GRAVITY
        state = np.stack([estimate.position, estimate.speed])
        position, speed = self.filters[reference].step(state, acceleration[None], measured)
        return PelvisEstimate(position, speed, reading.imu_rotation, reference, anchors, loaded, speeds)

    def choose_reference(self, reading: RobotReading) -> str:
        """Return the name of the point that counts as at rest: a foot's link, or ``pelvis``."""
        upright = {foot: measure_upright(reading, foot) for foot in self.points}
        if sum(upright.values()) < 0.5 * self.weight_n:
            return PELVIS
        return max(upright, key=lambda foot: upright[foot])

    def _list_loaded(self, reading: RobotReading) -> tuple[str, ...]:
        """Return the names of all points that may be at rest."""
        least = LOADED_SHARE * self.weight_n
        loaded = tuple(foot for foot in self.points if measure_upright(reading, foot) >= least)
        return (*loaded, PELVIS) if self.choose_reference(reading) == PELVIS else loaded

    def _measure(self, reading: RobotReading, speeds: Float[np.ndarray, "n"]) -> dict[str, _PointMotion]:
        """Return offset and speed of each point relative to the pelvis, in world axes."""
        model, rotation = self.robot.model, reading.imu_rotation
        q = np.zeros(model.nq)
        q[self._columns] = reading.q
        pin.computeJointJacobians(model, self._data, q)
        pin.updateFramePlacements(model, self._data)
        motions = {PELVIS: _PointMotion(np.zeros(3), np.zeros(3))}
        for foot, point in self.points.items():
            frame = model.getFrameId(point.link)
            place = self._data.oMf[frame]
            offset = place.act(point.place)
            jacobian = pin.getFrameJacobian(model, self._data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            twist = jacobian[:, self._columns] @ speeds
            own = twist[:3] + pin.skew(twist[3:]) @ (offset - place.translation)
            turned = pin.skew(reading.imu_angular_velocity) @ offset
            motions[foot] = _PointMotion(rotation @ offset, rotation @ (own + turned))
        return motions


def make_pelvis_filter(period_s: float, acceleration: float, position: float, speed: float) -> SteadyKalmanFilter:
    """Return the filter of one axis: position and speed, driven by an acceleration, both measured.

    Args:
        period_s: [s].
        acceleration, position, speed: standard deviations [m/s^2, m, m/s].
    """
    A = np.array([[1.0, period_s], [0.0, 1.0]])
    B = np.array([[0.5 * period_s**2], [period_s]])
    return make_steady_filter(A, B, np.eye(2), acceleration**2 * B @ B.T, np.diag([position**2, speed**2]))


def find_toe(robot: RobotModel, foot: str) -> ReferencePoint:
    """Return the point of a foot that counts as at rest: the middle of its toe patch, else of its sole's front edge.

    Raises:
        ExecutionError: the foot has no shape.
    """
    frame = robot.model.frames[robot.model.getFrameId(foot)]
    for name, contact in robot.contacts.items():
        if contact.link == foot and "toe" in name:
            return ReferencePoint(foot, np.asarray(contact.points).mean(axis=0))
    bodies = [body.vertices for body in robot.bodies if body.link == foot]
    if not bodies:
        raise ExecutionError(f"{robot.name}: {foot} has neither a toe patch nor a shape")
    points = np.vstack(bodies)
    points = (points - frame.placement.translation) @ frame.placement.rotation
    sole = points[points[:, 2] <= points[:, 2].min() + 5e-3]
    return ReferencePoint(foot, np.array([sole[:, 0].max(), sole[:, 1].mean(), sole[:, 2].min()]))


def measure_upright(reading: RobotReading, foot: str) -> float:
    """Return the upright force on a foot [N]; 0 for one that no sensor measures."""
    wrench = reading.foot_wrenches.get(foot)
    return 0.0 if wrench is None else float(wrench[2])
