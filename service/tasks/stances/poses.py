"""Single poses of a stance: how far a hand moves a mechanism, and with which reserves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from costs.allowance import BodyRef
from costs.kinematics import locate_frame, locate_links
from costs.robot import Mechanism, RobotModel
from costs.static_region import StaticRegionError
from service.body.forces.loaded_regions import plan_regions
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.demands.hands import Hand, list_robot_hands
from service.demands.phase import TaskPhase
from service.tasks.handling import list_arm_joints
from service.tasks.hints import Hints, give_no_hints
from service.tasks.sequence import PhaseSequence

N_RANDOM = 4  # random configurations from which a first pose is searched
MOST_TORQUE = 0.95  # share of a joint's torque at rest


@dataclass(frozen=True)
class StancePose:
    """A pose that exists from a stance.

    Attributes:
        name: of its phase.
        q: (n,) configuration.
        balance_m: how far the centre of mass is inside the region where the feet hold the hand's load.
        reach_m: by how much the arm could be longer stretched.
        torque_share: largest share of a joint's torque above the legs, at rest with the load or without it.
    """

    name: str
    q: Float[np.ndarray, "n"]
    balance_m: float
    reach_m: float
    torque_share: float


@dataclass(frozen=True)
class Outcome:
    """How far a task gets from a stance, as far as single poses show.

    Attributes:
        reached: of the mechanism's first joint, from its start [rad]; for a given mechanism, share of the way that
            its handle goes.
        poses: that exist, in the order of the motion.
        hold: hand and hold, in words.
        missing: the first pose that was not found, in words; empty where the task is done.
    """

    reached: float
    poses: tuple[StancePose, ...]
    hold: str
    missing: str

    @property
    def balance_m(self) -> float:
        """Least reserve of balance [m]."""
        return min((pose.balance_m for pose in self.poses), default=0.0)

    @property
    def reach_m(self) -> float:
        """Least reserve of reach [m]."""
        return min((pose.reach_m for pose in self.poses), default=0.0)

    @property
    def torque_share(self) -> float:
        """Largest share of a joint's torque."""
        return max((pose.torque_share for pose in self.poses), default=0.0)


class StanceTask(Protocol):
    """A task with a mechanism, as the search for a stance sees it."""

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism."""

    @property
    def hands(self) -> tuple[Hand, ...]:
        """Hands that may be used."""

    @property
    def whole(self) -> float:
        """``Outcome.reached`` of the whole task."""

    @property
    def is_angle(self) -> bool:
        """Whether that is an angle [rad]; else a share."""

    @property
    def near(self) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
        """Required clearances of pairs that come near each other [m]."""

    def list_ways(self) -> tuple[tuple[tuple[Hand, Float[np.ndarray, "P 3"]], ...], ...]:
        """Return the ways to do the task: for each the hands, and the places in the world that each holds [m]."""

    def rate_places(self, poses: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N"]:
        """Return the cost of places to stand (x, y, yaw), besides that of the hands' reach."""

    def is_in_the_way(
        self, poses: Float[np.ndarray, "N 3"], soles: Float[np.ndarray, "N C 2"], body_m: float
    ) -> Bool[np.ndarray, "N"]:
        """Return whether the robot would stand where the mechanism moves.

        Args:
            poses: (x, y, yaw) of the base.
            soles: corners of the soles, seen from above [m].
            body_m: radius of the robot about its base [m].
        """

    def place_parts(self, *, is_end: bool) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of the mechanism's bodies in the world, at the start or at the end [m]."""

    def find_in_the_way(self, body: WholeBody) -> Iterator[str]:
        """Yield a sentence for each link that the mechanism would meet as the robot stands."""

    def try_stance(self, solver: PhaseSolver) -> Outcome:
        """Return how far the task gets from the stance of the solver's body."""


@dataclass(frozen=True)
class StancePoseFinder:
    """Finds single poses of a body, with little effort."""

    solver: PhaseSolver
    mechanism: Mechanism
    hints: Hints = give_no_hints

    def find(self, spec: TaskPhase, before: Sequence[StancePose], n_random: int = 0) -> StancePose | None:
        """Return the first pose of a phase, guessed from those before; None if none that is strong enough was found.

        Random configurations are guessed where that and the robot's postures lead to none.
        """
        sequence = PhaseSequence.of(self.solver, self.mechanism, (spec,), hints=self.hints)
        guesses = [(pose.name, pose.q) for pose in before[-1:]]
        try:
            solved = sequence.try_pose(spec.name, spec, guesses, n_random)
            if not solved.is_feasible:
                return None
            q = solved.x[0]
            torque = measure_torque(self.solver.body, spec, q)
            if torque > MOST_TORQUE:
                return None
            return StancePose(spec.name, q, self._measure_balance(spec, q), self._measure_reach(spec, q), torque)
        except StaticRegionError:
            return None

    def _measure_balance(self, spec: TaskPhase, q: Float[np.ndarray, "n"]) -> float:
        """Return how far the centre of mass is inside the region that holds the phase's loads [m]."""
        body = self.solver.body
        model = body.robot.model
        data = model.createData()
        pin.centerOfMass(model, data, q)
        com = data.com[0][None, :2]
        if spec.loads and body.is_on_feet:
            contacts = list(body.planted)
            (region, *_) = plan_regions(body.engine, contacts, spec.loads, spec.first[None], body.nominal)
            return float(region.region.polygon.margin(com)[0]) - region.shift_m
        return float("inf") if body.polygon is None else float(body.polygon.margin(com)[0])

    def _measure_reach(self, spec: TaskPhase, q: Float[np.ndarray, "n"]) -> float:
        """Return by how much the arm could be longer stretched [m]."""
        hand = spec.hand
        if hand is None:
            return float("inf")
        robot = self.solver.body.robot
        used = next(known for known in list_robot_hands(robot) if hand.tool in (known.tool, known.peg, known.stub))
        shoulder = find_shoulder(robot, q, used)
        tool = locate_links(self.solver.body.engine, q, [hand.tool])[hand.tool][:3, 3]
        return measure_arm(robot, used, hand.tool) - float(np.linalg.norm(tool - shoulder))


def place_turned(mechanism: Mechanism, value: float) -> list[Float[np.ndarray, "V 3"]]:
    """Return the vertices of a mechanism's bodies in the world, its first joint, a revolute one, at a value [m]."""
    joint = mechanism.joints[0]
    turn = Rotation.from_rotvec(value * joint.axis / np.linalg.norm(joint.axis))
    return [
        turn.apply(points - joint.origin) + joint.origin
        for moved in mechanism.joints
        for points in moved.bodies.values()
    ]


def place_on_joint(mechanism: Mechanism, spec: TaskPhase, values: Sequence[float]) -> Float[np.ndarray, "P 3"]:
    """Return a hold's places in the world at values of the mechanism's first joint, which is revolute [m]."""
    joint = mechanism.joints[0]
    if spec.hand is None:
        raise ValueError(f"no hand holds anything in phase '{spec.name}'")
    axis = joint.axis / np.linalg.norm(joint.axis)
    return np.array([joint.origin + Rotation.from_rotvec(value * axis).apply(spec.hand.place) for value in values])


def measure_torque(body: WholeBody, spec: TaskPhase, q: Float[np.ndarray, "n"]) -> float:
    """Return the largest share of a joint's torque at rest, with a phase's loads or without them.

    Joints of legs are left out: their torques depend on how the feet share the forces of the ground.
    """
    robot = body.robot
    model, data = robot.model, robot.model.createData()
    weight = np.array(pin.computeGeneralizedGravity(model, data, q))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    held = np.zeros(model.nv)
    for load in spec.loads:
        link, tool = (data.oMf[model.getFrameId(frame)] for frame in (load.link, load.tool))
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getFrameJacobian(model, data, model.getFrameId(load.tool), aligned)
        force = -link.rotation @ load.force
        arm = link.act(load.place) - tool.translation
        held += jacobian[:3].T @ force + jacobian[3:].T @ np.cross(arm, force)
    torque = np.maximum(np.abs(weight), np.abs(weight - held))
    for foot in body.planted:
        for joint in list(model.supports[locate_frame(robot, foot.link)[0]])[1:]:
            column = int(model.joints[joint].idx_v)
            torque[column : column + int(model.joints[joint].nv)] = 0.0
    limited = np.isfinite(robot.effort) & (robot.effort > 0.0)
    return float((torque[limited] / robot.effort[limited]).max(initial=0.0))


def find_shoulder(robot: RobotModel, q: Float[np.ndarray, "n"], hand: Hand) -> Float[np.ndarray, "3"]:
    """Return (3,) the place of a hand's shoulder in the world [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return np.array(data.oMi[list_arm_joints(robot, hand.tool)[0]].translation)


def measure_arm(robot: RobotModel, hand: Hand, frame: str) -> float:
    """Return the length of the chain from the shoulder to a frame of the hand [m]; the arm is never longer."""
    inner = [robot.model.jointPlacements[joint].translation for joint in list_arm_joints(robot, hand.tool)[1:]]
    _, pose_joint_frame = locate_frame(robot, frame)
    return float(sum(np.linalg.norm(step) for step in (*inner, pose_joint_frame[:3, 3])))
