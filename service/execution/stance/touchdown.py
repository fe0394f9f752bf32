"""Soft touchdown of a foot: it comes down with the toe up and a torque-free ankle, and stops where the ground is.

Liu et al., Humanoids 2015, II.B: "we first tilt the foot up, and then set the desired ankle torques to be zero and the
corresponding gains in K_f to be non zero before touchdown".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from service.errors import ExecutionError
from service.execution.driver import JointCommand, RobotReading
from service.execution.reference import ReferencePhase
from service.execution.shift import Shift, ShiftLimits, step_shift

MAX_TILT_RAD = 0.35
SOLE_DEPTH = 5e-3  # of the points of a foot that are its sole, from the lowest one [m]


class Stage(Enum):
    """What an ankle does."""

    STIFF = "stiff"  # follows its command
    TILTED = "tilted"  # on its way down with the toe up
    FREE = "free"  # no torque: about to touch, or just touched
    SETTLED = "settled"  # stiff again, as the ground turned it
    BALANCING = "balancing"  # makes the torque that the balance wants


@dataclass(frozen=True)
class TouchdownSettings:
    """How a foot is put down.

    Attributes:
        tilt_rad: angle of the sole, toe up, before it touches.
        tilt_rate: of that angle while it comes and goes [rad/s].
        lead_s: time before the planned touch from which the sole is tilted [s].
        free_s: time before the planned touch from which the ankle is free [s].
        torque_gain: share of the measured ankle torque that is fed back: ``K_f`` of eq. 8, with a desired torque of 0.
        damping_share: of the servo's damping that a free ankle keeps, so that the sole neither swings nor slaps down.
        flat_rate: speed at which this damping turns the toe down after the touch [rad/s].
        touch_n: upright force at which the foot touches the ground [N].
        touch_s: time for which it must be exceeded [s].
        settle_s: time after the touch in which the sole comes flat, and then time in which the ankle becomes stiff [s].
        press_n: upright force with which a foot that has touched presses until it carries weight [N].
        press_gain: speed of its target per newton that it presses harder [m/(N s)].
        press_speed: at most, downwards, of a foot that has touched [m/s].
        probe_speed: of the foot that looks for ground below its planned place [m/s].
        return_speed: of a lifted foot back to the plan's height [m/s].
        avoid_gain: upward speed of a foot that meets something on its way, per newton of its force [m/(N s)].
        seek_share: of the planned force of a planted foot, below which it looks for its ground beside other contacts.
        seek_gain: downward speed of such a foot per newton that is missing, at most the probe's [m/(N s)].
        probe_m: how far the ground may be from where the plan has it [m].
        ground_rad: error of the ground's measured slope, to which the ankle does not stay adapted [rad].
        limits: of the displacement of the foot.
    """

    tilt_rad: float = 0.03
    tilt_rate: float = 0.25
    lead_s: float = 0.7
    free_s: float = 0.25
    torque_gain: float = 0.8
    damping_share: float = 0.1
    flat_rate: float = 0.2
    touch_n: float = 25.0
    touch_s: float = 0.004
    settle_s: float = 0.25
    press_n: float = 60.0
    press_gain: float = 1.2e-4
    press_speed: float = 0.01
    probe_speed: float = 0.03
    return_speed: float = 0.015
    avoid_gain: float = 4e-4
    seek_share: float = 0.5
    seek_gain: float = 2e-4
    probe_m: float = 0.03
    ground_rad: float = 0.03
    limits: ShiftLimits = field(default_factory=lambda: ShiftLimits(speed=0.2, acceleration=20.0))

    def __post_init__(self) -> None:
        if not (0.0 <= self.tilt_rad <= MAX_TILT_RAD and 0.0 <= self.torque_gain <= 1.0):
            raise ExecutionError(
                f"touchdown: tilt_rad {self.tilt_rad:g}, torque_gain {self.torque_gain:g}; expected 0 to "
                f"{MAX_TILT_RAD:g} rad and a gain of 0 to 1"
            )


@dataclass(frozen=True)
class Ankle:
    """Joints of a foot's ankle.

    Attributes:
        foot: link.
        joints: indices in the order of the commands: the last two joints above the foot.
        toe_up: (2,) change of the joints' angles per radian of toe-up tilt.
        heel_m: by which the heel comes lower than the flat sole, per radian of that tilt [m].
    """

    foot: str
    joints: np.ndarray
    toe_up: Float[np.ndarray, "2"]
    heel_m: float = 0.0


@dataclass(frozen=True)
class FootReading:
    """A foot as the sensors show it, against the plan.

    Attributes:
        upright_n: measured upright force [N].
        planned_speed: upward, of the foot in the plan [m/s].
        slope: angle between its sole and that of the plan [rad].
        ankle_off: (2,) measured angles of the ankle less the commanded ones [rad].
    """

    upright_n: float
    planned_speed: float
    slope: float
    ankle_off: Float[np.ndarray, "2"]


@dataclass(frozen=True)
class TouchdownState:
    """A foot on its way to the ground.

    Attributes:
        stage: of its ankle.
        offset: (2,) of the ankle's joints from their command [rad].
        softness: 1 for an ankle without torque, 0 for one that follows its command.
        tilt: toe-up angle now [rad].
        pressed_s: time for which the foot has carried force [s].
        since_s: time in this stage, or since the touch [s].
        height: displacement of the foot's target along z.
        has_touched: whether the foot has found the ground.
        is_sloped: whether the ground has a slope of its own, to which the ankle stays adapted.
        is_clear: whether the foot has been off the ground since it went up.
    """

    stage: Stage
    offset: Float[np.ndarray, "2"]
    softness: float
    tilt: float
    pressed_s: float
    since_s: float
    height: Shift
    has_touched: bool
    is_sloped: bool
    is_clear: bool = False

    @property
    def is_idle(self) -> bool:
        """Whether the foot follows its command, without any displacement that is left."""
        height = self.height
        moves = self.offset.any() or height.offset.any() or height.speed.any() or height.goal.any()
        return self.stage is Stage.STIFF and not moves

    @staticmethod
    def stiff() -> TouchdownState:
        """Return the state of a foot that follows its command."""
        return TouchdownState(Stage.STIFF, np.zeros(2), 0.0, 0.0, 0.0, 0.0, Shift.zero(), False, False)


def find_ankle(robot: RobotModel, joint_names: Sequence[str], foot: str) -> Ankle:
    """Return the ankle of a foot: the two joints above it, and how they tilt the toe up.

    Raises:
        ExecutionError: fewer than two joints carry the foot.
    """
    model = robot.model
    frame = model.frames[model.getFrameId(foot)]
    last = frame.parentJoint
    above = [int(last), int(model.parents[last])]
    names = [robot.joint_names[model.joints[joint].idx_v] for joint in above]
    missing = [name for name in names if name not in joint_names]
    if missing:
        raise ExecutionError(f"{robot.name}: {foot} has no ankle of two joints; {missing[0]} is not commanded")
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    turns = pin.getFrameJacobian(model, data, model.getFrameId(foot), pin.ReferenceFrame.LOCAL)[3:]
    columns = [model.joints[joint].idx_v for joint in above]
    # Toe up is a negative turn about the foot's y axis.
    toe_up = np.linalg.lstsq(turns[:, columns], np.array([0.0, -1.0, 0.0]), rcond=None)[0]
    heel = measure_heel(robot, foot)
    return Ankle(foot, np.array([list(joint_names).index(name) for name in names]), toe_up, heel)


def measure_heel(robot: RobotModel, foot: str) -> float:
    """Return how far the sole of a foot reaches behind the foot's frame, about which it tilts [m]; 0 without shape."""
    model = robot.model
    frame = model.frames[model.getFrameId(foot)]
    place = frame.placement.inverse()
    parts = [body.vertices.T for body in robot.bodies if body.link == foot]
    if not parts:
        return 0.0
    points = place.rotation @ np.concatenate(parts, axis=1) + place.translation[:, None]
    sole = points[:, points[2] < points[2].min() + SOLE_DEPTH]
    return max(float(-sole[0].min()), 0.0)


def find_landing(phases: Sequence[ReferencePhase], index: int, foot: str) -> ReferencePhase | None:
    """Return the next phase that plants a foot which is in the air in a phase; None if it is planted or stays up."""
    if any(contact.link == foot for contact in phases[index].contacts):
        return None
    later = (phase for phase in phases[index + 1 :] if any(contact.link == foot for contact in phase.contacts))
    return next(later, None)


def step_touchdown(
    settings: TouchdownSettings,
    state: TouchdownState,
    ankle: Ankle,
    foot: FootReading,
    *,
    lands: bool,
    planted: bool,
    balances: bool,
    left_s: float,
    period_s: float,
) -> TouchdownState:
    """Return the state of a foot one cycle later.

    Args:
        settings: how it is put down.
        state: the earlier one.
        ankle: of the foot.
        foot: as measured.
        lands: whether it is in the air and to be put down soon.
        planted: whether the plan has it on the ground now.
        balances: whether ankles of planted feet keep the balance.
        left_s: time to the planned touch [s].
        period_s: of the cycle [s].
    """
    touches = foot.upright_n >= settings.touch_n
    pressed = state.pressed_s + period_s if touches else 0.0
    state = replace(state, pressed_s=pressed, since_s=state.since_s + period_s, is_clear=state.is_clear and not planted)
    step = settings.tilt_rate * period_s
    if not lands and not planted:  # in the air: the foot goes back to its command
        offset = state.offset - np.clip(state.offset, -step, step)
        is_clear = state.is_clear or not touches
        height = _go_on_clear(settings, state, foot, period_s)
        return replace(TouchdownState.stiff(), offset=offset, height=height, is_clear=is_clear)
    if planted and balances and (state.stage is not Stage.FREE or state.has_touched):
        soft = min(state.softness + period_s / settings.settle_s, 1.0)
        return replace(state, stage=Stage.BALANCING, softness=soft, offset=foot.ankle_off, tilt=0.0)
    if state.stage is Stage.BALANCING:
        state = replace(state, stage=Stage.SETTLED, is_sloped=foot.slope > settings.ground_rad)
    if state.stage is Stage.STIFF and lands:
        state = replace(state, stage=Stage.TILTED, since_s=0.0)
    if state.stage is Stage.TILTED:
        tilt = min(state.tilt + step, settings.tilt_rad)
        state = replace(state, tilt=tilt, offset=tilt * ankle.toe_up)
        if left_s <= settings.free_s or pressed > settings.touch_s:
            state = replace(state, stage=Stage.FREE, since_s=0.0)
    if state.stage is Stage.FREE:
        state = _step_free(settings, state, foot, planted)
    elif state.stage is Stage.SETTLED:
        offset = state.offset if state.is_sloped else state.offset - np.clip(state.offset, -step, step)
        state = replace(state, offset=offset, softness=max(state.softness - period_s / settings.settle_s, 0.0))
    if state.stage is Stage.TILTED:  # the heel is then as high above the ground as the plan has the sole
        state = replace(state, height=state.height.towards(np.array([0.0, 0.0, ankle.heel_m * state.tilt])))
    return replace(state, height=_move_height(settings, state, foot, left_s, period_s))


def _go_on_clear(settings: TouchdownSettings, state: TouchdownState, foot: FootReading, period_s: float) -> Shift:
    """Return the displacement of a foot in the air: back to the plan, but up where it meets something on its way."""
    if state.is_clear and foot.upright_n >= settings.touch_n:
        speed = min(settings.avoid_gain * foot.upright_n, settings.limits.speed)
        return move_target(settings, state.height, speed, period_s)
    slow = replace(settings.limits, speed=settings.return_speed)  # or it would press on ground that it leaves
    return step_shift(state.height.towards(np.zeros(3)), slow, period_s)


def _step_free(settings: TouchdownSettings, state: TouchdownState, foot: FootReading, planted: bool) -> TouchdownState:
    """Return a foot with a free ankle, which touches, comes flat and becomes stiff again."""
    state = replace(state, offset=foot.ankle_off, softness=1.0)
    if not state.has_touched and state.pressed_s > settings.touch_s:
        state = replace(state, has_touched=True, since_s=0.0)
    if state.has_touched and state.since_s > settings.settle_s and planted:
        return replace(state, stage=Stage.SETTLED, since_s=0.0, is_sloped=foot.slope > settings.ground_rad)
    return state


def _move_height(
    settings: TouchdownSettings, state: TouchdownState, foot: FootReading, left_s: float, period_s: float
) -> Shift:
    """Return the displacement of a foot that comes down: it stops where it meets ground, and presses lightly on it.

    From the touch on the target does not follow the plan any more: it moves in proportion to the force in excess.  Long
    before the planned touch it gives way only.  After it, a foot without contact looks for ground below.
    """
    if state.stage is not Stage.FREE:
        return step_shift(state.height, settings.limits, period_s)
    speed = min(settings.press_gain * (foot.upright_n - settings.press_n), settings.limits.speed)
    slowest = settings.press_speed if state.has_touched else settings.probe_speed
    speed = max(speed, -slowest) if foot.upright_n >= settings.touch_n else -slowest
    if left_s > settings.free_s:
        speed = max(speed, 0.0)
    elif state.has_touched or left_s <= 0.0:
        speed -= foot.planned_speed
    else:
        speed = 0.0
    return move_target(settings, state.height, speed, period_s)


def find_seek_speed(settings: TouchdownSettings, upright_n: float, planned_n: float) -> float:
    """Return the upward speed of a planted foot that carries much less or much more than planned [m/s].

    Zero for a foot that the plan hardly loads, and within a factor ``1 / seek_share`` of the plan.
    """
    if planned_n < settings.press_n:
        return 0.0
    if upright_n < settings.touch_n:
        return -settings.probe_speed
    within = float(np.clip(upright_n, settings.seek_share * planned_n, planned_n / settings.seek_share))
    return float(np.clip(settings.seek_gain * (upright_n - within), -settings.probe_speed, settings.probe_speed))


def move_target(settings: TouchdownSettings, height: Shift, speed: float, period_s: float) -> Shift:
    """Return a displacement along z one period later, on its way to a speed [m/s], as far as the ground may be off."""
    step, now = settings.limits.acceleration * period_s, float(height.speed[2])
    at = float(height.offset[2]) + period_s * (now + float(np.clip(speed - now, -step, step)))
    at = float(np.clip(at, -settings.probe_m, settings.probe_m))
    offset = np.array([0.0, 0.0, at])
    return Shift(offset, np.array([0.0, 0.0, (at - float(height.offset[2])) / period_s]), offset)


def soften(
    settings: TouchdownSettings,
    ankle: Ankle,
    state: TouchdownState,
    command: JointCommand,
    reading: RobotReading,
    balancing: Float[np.ndarray, "2"] | None = None,
) -> JointCommand:
    """Return a command with the ankle as touchdown and balance want it.

    A free ankle is commanded to be where it is, so that the servo makes no torque of its own but a little damping, and
    the measured torque is fed back: eq. 8 with ``K_p = 0``.  The desired torque is that of the plan in the air, which
    carries the foot's weight, and zero from the touch on.  An ankle that keeps the balance is commanded to be where it
    is as well, with the torque ``balancing`` (2,) of its joints.
    """
    if state.softness == 0.0 and not state.offset.any():
        return command
    q, qd, tau = command.q.copy(), command.qd.copy(), command.tau.copy()
    joints, soft = ankle.joints, state.softness
    q[joints] = (1.0 - soft) * (q[joints] + state.offset) + soft * reading.q[joints]
    qd[joints] += soft * (1.0 - settings.damping_share) * (reading.qd[joints] - qd[joints])
    if state.has_touched and state.since_s < settings.settle_s:
        qd[joints] -= soft * settings.damping_share * settings.flat_rate * ankle.toe_up
    if balancing is not None and state.stage is Stage.BALANCING:
        own = balancing
    else:
        wanted = np.zeros(len(joints)) if state.has_touched else tau[joints]
        own = wanted + settings.torque_gain * (wanted - reading.torque[joints])
    tau[joints] = (1.0 - soft) * tau[joints] + soft * own
    return JointCommand(q, qd, tau)
