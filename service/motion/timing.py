"""Time law of a curve: as fast as its limits of speed, acceleration, torque and ZMP allow.

Forces and peaks are the verifier's own (``compute_forces`` of ``service.verify.forces.dynamics``,
``measure_timed_peaks`` of ``service.verify.limits``): a mistake in them would affect law and check alike.  The
certificate's ZMP, torques and peaks are therefore no independent check of the timing; the tests compare them with
figures computed by other means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from costs.curve import Curve, TimeLaw
from costs.robot.model import RobotModel
from costs.stopping import poll
from service.motion.slowing import limit_jerk, list_stretches, slow_to_limits, stretch_law
from service.motion.time_rows import Cells, Limits, fastest_speed, force_rows, motion_rows
from service.request.paces import PACES
from service.verify import (
    DEFAULT_APPROACH,
    RISE_S,
    Approach,
    FrameSpeed,
    Joints,
    Motion,
    Phase,
    SupportPolygon,
    compute_forces,
    compute_inverse_dynamics,
    find_limited_joints,
    is_held,
    list_levers,
    list_sample_times,
    make_contact_share,
    make_joints,
    split_motion,
    trace_frame,
)

# Shortest duration of a knot interval, for stretches without motion [s].
_SHORTEST_KNOT_TIME = 0.01
# Least number of grid cells from rest to rest; points within the first and last of them, as shares of their length.
_CELLS_PER_STRETCH = 100
# Samples of a stretch whose contact forces decide its slowdown, and the least part of the motion's forces that counts.
_TRIED, _LEAST_PART = 12, 1e-3
# Where contacts change: share of the torque limits beyond which a motion is slowed, and shares to which, the first that
# the contacts allow.
_WANTED_SHARE, _SLOWED_SHARES = 0.95, (0.93, 0.98)
TORQUE_AIM = 0.99  # of a pace's share of the torques, between whose samples others lie
_SPEED_SHARE = 0.98  # of a frame's largest speed that is used
_NEAR_SHARE = 1.5  # of the distance within which a speed is limited, as neighbouring grid points may be outside
_CELLS_BESIDE_REST = 50  # in the knot intervals beside a rest, where a frame has a given speed
_SAME_POINT = 1e-3  # of the shortest knot interval, within which two grid points are one
_SAME_SPEED = 1e-9  # of two speeds along the path [1/s]
_RATE_STEP = 1e-3  # of the shortest knot interval, for the rate of a frame
_NEAR_REST = np.array([0.01, 0.03, 0.1, 0.3])


class TimingError(ValueError):
    """A curve that cannot be timed; the message says why."""


@dataclass(frozen=True)
class Pace:
    """Pace of a stretch between two rests.

    Attributes:
        first, last: path parameters of the rests.
        limits: largest speeds of frames.
        duration_s: that the stretch takes, if the fastest law is shorter; None for the fastest.
    """

    first: float
    last: float
    limits: tuple[FrameSpeed, ...] = ()
    duration_s: float | None = None


@dataclass(frozen=True)
class TimingSettings:
    """Limits and grid of the timing.

    Attributes:
        velocity_scale, acceleration_scale: shares of the limits to be used, in (0, 1].
        jerk_scale: the same of the jerk limits; None for no limit.
        cells_per_interval: least grid cells of the time law per knot interval; a stretch between two rests with few
            knots gets more.
        support_links: planted links; contact forces in the joints between them and the base are unknown here, so their
            torques are limited afterwards (:func:`slow_until_zmp_inside`).
        use_torques: whether the other joints' torque limits apply.
        zmp_reserve_m: of the ZMP inside its polygon, at most half of that at rest.
        torque_share: of the torque limits that is used.
        tool_speed_m_s: largest speed of the robot's tools; None for no limit.
        pace: whose margins the motion keeps; None for none.
        approach: of hands that begin to press.
        start_rates, end_rates: of joints at the ends of the motion, by name [rad/s, m/s]; the others rest there.
    """

    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0
    jerk_scale: float | None = None
    cells_per_interval: int = 6
    support_links: tuple[str, ...] = ()
    use_torques: bool = True
    zmp_reserve_m: float = 0.0
    torque_share: float = 1.0
    tool_speed_m_s: float | None = None
    pace: str | None = None
    approach: Approach = DEFAULT_APPROACH
    start_rates: Mapping[str, float] = field(default_factory=dict)
    end_rates: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def at_pace(name: str) -> TimingSettings:
        """Return the shares and margins of a pace."""
        rules = PACES[name]
        return TimingSettings(
            rules.velocity_scale,
            rules.acceleration_scale,
            zmp_reserve_m=rules.zmp_reserve_m,
            torque_share=TORQUE_AIM * rules.torque_share,
            pace=name,
        )


def time_curve(
    robot: RobotModel,
    curve: Curve,
    rest_at: Sequence[float] = (),
    settings: TimingSettings | None = None,
    phases: Sequence[Phase] = (),
    known: Sequence[TimeLaw] = (),
    carrying: Sequence[RobotModel] = (),
    paces: Sequence[Pace] = (),
    ends: tuple[float, float] = (0.0, 0.0),
) -> TimeLaw:
    """Make the fastest time law within the limits, at rest at ``rest_at`` (path parameters).

    Where a law from one rest to the next is known already, it is kept, slower if it would pass a limit of speed or
    acceleration.

    TOPP-RA (Pham & Pham, T-RO 2018) on a grid that holds every knot, with the curve's second derivative taken from
    both sides, since it jumps there, and limits kept at points within the cells as well.  Speed and acceleration limits
    then hold everywhere: what is missed between those points is corrected by slowing the whole stretch between two
    rests.  Torque limits hold at the grid points, and so does the ZMP where a phase with a support
    polygon covers the stretch, as far as it does at rest.

    Args:
        robot: whose limits of speed and acceleration count.
        curve: to be timed.
        rest_at: path parameters.
        settings: shares of the limits, and the grid.
        phases: with the support polygons.
        known: laws of stretches.
        carrying: the robot with what it carries in each phase; ``robot`` throughout by default.
        ends: ds/dt at the first and at the last knot; by default the robot rests there.

    Raises:
        TimingError: when a limit is not positive or no law was found.
    """
    settings = settings or TimingSettings()
    limited = scale_limits(robot, settings)
    if not (np.all(limited.velocity > 0.0) and np.all(limited.acceleration > 0.0)):
        raise TimingError("speed and acceleration limits must be positive to time a curve")
    rests = [float(s) for s in rest_at if curve.knots[0] < s < curve.knots[-1]]
    grid = _make_grid(curve, rests, settings.cells_per_interval)
    for pace in paces:
        if pace.limits:
            more = _refine_ends(curve, pace)
            apart = np.abs(more[:, None] - grid).min(axis=1) > _SAME_POINT * np.diff(curve.knots).min()
            grid = np.unique(np.concatenate([grid, more[apart]]))
    borders = np.concatenate([[0], np.searchsorted(grid, np.unique(rests)), [len(grid) - 1]]).astype(int)
    torque_rows = _find_free_torques(robot, settings) if settings.use_torques else np.zeros(robot.n, dtype=bool)
    laws = {(float(law.path[0]), float(law.path[-1])): law for law in known}
    path, speed = [grid[:1]], [np.array(ends[:1])]
    for a, b in pairwise(borders):
        cells = grid[a : b + 1]
        first, last = float(cells[0]), float(cells[-1])
        if (first, last) in laws:
            kept = laws[first, last]
            path.append(kept.path[1:])
            speed.append(kept.speed[1:])
            continue
        number = _find_covering(phases, first, last)
        support = None if number is None else phases[number].support
        carrier = robot if number is None or not carrying else carrying[number]
        loaded = limited if carrier is robot else scale_limits(carrier, settings)
        path.append(cells[1:])
        limits = [limit for pace in paces if (pace.first, pace.last) == (first, last) for limit in pace.limits]
        own = ends[0] if a == 0 else 0.0, ends[1] if b == borders[-1] else 0.0
        speed.append(_time_segment(loaded, curve, cells, torque_rows, support, settings.zmp_reserve_m, limits, own)[1:])
    law = slow_to_limits(limited, curve, TimeLaw.accelerated(np.concatenate(path), np.concatenate(speed)))
    if settings.jerk_scale is None:
        return law
    return limit_jerk(limited, curve, law, settings.jerk_scale * robot.acceleration / RISE_S, laws)


def keep_durations(law: TimeLaw, paces: Sequence[Pace]) -> TimeLaw:
    """Return a law whose stretches last as long as their paces say, where they are faster."""
    factor = np.ones(len(law.times) - 1)
    for pace in paces:
        if pace.duration_s is not None:
            inside = (law.path[:-1] >= pace.first) & (law.path[1:] <= pace.last)
            factor[inside] = max(1.0, pace.duration_s / float(np.diff(law.times)[inside].sum()))
    return stretch_law(law, factor)


def slow_until_zmp_inside(
    motion: Motion, time_step_s: float = 0.01, reserve_m: float = 0.0, settled: Sequence[tuple[float, float]] = ()
) -> TimeLaw:
    """Slow the motion's law between rests until ZMP and torques hold at all samples, if that is possible.

    With all speeds divided by c the ZMP approaches that of the resting robot as 1/c^2 (except for the vertical
    acceleration), so one solve per pass suffices.  A stretch that would fail at rest is not slowed; the verifier
    reports it.

    Args:
        motion: with a time law.
        time_step_s: between samples.
        reserve_m: of the ZMP inside the polygon, at most half of that at rest.
        settled: path parameters of two rests between which ZMP and torques are known to hold.

    Raises:
        TimingError: when the motion has no time law.
    """
    if motion.law is None:
        raise TimingError("an untimed motion cannot be slowed")
    law = motion.law
    stretches = [(a, b) for a, b in list_stretches(law) if (law.path[a], law.path[b]) not in settled]
    for _ in range(4):
        poll()
        factor = np.ones(len(law.times) - 1)
        for a, b in stretches:
            factor[a:b] = _compute_slowdown(motion, law, float(law.path[a]), float(law.path[b]), time_step_s, reserve_m)
        stretches = [(a, b) for a, b in stretches if factor[a] > 1.0]
        if np.all(factor <= 1.0):
            break
        law = stretch_law(law, factor)
    return law


def _make_grid(curve: Curve, rests: Sequence[float], least_cells: int) -> Float[np.ndarray, "M"]:
    """Return knots, rests, and points between them.

    Points are denser towards the knots, where q'' jumps, and much denser towards rests, where the tangent vanishes and
    the fastest law raises ds/dt at once.  Stretches with few knots get more cells for each interval.
    """
    knots = curve.knots
    stops = np.unique(np.concatenate([knots[:1], rests, knots[-1:]]))
    first, last = np.searchsorted(knots, stops[:-1], side="right"), np.searchsorted(knots, stops[1:], side="left")
    cells = np.maximum(least_cells, np.ceil(_CELLS_PER_STRETCH / np.maximum(last - first + 1, 1)).astype(int))
    owner = np.clip(np.searchsorted(stops, 0.5 * (knots[:-1] + knots[1:])) - 1, 0, len(cells) - 1)
    parts = [
        start + step * (0.5 - 0.5 * np.cos(np.pi * np.arange(1, count) / count))
        for start, step, count in zip(knots, np.diff(knots), cells[owner], strict=False)
    ]
    inner = np.concatenate(parts)
    # A rest that falls on a point but for rounding would leave a cell without length.
    close = 1e-6 * np.diff(knots).min()
    inner = inner[np.abs(inner[:, None] - stops).min(axis=1) > close]
    grid = np.unique(np.concatenate([knots, inner, rests]))
    at = np.searchsorted(grid, stops)
    behind = grid[at[:-1], None] + np.diff(grid)[at[:-1], None] * _NEAR_REST
    before = grid[at[1:], None] - np.diff(grid)[at[1:] - 1, None] * _NEAR_REST
    return np.unique(np.concatenate([grid, behind.ravel(), before.ravel()]))


def _refine_ends(curve: Curve, pace: Pace) -> Float[np.ndarray, "C"]:
    """Return more grid points beside both rests of a stretch with a given speed, where a frame's rate rises from 0."""
    knots = curve.knots[curve.find_knots(pace.first, pace.last)]
    share = np.arange(1, _CELLS_BESIDE_REST) / _CELLS_BESIDE_REST
    ends = ((knots[0], knots[1]), (knots[-2], knots[-1]))
    return np.concatenate([first + share * (last - first) for first, last in ends])


def _find_free_torques(robot: RobotModel, settings: TimingSettings) -> Bool[np.ndarray, "n"]:
    """Return coordinates whose torque follows from the motion alone: not the base or a planted link's chain."""
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


def _find_covering(phases: Sequence[Phase], first: float, last: float) -> int | None:
    """Return the number of the phase that covers the stretch, or of the first of several that do on the same feet."""
    slack = 1e-9 * max(1.0, abs(last))
    inside = [k for k, phase in enumerate(phases) if phase.first < last - slack and phase.last > first + slack]
    if not inside or phases[inside[0]].first > first + slack or phases[inside[-1]].last < last - slack:
        return None
    supports = [phases[k].support for k in inside]
    return inside[0] if all(_stand_alike(a, b) for a, b in pairwise(supports)) else None


def _stand_alike(a: SupportPolygon | None, b: SupportPolygon | None) -> bool:
    """Return whether two polygons are the same."""
    if a is None or b is None:
        return a is b
    return a.polygon.shape == b.polygon.shape and bool(np.allclose(a.polygon, b.polygon, atol=1e-9))


def _time_segment(
    robot: RobotModel,
    curve: Curve,
    grid: Float[np.ndarray, "M"],
    torque_rows: Bool[np.ndarray, "n"],
    support: SupportPolygon | None,
    reserve_m: float,
    limits: Sequence[FrameSpeed] = (),
    ends: tuple[float, float] = (0.0, 0.0),
) -> Float[np.ndarray, "M"]:
    """Return ds/dt on the grid between two ends; without force limits where these leave no law."""
    cells = Cells.of(curve, grid)
    slope = np.abs(curve(grid, 1)) / robot.velocity
    fastest = np.minimum(1.0 / np.maximum(slope.max(axis=1), 1e-12), _bound_by_knots(curve, grid))
    for wanted in limits:
        rates = _measure_rates(robot, curve, grid, wanted.frame)
        rates[(grid < wanted.first) | (grid > wanted.last)] = 0.0
        if np.isfinite(wanted.near_m):
            _, places = trace_frame(robot.model, wanted.frame, curve(np.append(grid, wanted.last)))
            rates[np.linalg.norm(places[:-1] - places[-1], axis=1) > _NEAR_SHARE * wanted.near_m] = 0.0
        fastest = np.minimum(fastest, _SPEED_SHARE * wanted.most / np.maximum(rates, 1e-12))
    limit = fastest**2
    rows = list(motion_rows(robot, cells))
    for more in (list(force_rows(robot, curve, cells, torque_rows, support, reserve_m)), []):
        speed = fastest_speed(Limits(rows + more, limit), np.diff(grid), ends)
        if np.all(speed[1:-1] > 0.0) and np.all(np.abs(speed[[0, -1]] - ends) <= _SAME_SPEED):
            return speed
    raise TimingError(f"no time law found between s = {grid[0]} and s = {grid[-1]}")


def _bound_by_knots(curve: Curve, s: Float[np.ndarray, "M"]) -> Float[np.ndarray, "M"]:
    """Return ds/dt with which the knot interval about a point takes its shortest time; at a knot the shorter one's."""
    spans, last = np.diff(curve.knots), len(curve.knots) - 2
    behind = np.searchsorted(curve.knots, s, side="left") - 1
    ahead = np.searchsorted(curve.knots, s, side="right") - 1
    return np.asarray(np.minimum(spans[behind.clip(0, last)], spans[ahead.clip(0, last)]) / _SHORTEST_KNOT_TIME)


def _measure_rates(robot: RobotModel, curve: Curve, s: Float[np.ndarray, "M"], frame: str) -> Float[np.ndarray, "M"]:
    """Return how fast a frame's origin moves per path parameter [m]."""
    step = _RATE_STEP * np.diff(curve.knots).min()
    before, after = np.maximum(s - step, curve.knots[0]), np.minimum(s + step, curve.knots[-1])
    _, first = trace_frame(robot.model, frame, curve(before))
    _, last = trace_frame(robot.model, frame, curve(after))
    return np.asarray(np.linalg.norm(last - first, axis=1) / (after - before))


def scale_limits(robot: RobotModel, settings: TimingSettings) -> RobotModel:
    """Return the robot with the shares of its speed and acceleration limits that are used."""
    return replace(
        robot,
        velocity=robot.velocity * settings.velocity_scale,
        acceleration=robot.acceleration * settings.acceleration_scale,
        effort=robot.effort * settings.torque_share,
    )


def _compute_slowdown(
    motion: Motion, law: TimeLaw, first: float, last: float, time_step_s: float, reserve_m: float
) -> float:
    """Return the factor by which the stretch between two rests must be slowed for balance and torque."""
    needed = 1.0
    for phase, part in zip(motion.phases, split_motion(motion), strict=True):
        timed = replace(part, law=law)
        start, end = max(first, phase.first), min(last, phase.last)
        if end <= start:
            continue
        if phase.region_margin_m is not None:
            needed = max(needed, _compute_cone_slowdown(part, law, phase, start, end, time_step_s))
            continue
        moving, resting = _compare_with_rest(timed, law, phase, start, end, time_step_s, reserve_m)
        curable = (moving > 0.0) & (resting < -1e-6)
        if np.any(curable):
            needed = max(needed, float(np.max((moving[curable] - resting[curable]) / -resting[curable])))
    # A little more than the affine estimate.
    return float(np.sqrt(needed) * (1.01 if needed > 1.0 else 1.0))


def _compute_cone_slowdown(
    motion: Motion, law: TimeLaw, phase: Phase, first: float, last: float, time_step_s: float
) -> float:
    """Return the square of the factor by which a stretch must be slowed until contact forces inside cones carry it.

    Forces and torques are those at rest plus a part that falls with the square of the speed, so that the largest part
    that the contacts carry decides.
    """
    times = list_sample_times(motion, law, first, last, time_step_s)
    s, speed, gain = law.at(times)
    q, slope, bend = motion.curve(s), motion.curve(s, 1), motion.curve(s, 2)
    v, a = slope * speed[:, None], slope * gain[:, None] + bend * speed[:, None] ** 2
    moving = compute_inverse_dynamics(motion, q, v, a)
    limited, share = find_limited_joints(motion), make_contact_share(motion, phase)
    joints = make_joints(motion, moving.torque, list_levers(motion.robot.model, phase, moving.jacobians))
    held = share.hold(moving.wrench, joints)
    beyond = np.flatnonzero(~is_held(held) | (held.shares > _WANTED_SHARE).any(axis=1))
    if not len(beyond):
        return 1.0
    worst = beyond[np.lexsort((held.shares[beyond].max(axis=1, initial=0.0), held.missing_n[beyond]))[::-1]][:_TRIED]
    still = compute_inverse_dynamics(motion, q[worst], 0.0 * v[worst], 0.0 * a[worst], has_jacobians=False)
    parts = []
    for k, row in enumerate(worst.tolist()):
        poll()
        rest, more = still.torque[k, limited], moving.torque[row, limited] - still.torque[k, limited]
        for slowed in _SLOWED_SHARES:
            both = Joints(np.stack([rest, more]), joints.lever[[row]], slowed * joints.effort)
            part = share.find_part(still.wrench[k], moving.wrench[row] - still.wrench[k], both)
            if part > _LEAST_PART:
                parts.append(part)
                break
    return 1.0 / min(parts) if parts else 1.0


def _compare_with_rest(
    motion: Motion, law: TimeLaw, phase: Phase, first: float, last: float, time_step_s: float, reserve_m: float
) -> tuple[Float[np.ndarray, "S k"], Float[np.ndarray, "S k"]]:
    """Return ZMP and torques relative to their limits (positive: beyond), moving and at rest in the same poses.

    Samples within all limits are left out.
    """
    times = list_sample_times(motion, law, first, last, time_step_s)
    robot, support = motion.robot, phase.support
    rows = find_limited_joints(motion)

    def measure(timing: TimeLaw, at: Float[np.ndarray, "R"]) -> tuple[np.ndarray, np.ndarray]:
        loads = compute_forces(motion, timing, phase, at)
        outside = np.full(len(at), -np.inf)
        if support is not None:
            outside = np.minimum(loads.find_worst_zmp(support)[1], 1e3)
        return loads.find_largest_torque()[:, rows] / robot.effort[rows] - 1.0, outside

    torque, outside = measure(law, times)
    beyond = np.flatnonzero((torque > 0.0).any(axis=1) | (outside > -reserve_m))
    if not len(beyond):
        return np.zeros((0, len(rows) + 1)), np.zeros((0, len(rows) + 1))
    # The same poses at rest: a law that takes forever.
    still = TimeLaw(law.times * 1e6, law.path, law.speed * 1e-6)
    torque_still, outside_still = measure(still, times[beyond] * 1e6)
    reserve = np.minimum(reserve_m, np.maximum(-0.5 * outside_still, 0.0))
    moving = np.column_stack([torque[beyond], outside[beyond] + reserve])
    return moving, np.column_stack([torque_still, outside_still + reserve])
