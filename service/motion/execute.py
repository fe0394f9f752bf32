"""The executed motion of a task's phases: spline, time law and samples; repair where its certificate fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance
from costs.curve import Curve, TimeLaw
from service.body.holds import DRIFT
from service.body.monitor import Monitor
from service.body.task_plan import KeptCurve, PlannedPhase, TaskPlan
from service.body.whole_body import BASE_SPEED, WholeBody
from service.demands.neighbours import make_neighbour_allowances
from service.motion.plan_law import PlanTimer
from service.motion.spline import PhasePath, Spline, make_spline
from service.motion.timing import TimingSettings
from service.start.standing import FEET_GROUP
from service.verify import (
    DEFAULT_APPROACH,
    Basis,
    Certificate,
    LoadedRegion,
    Motion,
    Phase,
    SupportPolygon,
    find_times,
    list_waived_checks,
)

SAMPLE_PERIOD_S = 0.01
# Samples beside a rest, as shares of the knot interval: the robot accelerates at once, and a start in contact has no
# room for the chord of a whole sample period.
BESIDE_REST = np.array([0.01, 0.03, 0.06])
SAME_TIME_S = 1e-5  # least distance of two samples
ZMP_RESERVE = 0.015  # of the ZMP inside the support polygon; the motion is slowed to keep it [m]
CHORD_TOLERANCE = 1e-3  # of an untimed path's samples, read linearly [rad, m]
TIGHT_CHORD = 1e-5  # the same in phases that leave a place where the robot nearly touches
CONTACT_CHORD = 1.2e-5  # the same where contacts change: points at an arm's end stay within a tenth of a millimetre
HELD_CHORD_SHARE = 0.05  # the same with holds, of their drift: all joints of a chain add up


def make_motion(plan: TaskPlan, timing: TimingSettings | None) -> Motion:
    """Make the sampled motion of a task's phases (at least one), without a time law if ``timing`` is None."""
    body = plan.body
    spline = _fit_spline(plan, is_smooth=timing is not None and timing.jerk_scale is not None)
    knots = spline.curve.knots
    borders = [float(knots[end]) for end in spline.ends]
    neighbours = make_neighbour_allowances(body.robot, body.scene, body.nominal)
    phases = tuple(
        _make_phase(_find_body(plan, phase), phase, neighbours, knots[a : b + 1][spline.is_waypoint[a : b + 1]])
        for phase, a, b in zip(plan.phases, spline.ends[:-1], spline.ends[1:], strict=True)
    )
    distances = body.aims.distances
    motion = Motion(
        robot=body.robot,
        scene=body.scene,
        curve=spline.curve,
        phases=phases,
        mechanism_links=body.robot.mechanism_links,
        waived=list_waived_checks(
            is_timed=timing is not None,
            is_balanced=not body.robot.is_floating or body.polygon is not None or body.region is not None,
        ),
        releases=body.releases,
        clearance_m=distances.clearance_m,
        sway=distances.sway,
        padding=distances.padding,
        jerk_scale=None if timing is None else timing.jerk_scale,
        tool_speed_m_s=None if timing is None else timing.tool_speed_m_s,
        pace=None if timing is None else timing.pace,
        approach=DEFAULT_APPROACH if timing is None else timing.approach,
        start_rates={} if timing is None else timing.start_rates,
        end_rates={} if timing is None else timing.end_rates,
        objects=plan.objects,
    )
    if timing is None:
        is_held = any(phase.holds or _find_body(plan, phase).holds() for phase in plan.phases)
        chord = HELD_CHORD_SHARE * body.drift() if is_held else CHORD_TOLERANCE
        return replace(motion, samples=_sample_path(spline.curve, _limit_chords(plan, spline, chord)))
    planted = tuple({foot.link: None for phase in plan.phases for foot in _find_body(plan, phase).planted})
    reserve = timing.zmp_reserve_m if timing.pace is not None else ZMP_RESERVE
    timing = replace(timing, support_links=planted, zmp_reserve_m=reserve)
    motion = PlanTimer.of(plan, motion, borders, timing).time(motion)
    # Holds with a smaller drift than planted feet, and planted hands with their longer chains, need closer samples.
    is_close = body.drift() < DRIFT or not set(planted) <= set(body.robot.link_groups.get(FEET_GROUP, ()))
    chord = HELD_CHORD_SHARE * body.drift() if is_close else np.inf
    steps = _chord_steps(motion.curve, _limit_chords(plan, spline, chord))
    return motion if motion.law is None else replace(motion, samples=_sample_law(knots, motion.law, steps))


def _find_body(plan: TaskPlan, phase: PlannedPhase) -> WholeBody:
    """Return the robot on the contacts of a phase."""
    return plan.body if phase.body is None else phase.body


def _fit_spline(plan: TaskPlan, *, is_smooth: bool) -> Spline:
    body, robot = plan.body, plan.body.robot
    standing = [_find_body(plan, phase) for phase in plan.phases]
    paths = [
        PhasePath(
            phase.name,
            phase.q,
            (*own.holds(), *phase.holds),
            min(own.drift(), phase.drift),
            phase.kept,
            phase.flows,
        )
        for phase, own in zip(plan.phases, standing, strict=True)
    ]
    speed = np.where(np.isfinite(robot.velocity), robot.velocity, BASE_SPEED)
    return make_spline(body.engine, paths, robot.lower, robot.upper, speed, is_smooth=is_smooth)


def _make_phase(
    body: WholeBody, planned: PlannedPhase, neighbours: tuple[Allowance, ...], s: Float[np.ndarray, "T"]
) -> Phase:
    """Return the verifier's phase, given the allowances of the mechanism and the path parameters of its waypoints."""
    first, last, phase = float(s[0]), float(s[-1]), planned.phase
    margin = 0.0 if planned.is_settling else body.aims.balance_margin
    support = None
    if body.polygon is not None:
        height = float(np.mean([foot.points[:, 2].mean() for foot in body.planted]))
        support = SupportPolygon(body.polygon.vertices, margin, height)
    standing = body.standing_allowances() if phase.contacts is None else ()
    at_waypoints = () if planned.at_waypoints is None else planned.at_waypoints(s)
    targets = phase.list_targets(body.robot.joint_names, last)
    return Phase(
        name=phase.name,
        first=first,
        last=last,
        contacts=body.planted,
        allowances=(*standing, *phase.touches, *neighbours),
        targets=(*targets, *at_waypoints, *(kept.target() for kept in body.kept)),
        support=support,
        loads=phase.loads,
        pushes=phase.pushes,
        regions=_place_regions(planned, body, s),
        region_margin_m=None if body.region is None else margin,
        pressed=phase.pressed,
        carriers=phase.carriers,
    )


def _place_regions(phase: PlannedPhase, body: WholeBody, s: Float[np.ndarray, "T"]) -> tuple[LoadedRegion, ...]:
    """Return the regions of a phase at their path parameters; waypoints may have been added since."""
    if body.region is not None and not phase.regions:
        region = body.region.region
        return (LoadedRegion(float(s[0]), float(s[-1]), region.vertices, region.wrenches, region.witnesses),)
    if phase.values is None:
        return ()
    borders = [float(s[0])]
    for planned in phase.regions:
        if planned.last >= len(phase.values) - 1:
            borders.append(float(s[-1]))
            continue
        off = np.abs(phase.q[:, -phase.values.shape[1] :] - phase.values[planned.last]).max(axis=1)
        borders.append(float(s[int(off.argmin())]))
    return tuple(
        LoadedRegion(first, last, planned.region.vertices, planned.region.wrenches, planned.region.witnesses)
        for planned, first, last in zip(phase.regions, borders[:-1], borders[1:], strict=True)
    )


def _limit_chords(plan: TaskPlan, spline: Spline, chord: float) -> Float[np.ndarray, "K-1"]:
    """Return the chord tolerance of the samples on each knot interval, smaller at changing contacts and near things."""
    chords = np.full(len(spline.curve.knots) - 1, chord)
    for phase, first, last in zip(plan.phases, spline.ends[:-1], spline.ends[1:], strict=True):
        own = _find_body(plan, phase)
        if own.touches is not None:
            chords[first:last] = np.minimum(chords[first:last], CONTACT_CHORD)
        if own.kept or phase.drift < DRIFT:
            drift = min(own.drift(), phase.drift)
            chords[first:last] = np.minimum(chords[first:last], HELD_CHORD_SHARE * drift)
        if phase.is_tight:
            chords[first:last] = np.minimum(chords[first:last], TIGHT_CHORD)
    return chords


def _sample_path(curve: Curve, chord: Float[np.ndarray, "K-1"]) -> Float[np.ndarray, "M"]:
    """Return path parameters of an untimed path's samples: all knots, and points between for the chord tolerance."""
    steps = np.diff(curve.knots)
    counts = np.maximum(np.ceil(steps / _chord_steps(curve, chord)), 1.0).astype(int)
    parts = [s + step * np.arange(count) / count for s, step, count in zip(curve.knots, steps, counts, strict=False)]
    return np.concatenate([*parts, curve.knots[-1:]])


def _chord_steps(curve: Curve, chord: Float[np.ndarray, "K-1"]) -> Float[np.ndarray, "K-1"]:
    """Return the longest step of the path parameter per knot interval within a chord tolerance [rad, m]."""
    _, _, c2, c3 = curve.coefficients()
    steps = np.diff(curve.knots)
    bend = np.maximum(np.abs(2.0 * c2), np.abs(2.0 * c2 + 6.0 * c3 * steps[:, None])).max(axis=1)
    return np.asarray(np.sqrt(8.0 * chord / np.maximum(bend, 1e-12)))


def _sample_law(
    knots: Float[np.ndarray, "K"], law: TimeLaw, longest: Float[np.ndarray, "K-1"]
) -> Float[np.ndarray, "M"]:
    """Return path parameters of the exported samples: all knots, points beside rests, and at least one per period.

    Args:
        knots: of the curve.
        law: its time law.
        longest: step of the path parameter between two samples, per knot interval.
    """
    times = find_times(law, knots)
    is_rest = np.isin(knots, law.path[law.speed == 0.0])
    samples = [knots[:1]]
    for k, length in enumerate(np.diff(knots)):
        duration = times[k + 1] - times[k]
        fastest = law.speed[(law.path >= knots[k]) & (law.path <= knots[k + 1])].max(initial=0.0)
        periods = duration / (SAMPLE_PERIOD_S - SAME_TIME_S), duration * fastest / longest[k]
        count = max(int(np.ceil(max(periods))), 1)
        even = np.linspace(times[k], times[k + 1], count + 1)[1:-1]
        beside = [knots[k : k + 1], knots[k + 1 : k + 2]]
        beside += [knots[k] + length * BESIDE_REST] if is_rest[k] else []
        beside += [knots[k + 1] - length * BESIDE_REST] if is_rest[k + 1] else []
        extra = np.concatenate(beside)
        is_apart = np.abs(even[:, None] - find_times(law, extra)).min(axis=1) > SAME_TIME_S
        samples += [law.at(even[is_apart])[0], extra]
    return np.unique(np.concatenate(samples))


def repair_plan(plan: TaskPlan, motion: Motion, certificate: Certificate, monitor: Monitor) -> TaskPlan | None:
    """Solve phases again with waypoints added where the motion's checks fail; None when no failing phase can be.

    The other phases keep their curves and time laws.
    """
    failures = [
        check.where.s
        for check in certificate.checks
        if check.where is not None
        and (not check.ok or check.basis is Basis.UNPROVEN)
        and not check.name.startswith("coverage.")  # waypoints cannot add a missing check
    ]
    phases = list(plan.phases)
    is_changed = False
    for index, (phase, promise) in enumerate(zip(plan.phases, motion.phases, strict=True)):
        inside = [s for s in failures if promise.first < s < promise.last]
        if not inside:
            # The tangent at a border without a rest changes with the phase beyond it.
            is_open = phase.flows or (index > 0 and plan.phases[index - 1].flows)
            phases[index] = phase if is_open or phase.at_waypoints is not None else _keep(phase, motion, promise)
            continue
        with monitor.step(f"repair {phase.name}", 0.9):
            repaired = phase.solve_again(_add_waypoints(motion, promise.first, promise.last, inside))
        if repaired is not None:
            phases[index] = repaired
            is_changed = True
    return replace(plan, phases=tuple(phases)) if is_changed else None


def _keep(phase: PlannedPhase, motion: Motion, promise: Phase) -> PlannedPhase:
    """Return a phase with the curve and time law that it has in a motion."""
    curve = motion.curve.cut(motion.curve.find_knots(promise.first, promise.last))
    law = None if motion.law is None else motion.law.cut(float(curve.knots[0]), float(curve.knots[-1]))
    return replace(phase, q=curve.positions, kept=KeptCurve(curve, law, is_settled=law is not None))


def _add_waypoints(motion: Motion, first: float, last: float, failures: Sequence[float]) -> Float[np.ndarray, "T n"]:
    """Return the phase's knots with the middle of every interval that has a failure added."""
    knots = motion.curve.knots[motion.curve.find_knots(first, last)]
    rows = np.clip(np.searchsorted(knots, failures, side="right") - 1, 0, len(knots) - 2)
    middle = 0.5 * (knots[rows] + knots[rows + 1])
    return motion.curve(np.union1d(knots, middle))
