"""Faults of sensors, servos, drivers and surroundings, put into a simulated robot at a moment of its plan."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from service.execution.driver import JointCommand, RobotReading
from service.simulation.robot import SimulatedRobot

IMU = ("imu_rotation", "imu_angular_velocity", "imu_acceleration")
ALL = ("q", "qd", *IMU, "foot_wrenches", "torque")
PUSH_N, PUSH_S = 100.0, 0.2  # of a person at the chest
OFFSET_RAD = 0.03  # of an encoder that is off from the beginning
SLIP_RAD, SLIP_S = 0.15, 0.1  # of a gear that slips, and of an encoder that jumps
STALE_S = 0.05  # by which readings are late
STALL_S = 0.15  # of a driver that stalls once
FLOOR_M = 0.02  # by which surfaces are lower


class FaultyRobot:
    """A simulated robot with one fault from a time on; implements ``RobotDriver``.

    Attributes:
        robot: in physics.
        fault: what is wrong.
        at_s: since when [s].
        arm, leg: indices of the joints that servo faults are put into.
    """

    def __init__(self, robot: SimulatedRobot, fault: Fault, at_s: float, arm: int, leg: int) -> None:
        self.robot, self.fault, self.at_s, self.arm, self.leg = robot, fault, at_s, arm, leg
        self.encoder = np.zeros(len(robot.joint_names))  # what an encoder says, less the angle of its joint
        self.kept: deque[RobotReading] = deque(maxlen=max(round(STALE_S / robot.period_s), 1) + 1)
        self.cycles = 0
        self.frozen: RobotReading | None = None  # the last reading before the fault
        self.foot = ""  # that carried most then
        self.last: JointCommand | None = None
        self._has_begun = False

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Actuated joints."""
        return self.robot.joint_names

    @property
    def period_s(self) -> float:
        """Seconds between two commands."""
        return self.robot.period_s

    @property
    def since_s(self) -> float:
        """Seconds since the fault began; negative before."""
        return self.robot.time_s - self.at_s

    def read(self) -> RobotReading:
        """Return what the sensors say now."""
        reading = self.robot.read()
        self.kept.append(replace(reading, q=reading.q + self.encoder))
        if self.since_s < 0.0:
            return self.kept[-1]
        if self.frozen is None:
            self.frozen = self.kept[-2]
            wrenches = self.frozen.foot_wrenches
            self.foot = max(wrenches, key=lambda link: float(wrenches[link][2]), default="")
        return self.fault.read(self, self.kept[-1])

    def command(self, command: JointCommand) -> None:
        """Hand a command to the servos, which see their joints by the same encoders."""
        self.cycles += 1
        if self.since_s >= 0.0:
            if not self._has_begun:
                self.fault.begin(self)
                self._has_begun = True
            self.fault.act(self)
        self.last = replace(command, q=command.q - self.encoder)
        self.robot.command(self.last)


def _pass_on(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    return reading


def _do_nothing(robot: FaultyRobot) -> None:
    return


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes:
        name: of the kind.
        names: that a report may give it; faults that cannot be told apart share them.  Empty: there need not be one.
        read: reading of the faulty robot from a true one.
        act: what is done in every cycle, before the servos move.
        begin: what is done once.
    """

    name: str
    names: frozenset[str]
    read: Callable[[FaultyRobot, RobotReading], RobotReading] = _pass_on
    act: Callable[[FaultyRobot], None] = _do_nothing
    begin: Callable[[FaultyRobot], None] = _do_nothing


def _lock(joint: Callable[[FaultyRobot], int]) -> Callable[[FaultyRobot], None]:
    def begin(robot: FaultyRobot) -> None:
        model = robot.robot.model
        model.mj.dof_frictionloss[model.dof[joint(robot)]] = 1e5

    return begin


def _weaken(joint: Callable[[FaultyRobot], int], share: float) -> Callable[[FaultyRobot], None]:
    def begin(robot: FaultyRobot) -> None:
        model, k = robot.robot.model, robot.robot.model.actuator[joint(robot)]
        model.mj.actuator_gainprm[k] *= share
        model.mj.actuator_biasprm[k] *= share

    return begin


def _slip(joint: Callable[[FaultyRobot], int], size: float, seconds: float) -> Callable[[FaultyRobot], None]:
    def act(robot: FaultyRobot) -> None:
        robot.encoder[joint(robot)] = size * min(robot.since_s / seconds, 1.0) if seconds else size

    return act


def _spoil(joint: Callable[[FaultyRobot], int]) -> Callable[[FaultyRobot, RobotReading], RobotReading]:
    def read(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
        q = reading.q.copy()
        q[joint(robot)] = np.nan
        return replace(reading, q=q)

    return read


def _keep_first(*fields: str) -> Callable[[FaultyRobot, RobotReading], RobotReading]:
    def read(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
        return replace(reading, **{name: getattr(robot.frozen, name) for name in fields})

    return read


def _reorder(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    return robot.kept[-2 - robot.cycles % 3] if len(robot.kept) > 4 else reading


def _lose_imu(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    nothing = np.full(3, np.nan)
    return replace(
        reading, imu_rotation=np.full((3, 3), np.nan), imu_angular_velocity=nothing, imu_acceleration=nothing
    )


def _change_foot(factor: float | None) -> Callable[[FaultyRobot, RobotReading], RobotReading]:
    def read(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
        wrenches = dict(reading.foot_wrenches)
        wrench = wrenches.pop(robot.foot, None)
        if wrench is not None and factor is not None:
            wrenches[robot.foot] = factor * wrench
        return replace(reading, foot_wrenches=wrenches)

    return read


def _spike(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    if robot.since_s > 0.005:
        return reading
    torque = reading.torque.copy()
    torque[robot.arm] += 500.0
    return replace(reading, torque=torque)


def _overload(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    torque = reading.torque.copy()
    torque[robot.leg] += 500.0
    return replace(reading, torque=torque)


def _stall(seconds: float, every: int) -> Callable[[FaultyRobot], None]:
    def act(robot: FaultyRobot) -> None:
        if every and robot.cycles % every:
            return
        if not every and robot.since_s > robot.period_s:
            return
        for _ in range(max(round(seconds / robot.period_s), 1)):
            if robot.last is not None:
                robot.robot.command(robot.last)

    return act


def _fail(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    raise OSError("no answer from the bus")


def _fail_once(robot: FaultyRobot, reading: RobotReading) -> RobotReading:
    if robot.since_s <= robot.period_s:
        raise OSError("a frame was lost")
    return reading


def _jam(robot: FaultyRobot) -> None:
    model = robot.robot.model
    model.mj.dof_frictionloss[model.moved_dof] = 1e5


def _tear_away(robot: FaultyRobot) -> None:
    model = robot.robot.model
    own = np.flatnonzero(model.is_mechanism)
    model.mj.geom_contype[own] = model.mj.geom_conaffinity[own] = 0
    robot.robot.hold_grips(None)


def _push(x: float, y: float) -> Callable[[FaultyRobot], None]:
    def act(robot: FaultyRobot) -> None:
        data, model = robot.robot.data, robot.robot.model
        chest = model.mj.body("link:utorso").id
        is_on = robot.since_s < PUSH_S
        data.xfrc_applied[chest, :3] = [PUSH_N * x, PUSH_N * y, 0.0] if is_on else 0.0

    return act


def _arm(robot: FaultyRobot) -> int:
    return robot.arm


def _leg(robot: FaultyRobot) -> int:
    return robot.leg


def _kinds(*names: str) -> frozenset[str]:
    return frozenset(names)


# A slipped gear, an encoder that is off and a foot that tips show the same.
_ENCODER = _kinds("encoder", "encoder or foot", "blocked joint", "weak servo", "force", "pelvis")
_STUCK = _kinds("blocked joint", "force")
_WEAK = _kinds("weak servo", "blocked joint", "pelvis", "force")

FAULTS = (
    Fault("stuck arm", _STUCK, begin=_lock(_arm)),
    Fault("stuck knee", _STUCK, begin=_lock(_leg)),
    Fault("limp arm", _WEAK, begin=_weaken(_arm, 0.0)),
    Fault("half strength arm", _WEAK, begin=_weaken(_arm, 0.5)),
    Fault("half strength knee", _WEAK, begin=_weaken(_leg, 0.5)),
    Fault("gear slips, arm", _ENCODER, act=_slip(_arm, SLIP_RAD, SLIP_S)),
    Fault("gear slips, knee", _ENCODER, act=_slip(_leg, SLIP_RAD / 3.0, SLIP_S)),
    Fault("encoder jumps", _kinds("encoder"), act=_slip(_arm, SLIP_RAD, 0.0)),
    Fault("encoder off", _ENCODER, act=_slip(_arm, OFFSET_RAD, 1.0)),
    Fault("encoder says NaN", _kinds("encoder"), read=_spoil(_leg)),
    Fault("encoders frozen", _kinds("encoders"), read=_keep_first("q", "qd")),
    Fault("all sensors frozen", _kinds("encoders", "inertial unit", "force"), read=_keep_first(*ALL)),
    Fault("readings 50 ms old", _kinds("clock"), read=lambda robot, reading: robot.kept[0]),
    Fault("readings out of order", _kinds("clock", "dropout"), read=_reorder),
    Fault("inertial unit lost", _kinds("inertial unit"), read=_lose_imu),
    Fault("inertial unit frozen", _kinds("inertial unit", "encoder or foot"), read=_keep_first(*IMU)),
    Fault("foot sensor lost", _kinds("force"), read=_change_foot(None)),
    Fault("foot sensor dead", _kinds("force"), read=_change_foot(0.0)),
    Fault("foot sensor of wrong sign", _kinds("force"), read=_change_foot(-1.0)),
    Fault("spike of 500 N m", _kinds("dropout"), read=_spike),
    Fault("500 N m too much at a knee", _kinds("weak servo", "blocked joint", "torque"), read=_overload),
    Fault("every fifth cycle late", _kinds("late"), act=_stall(0.008, 5)),
    Fault("driver stalls once", _kinds("late", "clock"), act=_stall(STALL_S, 0)),
    Fault("a reading fails", _kinds("driver", "dropout"), read=_fail_once),
    Fault("driver dies", _kinds("driver"), read=_fail),
    Fault("ground 2 cm lower", _kinds("force")),
    Fault("object jammed", _kinds("force", "blocked joint"), begin=_jam),
    Fault("object torn away", _kinds("force", "load lost"), begin=_tear_away),
    Fault("pushed from behind", frozenset(), act=_push(1.0, 0.0)),
    Fault("pushed from the front", frozenset(), act=_push(-1.0, 0.0)),
    Fault("pushed from the left", frozenset(), act=_push(0.0, -1.0)),
    Fault("pushed from the right", frozenset(), act=_push(0.0, 1.0)),
)  # fmt: skip
