"""From a task's phases to the motion that is executed: spline, time law, samples, and its certificate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from service.body.holds import DRIFT
from service.body.phases import PlannedPhase, TaskPlan
from service.body.whole_body import WholeBody
from service.motion.spline import Path, Spline, make_spline
from service.motion.timing import TimingSettings, slow_until_zmp_inside, time_curve
from service.verify import Motion, Phase, PlantedContact, SupportPolygon
from service.verify.coverage.required import list_waived_checks
from service.verify.timeline import find_times

SAMPLE_PERIOD_S = 0.01
# Samples beside a rest, as shares of the knot interval: the robot leaves it at once, and a start that touches something
# has no room for the chord of a whole sample period.
BESIDE_REST = np.array([0.01, 0.03, 0.06])
SAME_TIME_S = 1e-5  # no two samples are nearer to each other
ZMP_RESERVE = 0.015  # how far inside the feet the motion is slowed to keep the ZMP [m]
CHORD_TOLERANCE = 1e-3  # of an untimed path's samples, read linearly [rad, m]
HELD_CHORD_SHARE = 0.05  # the same where something is held, of what that may drift: all joints of its chain add up
BASE_SPEED = 0.5  # natural speed of a coordinate without a velocity limit [m/s, rad/s]


def make_motion(plan: TaskPlan, timing: TimingSettings | None) -> Motion:
    """The sampled motion of a task's phases.

    Args:
        plan: at least one phase.
        timing: how it is timed; None for a path without a time law.
    """
    body = plan.body
    spline = _spline(body, plan.phases)
    knots = spline.curve.knots
    borders = [float(knots[end]) for end in spline.ends]
    phases = tuple(
        _phase(body, phase, knots[a : b + 1][spline.is_waypoint[a : b + 1]])
        for phase, a, b in zip(plan.phases, spline.ends[:-1], spline.ends[1:], strict=True)
    )
    motion = Motion(
        robot=body.robot,
        scene=body.scene,
        curve=spline.curve,
        phases=phases,
        mechanism_links=body.robot.mechanism_links,
        waived=list_waived_checks(
            is_timed=timing is not None, is_balanced=body.polygon is not None or not body.robot.is_floating
        ),
    )
    if timing is None:
        is_held = bool(body.holds()) or any(phase.holds for phase in plan.phases)
        chord = HELD_CHORD_SHARE * body.drift() if is_held else CHORD_TOLERANCE
        return replace(motion, samples=_path_samples(spline.curve, chord))
    planted = tuple(foot.link for foot in body.planted)
    timing = replace(timing, support_links=planted, zmp_reserve_m=ZMP_RESERVE)
    motion = replace(motion, law=time_curve(body.robot, spline.curve, borders, timing, phases))
    law = slow_until_zmp_inside(motion, reserve_m=ZMP_RESERVE)
    # What is kept more tightly than feet are needs samples closer than the usual ones.
    chord = HELD_CHORD_SHARE * body.drift() if body.drift() < DRIFT else np.inf
    return replace(motion, law=law, samples=_samples(knots, law, _chord_steps(spline.curve, chord)))


def _spline(body: WholeBody, phases: Sequence[PlannedPhase]) -> Spline:
    robot = body.robot
    standing, drift = body.holds(), body.drift()
    paths = [Path(phase.name, phase.q, (*standing, *phase.holds), drift) for phase in phases]
    speed = np.where(np.isfinite(robot.velocity), robot.velocity, BASE_SPEED)
    return make_spline(body.engine, paths, robot.lower, robot.upper, speed)


def _phase(body: WholeBody, phase: PlannedPhase, s: Float[np.ndarray, "T"]) -> Phase:
    """What a phase whose waypoints are at the path parameters ``s`` promises."""
    first, last = float(s[0]), float(s[-1])
    margin = 0.0 if phase.is_settling else body.aims.balance_margin
    support = None
    if body.polygon is not None:
        height = float(np.mean([foot.sole_in_world[:, 2].mean() for foot in body.planted]))
        support = SupportPolygon(body.polygon.vertices, margin, height)
    return Phase(
        name=phase.name,
        first=first,
        last=last,
        contacts=tuple(PlantedContact(foot.link, foot.pose_world_link, foot.sole) for foot in body.planted),
        allowances=(*body.standing_allowances(), *phase.allowances),
        targets=(*phase.targets(last), *phase.at_waypoints(s), *(kept.target() for kept in body.kept)),
        support=support,
    )


def _path_samples(curve: Curve, chord: float) -> Float[np.ndarray, "M"]:
    """Path parameters of an untimed path's samples: all knots, and as many between as keep the curve to its chords."""
    steps = np.diff(curve.knots)
    counts = np.maximum(np.ceil(steps / _chord_steps(curve, chord)), 1.0).astype(int)
    parts = [s + step * np.arange(count) / count for s, step, count in zip(curve.knots, steps, counts, strict=False)]
    return np.concatenate([*parts, curve.knots[-1:]])


def _chord_steps(curve: Curve, chord: float) -> Float[np.ndarray, "K-1"]:
    """Longest steps of the path parameter, per knot interval, over which no coordinate leaves its chord by more."""
    _, _, c2, c3 = curve.coefficients()
    steps = np.diff(curve.knots)
    bend = np.maximum(np.abs(2.0 * c2), np.abs(2.0 * c2 + 6.0 * c3 * steps[:, None])).max(axis=1)
    return np.asarray(np.sqrt(8.0 * chord / np.maximum(bend, 1e-12)))


def _samples(knots: Float[np.ndarray, "K"], law: TimeLaw, longest: Float[np.ndarray, "K-1"]) -> Float[np.ndarray, "M"]:
    """Path parameters of the exported samples: all knots, more beside rests, and one at least every sample period.

    Args:
        knots: of the curve.
        law: of its time.
        longest: per knot interval, the longest step of the path parameter between two samples.
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
