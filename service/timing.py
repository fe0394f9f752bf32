"""Timing of a curve: as fast as speed, acceleration and torque limits allow, and slow enough to keep its balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.stopping import poll
from service.verify.dynamics import forces, sample_times
from service.verify.limits import timed_peaks
from service.verify.motion import Motion, Phase
from service.verify.promises import outside_polygon

# A motionless stretch has no limit of its own: no knot interval is passed faster than this [s].
_SHORTEST_KNOT_TIME = 0.01
# Share of the effort limit that is left alone, for what happens between grid points.
_TORQUE_SHARE = 0.98
# Coefficients below this (in units of the limit) count as none.
_FLAT = 1e-10
_NEWTON_STEPS = 100


class TimingError(ValueError):
    """A curve that cannot be timed; the message says why."""


@dataclass(frozen=True)
class TimingSettings:
    """How a curve is timed.

    Attributes:
        velocity_scale, acceleration_scale: shares of the limits to be used, in (0, 1].
        cells_per_interval: grid cells of the time law per knot interval, denser towards the knots.
        support_links: links planted on the ground; joints between them and the base carry contact forces that timing
            does not know, so their torques are left to the verifier (:func:`slow_until_zmp_inside`).
        use_torques: whether the other joints' torque limits count.
    """

    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    cells_per_interval: int = 6
    support_links: tuple[str, ...] = ()
    use_torques: bool = True


def time_curve(
    robot: RobotModel, curve: Curve, rest_at: Sequence[float] = (), settings: TimingSettings | None = None
) -> TimeLaw:
    """Time law that is as fast as the limits allow, at rest at both ends and at ``rest_at`` (path parameters).

    TOPP-RA (Pham & Pham, T-RO 2018) on a grid that holds every knot, with the curve's second derivative taken from
    both sides, since it jumps there.  Speed and acceleration limits then hold everywhere: what the grid missed is made
    up for by slowing the stretch between two rests as a whole.  Torque limits hold at the grid points.

    Raises:
        TimingError: when a limit is not positive or no law was found.
    """
    settings = settings or TimingSettings()
    limited = replace(
        robot,
        velocity=robot.velocity * settings.velocity_scale,
        acceleration=robot.acceleration * settings.acceleration_scale,
    )
    if not (np.all(limited.velocity > 0.0) and np.all(limited.acceleration > 0.0)):
        raise TimingError("speed and acceleration limits must be positive to time a curve")
    rests = [float(s) for s in rest_at if curve.knots[0] < s < curve.knots[-1]]
    grid = _grid(curve, rests, settings.cells_per_interval)
    ends = np.concatenate([[0], np.searchsorted(grid, np.unique(rests)), [len(grid) - 1]]).astype(int)
    torque_rows = _unsupported(robot, settings) if settings.use_torques else np.zeros(robot.n, dtype=bool)
    speed = np.zeros(len(grid))
    for a, b in pairwise(ends):
        speed[a : b + 1] = _segment_speed(limited, curve, grid[a : b + 1], torque_rows)
    law = _law(grid, speed)
    return _slow_to_limits(limited, curve, law)


def slow_until_zmp_inside(motion: Motion, time_step_s: float = 0.01, reserve_m: float = 0.0) -> TimeLaw:
    """The motion's law, slowed between rests until ZMP (and torques) hold at all samples, if slowness can do that.

    With all speeds divided by c the ZMP moves towards where it is for the resting robot as 1/c^2 (the vertical
    acceleration's part aside), so one solve per pass suffices; a robot that would fall or overload a joint even at
    rest is left as it is, for the verifier to say so.

    Args:
        motion: timed.
        time_step_s: between samples.
        reserve_m: how far inside the polygon the ZMP shall be, where the robot at rest is that far inside.

    Raises:
        TimingError: when the motion has no time law.
    """
    if motion.law is None:
        raise TimingError("an untimed motion cannot be slowed")
    law = motion.law
    rests = np.flatnonzero(law.speed <= 1e-12)
    for _ in range(4):
        factor = np.ones(len(law.times) - 1)
        for a, b in pairwise(rests):
            factor[a:b] = _needed_slowness(motion, law, float(law.path[a]), float(law.path[b]), time_step_s, reserve_m)
        if np.all(factor <= 1.0):
            break
        law = _stretched(law, factor)
    return law


def _grid(curve: Curve, rests: Sequence[float], n_cells: int) -> Float[np.ndarray, "M"]:
    """Knots, rests, and points between the knots: denser towards them, where q'' jumps and q' may vanish."""
    fractions = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, n_cells) / n_cells)
    steps = np.diff(curve.knots)[:, None]
    inner = (curve.knots[:-1, None] + steps * fractions).ravel()
    for rest in rests:
        # A rest that falls on a point but for rounding would leave a cell without length.
        inner = inner[np.abs(inner - rest) > 1e-6 * steps.min()]
    return np.unique(np.concatenate([curve.knots, inner, rests]))


def _unsupported(robot: RobotModel, settings: TimingSettings) -> Bool[np.ndarray, "n"]:
    """Coordinates whose torque follows from the motion alone: neither base nor between a planted link and the base."""
    model = robot.model
    rows = np.isfinite(robot.effort) & (robot.effort > 0.0)
    rows[: 6 if robot.is_floating else 0] = False
    for link in settings.support_links:
        joint = int(model.frames[model.getFrameId(link)].parentJoint)
        while joint > 0:
            start = int(model.joints[joint].idx_v)
            rows[start : start + int(model.joints[joint].nv)] = False
            joint = int(model.parents[joint])
    return np.asarray(rows)


@dataclass(frozen=True)
class _Rows:
    """Per grid point the rows ``|a u + b x + c| <= 1`` (M, m) and ``x <= limit`` (M,); u is d2s/dt2, x is (ds/dt)^2."""

    a: Float[np.ndarray, "M m"]
    b: Float[np.ndarray, "M m"]
    c: Float[np.ndarray, "M m"]
    limit: Float[np.ndarray, "M"]

    def bounds(self, i: int, x: float, width: float, highest: float) -> tuple[float, float, float, float]:
        """Least and greatest u at ``x`` that keep the rows and ``0 <= x + 2 width u <= highest``, and their slopes."""
        a, b, c = self.a[i], self.b[i], self.c[i]
        size = np.abs(a)
        steep = size > _FLAT
        centre = np.divide(-(b * x + c), a, out=np.zeros_like(a), where=steep)
        reach = np.divide(1.0, size, out=np.full_like(a, np.inf), where=steep)
        low, high = centre - reach, centre + reach
        k, j = int(low.argmax()), int(high.argmin())
        least, most = float(low[k]), float(high[j])
        least_slope = -b[k] / a[k] if steep[k] else 0.0
        most_slope = -b[j] / a[j] if steep[j] else 0.0
        if -0.5 * x / width >= least:
            least, least_slope = -0.5 * x / width, -0.5 / width
        if 0.5 * (highest - x) / width <= most:
            most, most_slope = 0.5 * (highest - x) / width, -0.5 / width
        return least, most, float(least_slope), float(most_slope)

    def highest(self, i: int) -> float:
        """Largest x that the rows without u allow."""
        flat = (np.abs(self.a[i]) <= _FLAT) & (np.abs(self.b[i]) > _FLAT)
        room = 1.0 - np.sign(self.b[i, flat]) * self.c[i, flat]
        return float(np.min(room / np.abs(self.b[i, flat]), initial=self.limit[i]))


def _segment_speed(
    robot: RobotModel, curve: Curve, grid: Float[np.ndarray, "M"], torque_rows: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "M"]:
    """ds/dt on the grid from rest to rest."""
    for use_torques in (True, False):
        rows = torque_rows if use_torques else np.zeros_like(torque_rows)
        a, b, c = _constraint_rows(robot, curve, grid, rows)
        shortest = np.diff(curve.knots).min() / _SHORTEST_KNOT_TIME
        slope = np.abs(curve(grid, 1)) / robot.velocity
        limit = np.minimum(1.0 / np.maximum(slope.max(axis=1), 1e-12), shortest) ** 2
        speed = _fastest(_Rows(a, b, c, limit), np.diff(grid))
        if np.all(speed[1:-1] > 0.0):
            return speed
    raise TimingError(f"no time law found between s = {grid[0]} and s = {grid[-1]}")


def _fastest(rows: _Rows, width: Float[np.ndarray, "M-1"]) -> Float[np.ndarray, "M"]:
    """Greatest ds/dt from rest to rest: controllable sets backwards, then greedily forwards.

    Rest is always controllable (u = x = 0 keeps every row with ``|c| < 1``), so each set is ``[0, reachable]``.
    """
    n = len(width)
    reachable = np.zeros(n + 1)
    for i in range(n - 1, -1, -1):
        poll()
        x = rows.highest(i)
        for _ in range(_NEWTON_STEPS):
            least, most, least_slope, most_slope = rows.bounds(i, x, width[i], reachable[i + 1])
            if least <= most or x <= 0.0:
                break
            # least - most is convex and piecewise linear in x: Newton from the right descends onto its root.
            x = max(0.0, x - (least - most) / (least_slope - most_slope) - 1e-12 * x)
        reachable[i] = x
    square = np.zeros(n + 1)
    for i in range(n):
        poll()
        _, most, _, _ = rows.bounds(i, square[i], width[i], reachable[i + 1])
        square[i + 1] = np.clip(square[i] + 2.0 * width[i] * most, 0.0, reachable[i + 1])
    return np.asarray(np.sqrt(square))


def _constraint_rows(
    robot: RobotModel, curve: Curve, grid: Float[np.ndarray, "M"], torque_rows: Bool[np.ndarray, "n"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Acceleration and torque rows at both ends of each cell, each end with the cell's own second derivative.

    At the far end ``x`` is ``x + 2 du``, which makes the row ``(a + 2 d b) u + b x + c``.
    """
    width = np.append(np.diff(grid), 0.0)[:, None]
    middle = np.append(0.5 * (grid[:-1] + grid[1:]), grid[-1])
    near, far = curve(grid, 1), curve(np.append(grid[1:], grid[-1]), 1)
    # q'' is linear inside a cell, so its one-sided values at the ends follow from the middle and the slopes' change.
    centre = curve(middle, 2)
    third = np.divide(
        curve(middle + 0.25 * width[:, 0], 2) - centre, 0.25 * width, out=np.zeros_like(centre), where=width > 0.0
    )
    bend_near, bend_far = centre - 0.5 * width * third, centre + 0.5 * width * third
    is_limited = np.isfinite(robot.acceleration)
    scale = robot.acceleration[is_limited]
    parts = [_ends(near, bend_near, np.zeros_like(near), is_limited, scale, 0.0 * width)]
    parts.append(_ends(far, bend_far, np.zeros_like(far), is_limited, scale, width))
    # Inside a cell the acceleration is a parabola in s; where q' nearly vanishes its vertex can stick out.
    parts.append(_ends(curve(middle, 1), centre, np.zeros_like(far), is_limited, scale, 0.5 * width))
    if np.any(torque_rows):
        limit = robot.effort[torque_rows] * _TORQUE_SHARE
        for at, slope, bend, reach in (
            (grid, near, bend_near, 0.0 * width),
            (np.append(grid[1:], grid[-1]), far, bend_far, width),
        ):
            a, b, c = _torque_coefficients(robot, curve(at), slope, bend)
            # A joint that its own weight overloads cannot be helped by timing.
            light = torque_rows & np.all(np.abs(c) < robot.effort * _TORQUE_SHARE, axis=0)
            parts.append(_ends(a, b, c, light, limit[light[torque_rows]], reach))
    a, b, c = (np.hstack([part[k] for part in parts]) for k in range(3))
    return a, b, c


def _ends(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, columns: np.ndarray, scale: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, b, c = a[:, columns] / scale, b[:, columns] / scale, c[:, columns] / scale
    return a + 2.0 * width * b, b, c


def _torque_coefficients(
    robot: RobotModel, q: Float[np.ndarray, "M n"], slope: Float[np.ndarray, "M n"], bend: Float[np.ndarray, "M n"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torque as ``a u + b x + c``: inertia times q', inertia times q'' plus Coriolis of q', gravity [Nm]."""
    model = robot.model
    data = model.createData()
    still = np.zeros(model.nv)
    a, b, c = np.empty_like(q), np.empty_like(q), np.empty_like(q)
    for k in range(len(q)):
        poll()
        c[k] = pin.rnea(model, data, q[k], still, still)
        a[k] = pin.rnea(model, data, q[k], still, slope[k]) - c[k]
        b[k] = pin.rnea(model, data, q[k], slope[k], bend[k]) - c[k]
    return a, b, c


def _law(grid: Float[np.ndarray, "M"], speed: Float[np.ndarray, "M"]) -> TimeLaw:
    durations = 2.0 * np.diff(grid) / (speed[:-1] + speed[1:])
    return TimeLaw(np.concatenate([[0.0], np.cumsum(durations)]), grid, speed)


def _stretched(law: TimeLaw, factor: Float[np.ndarray, "M-1"]) -> TimeLaw:
    """The law with every cell's duration multiplied; the factor may only change where the path rests."""
    times = np.concatenate([law.times[:1], law.times[0] + np.cumsum(np.diff(law.times) * factor)])
    return TimeLaw(times, law.path, law.speed / np.append(factor, factor[-1]))


def _slow_to_limits(robot: RobotModel, curve: Curve, law: TimeLaw) -> TimeLaw:
    """Slow each stretch between rests until its exact peaks are within the limits."""
    peaks = timed_peaks(curve, law)
    excess = np.maximum(
        (peaks.speed / robot.velocity).max(axis=1), np.sqrt((peaks.acceleration / robot.acceleration).max(axis=1))
    )
    rests = np.flatnonzero(law.speed <= 1e-12)
    factor = np.ones(len(law.times) - 1)
    for a, b in pairwise(rests):
        inside = (peaks.s >= law.path[a]) & (peaks.s < law.path[b])
        factor[a:b] = max(1.0, float(excess[inside].max()))
    return _stretched(law, factor)


def _needed_slowness(
    motion: Motion, law: TimeLaw, first: float, last: float, time_step_s: float, reserve_m: float
) -> float:
    """By how much the stretch between two rests must be slowed for balance and torque."""
    needed = 1.0
    timed = replace(motion, law=law)
    for phase in motion.phases:
        start, end = max(first, phase.first), min(last, phase.last)
        if end <= start:
            continue
        moving, resting = _loads(timed, law, phase, start, end, time_step_s, reserve_m)
        curable = (moving > 0.0) & (resting < -1e-6)
        if np.any(curable):
            needed = max(needed, float(np.max((moving[curable] - resting[curable]) / -resting[curable])))
    # A little more than the affine estimate asks for.
    return float(np.sqrt(needed) * (1.01 if needed > 1.0 else 1.0))


def _loads(
    motion: Motion, law: TimeLaw, phase: Phase, first: float, last: float, time_step_s: float, reserve_m: float
) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S k"]]:
    """How far ZMP and torques are beyond their limits (negative: within), moving and at rest in the same poses."""
    times = sample_times(motion, law, first, last, time_step_s)
    # The same poses at rest: a law that takes forever.
    still = TimeLaw(law.times * 1e6, law.path, law.speed * 1e-6)
    columns = []
    for timing, at in ((law, times), (still, times * 1e6)):
        found = forces(motion, timing, phase, at)
        robot = motion.robot
        rows = np.isfinite(robot.effort) & (robot.effort > 0.0)
        load = np.abs(found.torque[:, rows]) / robot.effort[rows] - 1.0
        if phase.support is not None:
            outside = outside_polygon(phase.support.polygon, found.zmp(phase.support.height)) + reserve_m
            load = np.column_stack([load, np.nan_to_num(outside, nan=1e3)])
        columns.append(load)
    return columns[0], columns[1]
