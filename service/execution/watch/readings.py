"""Check of every reading before it is used: what is missing, impossible or old is replaced by what is expected."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.robot import RobotModel
from service.errors import ExecutionError
from service.execution.driver import JointCommand, RobotReading
from service.execution.guards import Finding, Severity

GRAVITY = np.array([0.0, 0.0, 9.81])


@dataclass(frozen=True)
class ReadingSettings:
    """What a reading may be.

    Attributes:
        hold_s: time for which a sensor may fail before the execution holds [s].
        late_periods: time between two readings, in periods, from which a cycle counts as late.
        late_share: of late cycles in the last half second, from which the plan goes slowly.
        late_s: time between two readings at which the execution holds [s].
        stale_s: age of a reading, against the freshest one, at which it counts as old [s].
        stale_periods: the same in periods; the longer one counts, since a slow robot's readings come late by a period.
        still_s: time for which a sensor may repeat itself to the last bit while the joints are moved [s].
        still_rad: travel of the commands in that time [rad, m].
        beyond: by which a joint may be outside its limits [rad, m].
        jump: from one reading to the next, besides what its largest speed explains [rad, m].
        speed_factor: of a joint's largest speed, beyond which a measured speed is impossible.
        torque_factor: of a joint's effort, beyond which a measured torque is impossible.
        weight_factor: of the robot's weight, beyond which a force at a link is impossible.
        pull_n: upright force with which a sole cannot pull at the ground [N].
    """

    hold_s: float = 0.02
    late_periods: float = 1.8
    late_share: float = 0.1
    late_s: float = 0.1
    stale_s: float = 0.015
    stale_periods: float = 3.0
    still_s: float = 0.06
    still_rad: float = 0.005
    beyond: float = 0.1
    jump: float = 0.01
    speed_factor: float = 3.0
    torque_factor: float = 3.0
    weight_factor: float = 10.0
    pull_n: float = 60.0

    def __post_init__(self) -> None:
        if not min(vars(self).values()) > 0.0:
            raise ExecutionError("readings: expected positive limits")


@dataclass(frozen=True)
class ReadingState:
    """Sensors after a reading.

    Attributes:
        good: the last usable reading.
        bad_s: by sensor, time for which it has failed [s].
        is_alive: sensors that have said different things so far.
        still: by such a sensor, time [s] and travel [rad] for which it has repeated itself.
        cycles: number of readings.
        fresh_s: largest time of a reading less that of the cycles; it leaks, so that clocks may drift [s].
        late: share of late cycles.
    """

    good: RobotReading
    bad_s: Mapping[str, float] = field(default_factory=dict)
    is_alive: frozenset[str] = frozenset()
    still: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    cycles: int = 0
    fresh_s: float = 0.0
    late: float = 0.0

    @property
    def failed(self) -> frozenset[str]:
        """Sensors that fail now."""
        return frozenset(self.bad_s)


LATE_S = 0.5  # over which the share of late cycles is taken
DRIFT = 0.02  # of the driver's clock against the period, at most


class ReadingCheck:
    """Limits of all sensors of a robot, and the check of a reading against them."""

    def __init__(
        self,
        robot: RobotModel,
        joint_names: tuple[str, ...],
        period_s: float,
        settings: ReadingSettings | None = None,
    ) -> None:
        """Take the limits of the robot's joints, in the order of a driver's readings."""
        self.settings, self.joint_names, self.period_s = settings or ReadingSettings(), joint_names, period_s
        columns = [robot.joint_names.index(name) for name in joint_names]
        beyond = self.settings.beyond
        self._lower, self._upper = robot.lower[columns] - beyond, robot.upper[columns] + beyond
        speed = np.where(np.isfinite(robot.velocity[columns]), robot.velocity[columns], np.inf)
        self._speed = self.settings.speed_factor * speed
        self._step = speed * period_s + self.settings.jump
        self._torque = self.settings.torque_factor * robot.effort[columns]
        weight = 9.81 * sum(float(inertia.mass) for inertia in robot.model.inertias[1:])
        self._force = self.settings.weight_factor * max(weight, 100.0)
        self._feet = robot.link_groups.get("feet", ())

    def start(self, raw: RobotReading) -> ReadingState:
        """Return the state at the first reading, which says what sensors there are.

        Raises:
            ExecutionError: one line: a sensor that every robot needs says nothing usable.
        """
        n = len(self.joint_names)
        for name in ("q", "qd"):
            value = _read_array(getattr(raw, name, None), (n,))
            if value is None or not np.isfinite(value).all():
                raise ExecutionError(f"driver: reading.{name} is not {n} finite numbers, one per joint")
        torque = _read_array(raw.torque, (n,))
        if torque is None and np.size(raw.torque):
            raise ExecutionError(f"driver: reading.torque has {np.size(raw.torque)} numbers; expected {n}, or none")
        if torque is not None and not np.isfinite(torque).all():
            raise ExecutionError("driver: reading.torque is not finite; give no torques where none are measured")
        if not np.isfinite(raw.time_s):
            raise ExecutionError(f"driver: reading.time_s is {raw.time_s}; expected seconds of a clock")
        if not _is_imu_usable(raw):
            raise ExecutionError("driver: the inertial unit gives no rotation matrix with finite rates")
        if raw.base_offset is not None and _read_base(raw.base_offset) is None:
            raise ExecutionError("driver: reading.base_offset is no 4 x 4 pose; leave it out where none is measured")
        for link, wrench in raw.foot_wrenches.items():
            value = _read_array(wrench, (6,))
            if value is None or not np.isfinite(value).all():
                raise ExecutionError(f"driver: reading.foot_wrenches['{link}'] is not 6 finite numbers")
        return ReadingState(raw, fresh_s=float(raw.time_s))

    def list_unwatched(self, state: ReadingState) -> tuple[str, ...]:
        """Return what the sensors of a robot leave unwatched, a sentence each."""
        missing = []
        if not np.size(state.good.torque):
            missing.append("no torques are measured: servos are compared by their angles alone")
        feet = [foot for foot in self._feet if foot not in state.good.foot_wrenches]
        if feet:
            words = f"no force is measured at {' and '.join(feet)}"
            missing.append(f"{words}: contacts, balance and the pelvis are not watched")
        return tuple(missing)

    def step(
        self, state: ReadingState, raw: RobotReading | None, sent: JointCommand
    ) -> tuple[RobotReading, tuple[Finding, ...], ReadingState]:
        """Return a usable reading, what is wrong with the raw one, and the state after it.

        Args:
            state: after the reading before.
            raw: of the driver; None where it gave none.
            sent: the last command.
        """
        cycles = state.cycles + 1
        expected = self._expect(state.good, sent)
        bad: dict[str, str] = {}
        if raw is None:
            bad["driver"] = "the driver gives no reading"
            return expected, *self._conclude(replace(state, good=expected, cycles=cycles), bad)
        state, findings = self._check_time(replace(state, cycles=cycles), raw, bad)
        if "clock" in bad:  # an old or reordered reading says nothing about now
            return expected, *self._conclude(replace(state, good=expected), bad, findings)
        good = self._mend(raw, expected, bad)
        state = self._check_life(state, raw, sent, bad)
        return good, *self._conclude(replace(state, good=good), bad, findings)

    def _expect(self, good: RobotReading, sent: JointCommand) -> RobotReading:
        """Return what the next reading should be near, if the joints follow their commands."""
        q = np.clip(good.q + self.period_s * sent.qd, self._lower, self._upper)
        return replace(
            good,
            time_s=good.time_s + self.period_s,
            q=q,
            qd=sent.qd.copy(),
            imu_angular_velocity=np.zeros(3),
            imu_acceleration=good.imu_rotation.T @ GRAVITY,
        )

    def _check_time(
        self, state: ReadingState, raw: RobotReading, bad: dict[str, str]
    ) -> tuple[ReadingState, tuple[Finding, ...]]:
        """Compare the time of a reading with that of the one before and with the number of cycles."""
        limits, period = self.settings, self.period_s
        last = state.good.time_s
        try:
            time = float(raw.time_s)
        except (TypeError, ValueError):
            time = np.nan
        if not np.isfinite(time):
            bad["clock"] = f"the driver's clock says {raw.time_s}"
            return state, ()
        step, offset = time - last, time - state.cycles * period
        fresh = max(state.fresh_s - DRIFT * period, offset)
        age = fresh - offset
        if age > max(limits.stale_s, limits.stale_periods * period):
            bad["clock"] = f"readings are {1e3 * age:.0f} ms old, at {time:.3f} s"
        elif step <= 0.0 and state.cycles > 1 and "clock" not in state.bad_s:
            bad["clock"] = f"the driver's clock went from {last:.3f} s to {time:.3f} s"
        late = step > limits.late_periods * period
        share = period / LATE_S
        state = replace(state, fresh_s=fresh, late=(1.0 - share) * state.late + share * late)
        if "clock" in bad:
            return state, ()
        if step > max(limits.late_s, limits.late_periods * period):
            words = f"{1e3 * step:.0f} ms passed between two cycles; expected {1e3 * period:g} ms"
            return state, (Finding(Severity.HOLD, "clock", step, limits.late_s, words, name="late"),)
        if state.late > limits.late_share:
            words = f"{100.0 * state.late:.0f} % of the cycles come late"
            return state, (Finding(Severity.SLOW, "clock", state.late, limits.late_share, words, name="late"),)
        return state, ()

    def _mend(self, raw: RobotReading, expected: RobotReading, bad: dict[str, str]) -> RobotReading:
        """Return a reading in which what cannot be is replaced by what is expected."""
        n = len(self.joint_names)
        q, qd = self._mend_joints(raw, expected, bad)
        torque = expected.torque
        if np.size(torque):
            read = _read_array(raw.torque, (n,))
            is_possible = _within(read, -self._torque, self._torque, n)
            for k in np.flatnonzero(~is_possible).tolist():
                bad[f"torque of {self.joint_names[k]}"] = f"the torque of {self.joint_names[k]} is {_show(read, k)} N m"
            torque = np.where(is_possible, expected.torque if read is None else read, expected.torque)
        wrenches = {}
        for link, before in expected.foot_wrenches.items():
            read = _read_array(raw.foot_wrenches.get(link) if _is_mapping(raw.foot_wrenches) else None, (6,))
            problem = self._find_force_problem(link, read)
            wrenches[link] = before if problem or read is None else read
            if problem:
                bad[f"force of {link}"] = problem
        base = _read_base(raw.base_offset) if expected.base_offset is not None else None
        if base is None and expected.base_offset is not None:
            base, bad["base"] = expected.base_offset, "the pose of the base is no rotation with a place"
        imu = raw if _is_imu_usable(raw) else expected
        if imu is expected:
            bad["inertial unit"] = "the inertial unit gives no rotation matrix with possible rates"
        return RobotReading(
            float(raw.time_s),
            q,
            qd,
            np.asarray(imu.imu_rotation, dtype=float),
            np.asarray(imu.imu_angular_velocity, dtype=float),
            np.asarray(imu.imu_acceleration, dtype=float),
            wrenches,
            torque,
            base,
        )

    def _mend_joints(
        self, raw: RobotReading, expected: RobotReading, bad: dict[str, str]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Return angles and speeds, of joints whose encoder says what cannot be those that are expected."""
        n, names = len(self.joint_names), self.joint_names
        read, speed = _read_array(raw.q, (n,)), _read_array(raw.qd, (n,))
        is_inside = _within(read, self._lower, self._upper, n)
        is_near = _within(read, expected.q - self._step, expected.q + self._step, n)
        is_slow = _within(speed, -self._speed, self._speed, n)
        for k in np.flatnonzero(~(is_inside & is_near & is_slow)).tolist():
            if is_inside[k] and not is_near[k]:
                words = f"jumped to {_show(read, k)} from {expected.q[k]:.3f}"
            elif not is_inside[k]:
                words = f"says {_show(read, k)}; the joint's limits are {self._lower[k]:.3g} to {self._upper[k]:.3g}"
            else:
                words = f"says a speed of {_show(speed, k)} per second"
            bad[f"encoder of {names[k]}"] = f"the encoder of {names[k]} {words}"
        is_possible = is_inside & is_near & is_slow
        q = np.where(is_possible, expected.q if read is None else read, expected.q)
        qd = np.where(is_possible, expected.qd if speed is None else speed, expected.qd)
        return q, qd

    def _find_force_problem(self, link: str, read: Float[np.ndarray, "6"] | None) -> str:
        """Return what is wrong with a force sensor, or nothing."""
        if read is None or not np.isfinite(read).all():
            return f"the force sensor of {link} says nothing"
        size = float(np.abs(read).max())
        if size > self._force:
            return f"the force sensor of {link} says {size:.3g} N"
        if link in self._feet and read[2] < -self.settings.pull_n:
            return f"the force sensor of {link} says that the ground pulls with {-read[2]:.0f} N"
        return ""

    def _check_life(
        self, state: ReadingState, raw: RobotReading, sent: JointCommand, bad: dict[str, str]
    ) -> ReadingState:
        """Find sensors that have said different things before, and now repeat themselves while joints are moved.

        Encoders and the inertial unit go on changing by their noise, and do so one by one in a model without noise as
        well; a foot in the air says zero for a long time.
        """
        limits, still, alive = self.settings, dict[str, tuple[float, float]](), set(state.is_alive)
        travel = float(np.abs(sent.qd).max(initial=0.0)) * self.period_s
        for name, now, before in _list_signals(raw, state.good):
            if name in bad or not np.array_equal(now, before):
                alive |= {name} - set(bad)
                continue
            time, way = state.still.get(name, (0.0, 0.0))
            still[name] = time + self.period_s, way + travel
            if name in alive and still[name][0] > limits.still_s and still[name][1] > limits.still_rad:
                bad[name] = f"the {name} has repeated itself for {1e3 * still[name][0]:.0f} ms"
        return replace(state, still=still, is_alive=frozenset(alive))

    def _conclude(
        self, state: ReadingState, bad: Mapping[str, str], findings: tuple[Finding, ...] = ()
    ) -> tuple[tuple[Finding, ...], ReadingState]:
        """Return the findings on sensors that fail, and the state with the time for which they do."""
        bad_s = {name: state.bad_s.get(name, 0.0) + self.period_s for name in bad}
        made = list(findings)
        for name, sentence in bad.items():
            is_long = bad_s[name] > self.settings.hold_s
            severity = Severity.HOLD if is_long else Severity.NOTE
            kind = name.split(" of ")[0] if is_long else "dropout"
            made.append(Finding(severity, name, bad_s[name], self.settings.hold_s, sentence, name=kind))
        return tuple(made), replace(state, bad_s=bad_s)


def _list_signals(raw: RobotReading, before: RobotReading) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield the sensors that change all the time, with what they say and what they said before."""
    yield "encoders", np.asarray(raw.q), before.q
    yield "inertial unit", _join_imu(raw), _join_imu(before)
    for link, wrench in before.foot_wrenches.items():
        if wrench.any() and _is_mapping(raw.foot_wrenches) and link in raw.foot_wrenches:
            yield f"force of {link}", np.asarray(raw.foot_wrenches[link]), wrench


def _join_imu(reading: RobotReading) -> np.ndarray:
    parts = (reading.imu_rotation, reading.imu_angular_velocity, reading.imu_acceleration)
    return np.concatenate([np.ravel(np.asarray(part, dtype=object)) for part in parts])


def _is_mapping(value: object) -> bool:
    return isinstance(value, Mapping)


def _read_array(value: object, shape: tuple[int, ...]) -> Float[np.ndarray, "..."] | None:
    """Return a value as numbers of a shape; None where it has none."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return None
    return array if array.shape == shape else None


def _within(
    value: Float[np.ndarray, "n"] | None, low: Float[np.ndarray, "n"], high: Float[np.ndarray, "n"], n: int
) -> Bool[np.ndarray, "n"]:
    """Return which numbers are finite and between two others."""
    if value is None:
        return np.zeros(n, dtype=bool)
    return np.asarray(np.isfinite(value) & (value >= low) & (value <= high))


def _show(value: Float[np.ndarray, "n"] | None, k: int) -> str:
    return "nothing" if value is None else f"{value[k]:.4g}"


def _read_base(value: object) -> Float[np.ndarray, "4 4"] | None:
    """Return a pose; None for anything else."""
    pose = _read_array(value, (4, 4))
    if pose is None or not np.isfinite(pose).all() or not np.array_equal(pose[3], (0.0, 0.0, 0.0, 1.0)):
        return None
    turn = pose[:3, :3]
    is_rotation = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0
    return pose if is_rotation else None


def _is_imu_usable(reading: RobotReading) -> bool:
    """Return whether an inertial unit gives a rotation and possible rates."""
    rotation = _read_array(reading.imu_rotation, (3, 3))
    rates = _read_array(reading.imu_angular_velocity, (3,)), _read_array(reading.imu_acceleration, (3,))
    if rotation is None or not np.isfinite(rotation).all() or np.abs(rotation).max() > 1.01:
        return False
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0.0:
        return False
    return all(
        part is not None and bool((np.abs(part) < most).all()) for part, most in zip(rates, (50.0, 500.0), strict=True)
    )
