"""Dry run: what a robot's driver says, compared with a plan's start, without a single command."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from costs.robot import RobotModel
from service.errors import shown
from service.execution.driver import RobotDriver, RobotReading
from service.execution.reference import PlannedReference

GRAVITY = 9.81
N_READINGS = 20
PAUSE_S = 0.02  # between two readings
CLOSE = 0.02  # of a joint that was read with another sign or unit [rad, m]
APART = 0.1  # least angle that tells signs and units apart [rad, m]
SPEED_SHARE = 0.3  # of a measured speed, by which it may be off the change of the position
MOVED = 0.01  # least travel of a joint during the readings that tells the sign of its speed [rad, m]
TORQUE_SHARE = 0.05  # of the effort, least planned torque that tells the sign of a measured one
SCALES = {"degrees": 180.0 / np.pi, "turns": 0.5 / np.pi, "millimetres": 1e3}


@dataclass(frozen=True)
class Difference:
    """One thing that a robot says otherwise than the plan expects.

    Attributes:
        what: ``clock``, ``joints``, ``value``, ``sign``, ``unit``, ``start``, ``speed``, or ``force``.
        where: joint, link or sensor.
        sentence: value and expectation, for the operator.
    """

    what: str
    where: str
    sentence: str


def compare_robot(driver: RobotDriver, reference: PlannedReference, tolerance: float) -> tuple[Difference, ...]:
    """Read a robot for a moment and return all differences from a plan's start; nothing is commanded.

    Args:
        driver: of the robot, which may have other joints than the plan.
        reference: the plan.
        tolerance: how far a joint may be from the start [rad, m].
    """
    readings = [driver.read()]
    for _ in range(N_READINGS - 1):
        time.sleep(PAUSE_S)
        readings.append(driver.read())
    return tuple(compare_readings(driver.joint_names, driver.period_s, readings, reference, tolerance))


def compare_readings(
    names: Sequence[str],
    period_s: float,
    readings: Sequence[RobotReading],
    reference: PlannedReference,
    tolerance: float,
) -> Iterator[Difference]:
    """Yield what readings of a robot at rest, or moved by hand, say otherwise than a plan expects at its start.

    Args:
        names: joints in the order of the readings.
        period_s: of the driver.
        readings: at least two.
        reference: the plan.
        tolerance: how far a joint may be from the start [rad, m].
    """
    if not 5e-4 <= period_s <= 0.1:
        yield Difference("clock", "period", f"period_s: {period_s:g} s between two commands; expected 0.0005 to 0.1")
    yield from _compare_clock([reading.time_s for reading in readings])
    missing = [name for name in reference.joint_names if name not in names]
    more = [name for name in names if name not in reference.joint_names]
    if missing:
        yield Difference("joints", missing[0], f"joint_names: lacks {_list(missing)}, which the plan moves")
    if more:
        yield Difference("joints", more[0], f"joint_names: has {_list(more)}, which the plan does not know")
    last = readings[-1]
    bad = [key for key in ("q", "qd", "torque") if not np.isfinite(getattr(last, key)).all()]
    wrong = [key for key in ("q", "qd") if np.shape(getattr(last, key)) != (len(names),)]
    for key in dict.fromkeys((*wrong, *bad)):
        yield Difference("value", key, f"{key}: expected {len(names)} finite numbers, one for each joint")
    if wrong or bad:
        return
    yield from _compare_joints(names, readings, reference, tolerance)
    if reference.at(0.0).is_floating:
        yield from _compare_gravity(last)
        yield from _compare_forces(last, reference)


def _compare_clock(times: Sequence[float]) -> Iterator[Difference]:
    steps = np.diff(times)
    if not np.isfinite(times).all():
        yield Difference("clock", "time_s", "time_s: not finite; expected seconds since the driver started")
    elif steps.min() < 0.0:
        yield Difference("clock", "time_s", f"time_s: goes back by {-steps.min():.3f} s; expected a growing time")
    elif not steps.max() > 0.0:
        text = f"time_s: stays {times[0]:g} over {len(times)} readings; expected the time of each"
        yield Difference("clock", "time_s", text)


def _compare_joints(
    names: Sequence[str], readings: Sequence[RobotReading], reference: PlannedReference, tolerance: float
) -> Iterator[Difference]:
    """Yield differences of positions, speeds and torques, joint by joint."""
    start, robot = reference.at(0.0), reference.robot
    planned, torque = (dict(zip(reference.joint_names, part.tolist(), strict=True)) for part in (start.q, start.tau))
    first, last = readings[0], readings[-1]
    elapsed = last.time_s - first.time_s
    mean_speed = np.mean([reading.qd for reading in readings], axis=0)
    for k, name in enumerate(names):
        if name not in planned:
            continue
        value, wanted = float(last.q[k]), planned[name]
        if abs(value - wanted) > tolerance:
            yield _explain_position(name, value, wanted, tolerance, robot)
        travel = float(last.q[k] - first.q[k])
        if abs(travel) > MOVED and elapsed > 0.0:
            speed, measured = travel / elapsed, float(mean_speed[k])
            if abs(measured - speed) > SPEED_SHARE * abs(speed):
                what = "sign" if measured * speed < 0.0 else "speed"
                text = f"qd of {name}: {measured:.3g} per second while q changes by {speed:.3g} per second"
                yield Difference(what, name, text)
        effort = float(robot.effort[robot.joint_names.index(name)])
        if len(last.torque) == len(names) and 0.0 < effort < np.inf and abs(torque[name]) > TORQUE_SHARE * effort:
            measured = float(last.torque[k])
            if measured * torque[name] < 0.0 and abs(measured) > 0.5 * abs(torque[name]):
                text = f"torque of {name}: {measured:.1f}; expected {torque[name]:.1f}, another sign"
                yield Difference("sign", name, text)


def _explain_position(name: str, value: float, wanted: float, tolerance: float, robot: RobotModel) -> Difference:
    """Return why a joint is not at the start: another sign, another unit, or another place."""
    if abs(wanted) > APART and abs(value + wanted) < max(CLOSE, tolerance):
        return Difference("sign", name, f"q of {name}: {value:.3f}; expected {wanted:.3f}, so the sign is another")
    for unit, scale in SCALES.items():
        if abs(wanted) > APART and abs(value / scale - wanted) < max(CLOSE, tolerance):
            text = f"q of {name}: {value:.1f}; the plan starts at {wanted:.3f}, so these are {unit}; expected rad or m"
            return Difference("unit", name, text)
    column = robot.joint_names.index(name)
    low, high = float(robot.lower[column]), float(robot.upper[column])
    if not low - tolerance <= value <= high + tolerance:
        text = f"q of {name}: {value:.3f} is outside its limits {low:.3f} to {high:.3f}; is it in rad (or m)?"
        return Difference("unit", name, text)
    text = f"q of {name}: {value:.3f}; expected {wanted:.3f} within {tolerance:g}"
    return Difference("start", name, text)


def _compare_gravity(reading: RobotReading) -> Iterator[Difference]:
    """Yield what the inertial unit of a robot at rest says otherwise than gravity."""
    rotation, felt = np.asarray(reading.imu_rotation), np.asarray(reading.imu_acceleration)
    if rotation.shape != (3, 3) or felt.shape != (3,) or not (np.isfinite(rotation).all() and np.isfinite(felt).all()):
        yield Difference("value", "imu", "imu: expected a rotation of 9 and an acceleration of 3 finite numbers")
        return
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0.0:
        yield Difference("value", "imu", "imu_rotation: is no rotation; expected axes of the unit in the world")
        return
    up, size = float((rotation @ felt)[2]), float(np.linalg.norm(felt))
    if size < 0.5 * GRAVITY:
        unit = "; are these multiples of g?" if 0.8 < size < 1.2 else ""
        yield Difference("unit", "imu", f"imu_acceleration: {size:.2f} m/s2 at rest; expected {GRAVITY:.2f}{unit}")
    elif up < 0.5 * GRAVITY:
        text = f"imu_acceleration: {up:.2f} m/s2 along the world's z at rest; expected {GRAVITY:.2f}"
        yield Difference("sign", "imu", text)


def _compare_forces(reading: RobotReading, reference: PlannedReference) -> Iterator[Difference]:
    """Yield what force sensors under a standing robot say otherwise than its weight."""
    planned = reference.at(0.0).contact_wrenches
    known = {link: np.asarray(wrench) for link, wrench in reading.foot_wrenches.items() if link in planned}
    if not known:
        return
    wanted = sum(float(planned[link][2]) for link in known)
    up = float(sum(wrench[2] for wrench in known.values()))
    if wanted <= 0.0 or abs(up - wanted) <= 0.3 * wanted:
        return
    where = ", ".join(known)
    if abs(up + wanted) <= 0.3 * wanted:
        text = f"foot_wrenches of {where}: {up:.0f} N upwards; expected {wanted:.0f} N, so the sign is another"
        yield Difference("sign", where, text)
        return
    unit = "; are these kilograms?" if abs(up * GRAVITY - wanted) <= 0.3 * wanted else ""
    what = "unit" if unit else "force"
    yield Difference(what, where, f"foot_wrenches of {where}: {up:.0f} N upwards; expected {wanted:.0f} N{unit}")


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(shown(name) for name in names[:3]) + more
