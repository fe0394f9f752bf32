"""Time law of a plan: the fastest of its curve, slowed for balance, tools and grips, also between moving ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel
from service.body.task_plan import PlannedPhase, TaskPlan
from service.body.whole_body import BASE_SPEED
from service.motion.jams import list_cheap_speeds
from service.motion.slowing import slow_to_limits, slow_to_speeds, slow_until_grips_hold, stretch_law
from service.motion.timing import (
    Pace,
    TimingError,
    TimingSettings,
    keep_durations,
    scale_limits,
    slow_until_zmp_inside,
    time_curve,
)
from service.verify import FrameSpeed, Motion, list_frame_speeds, place_rates, split_motion

SLOWER = 0.7  # of the speeds along the path at moving ends, where no law with these exists
TRIES = 14
ROUNDS = 12  # of slowing a law and fitting the ends of its curve again
SPARE = 1.003  # more than a round asks
SAME_DURATION = 1e-9  # share of a duration that is rounding
Stretch = list[tuple[PlannedPhase, float, float]]  # phases from one rest to the next, and their path parameters


@dataclass(frozen=True)
class PlanTimer:
    """What the time law of a plan obeys.

    Attributes:
        plan: with the curves, laws and speeds of its phases.
        borders: path parameters at which phases begin, and the last end.
        rests: those at which the robot rests: not between phases that flow into each other.
        settings: limits.
        paces: of the stretches between rests without a law of their own.
        speeds: largest speeds of frames that the motion promises.
        settled: ends of the phases whose law is known to keep all limits.
        given: ends of the stretches in which the task says how fast a frame moves.
    """

    plan: TaskPlan
    borders: tuple[float, ...]
    rests: tuple[float, ...]
    settings: TimingSettings
    paces: tuple[Pace, ...]
    speeds: tuple[FrameSpeed, ...]
    settled: tuple[tuple[float, float], ...]
    given: tuple[tuple[float, float], ...]

    @staticmethod
    def of(plan: TaskPlan, motion: Motion, borders: Sequence[float], settings: TimingSettings) -> PlanTimer:
        """Read what the phases of a plan say about its law."""
        stretches = _list_stretches(plan, borders)
        given = _list_ends(parts for parts in stretches if any(phase.limits for phase, _, _ in parts))
        known = _list_ends(parts for parts in stretches if all(_has_law(phase) for phase, _, _ in parts))
        cheap = (
            speed
            for speed in list_cheap_speeds(motion)
            if all(speed.last <= first or speed.first >= last for first, last in (*given, *known))
        )
        speeds = (*list_frame_speeds(motion, motion.phases), *cheap)
        paces = tuple(
            Pace(
                parts[0][1],
                parts[-1][2],
                tuple(limit for phase, first, last in parts for limit in _list_speeds(phase, speeds, first, last)),
                parts[0][0].duration_s if len(parts) == 1 else None,
            )
            for parts in stretches
            if not all(_has_law(phase) for phase, _, _ in parts)
        )
        phases = zip(plan.phases, pairwise(borders), strict=True)
        settled = tuple(border for phase, border in phases if phase.kept is not None and phase.kept.is_settled)
        rests = tuple(parts[-1][2] for parts in stretches)
        return PlanTimer(plan, tuple(borders), rests, settings, paces, speeds, settled, given)

    def time(self, motion: Motion) -> Motion:
        """Return the motion with its time law, the ends of its curve fitted where the robot moves there.

        Where no law with the demanded rates exists, the law begins and ends at rest, which the certificate reports.

        Raises:
            TimingError: there is no law at all.
        """
        if motion.start_rates or motion.end_rates:
            try:
                return self._time_moving(motion)
            except TimingError:
                pass
        return replace(motion, law=self._slow(motion, self._time(motion, (0.0, 0.0))))

    def _time(self, motion: Motion, ends: tuple[float, float]) -> TimeLaw:
        """Return the fastest law of the curve, from one speed along the path to another."""
        carrying = [part.robot for part in split_motion(motion)]
        known = list(_place_laws(self.plan, self.borders))
        return time_curve(
            motion.robot, motion.curve, self.rests, self.settings, motion.phases, known, carrying, self.paces, ends
        )

    def _slow(self, motion: Motion, law: TimeLaw) -> TimeLaw:
        """Return the law, slowed until balance, torques, speeds of frames, grips and given durations hold."""
        settings = self.settings
        weak = replace(motion, law=law, robot=replace(motion.robot, effort=settings.torque_share * motion.robot.effort))
        law = slow_until_zmp_inside(weak, reserve_m=settings.zmp_reserve_m, settled=self.settled)
        law = slow_to_speeds(motion, law, self.speeds)
        law = slow_until_grips_hold(motion, law, [*self.settled, *self.given])
        return keep_durations(law, self.paces)

    def _time_moving(self, motion: Motion) -> Motion:
        """Return the motion with a law at whose ends the joints have the demanded rates.

        The slope of the curve at an end is the rate over the speed along the path.  A slower law needs steeper ends,
        with which the robot brakes over a longer way; each slowing is followed by a new fit.

        Raises:
            TimingError: no such law was found.
        """
        robot = scale_limits(motion.robot, self.settings)
        rates = np.stack([place_rates(motion.robot, given) for given in (motion.start_rates, motion.end_rates)])
        ends = _guess_speeds(motion.robot, rates)
        for _ in range(TRIES):
            fitted = replace(motion, curve=_fit_ends(motion.curve, rates, ends))
            try:
                law = self._slow(fitted, self._time(fitted, (float(ends[0]), float(ends[1]))))
            except TimingError:
                ends = SLOWER * ends
                continue
            for _ in range(ROUNDS):
                fitted = replace(motion, curve=_fit_ends(motion.curve, rates, law.speed[[0, -1]]), law=law)
                slower = self._slow(fitted, slow_to_limits(robot, fitted.curve, law))
                if slower.times[-1] <= law.times[-1] * (1.0 + SAME_DURATION):
                    return fitted
                law = stretch_law(slower, np.full(len(law.times) - 1, SPARE))
            ends = SLOWER * ends
        raise TimingError("no time law has the demanded rates at its ends")


def _guess_speeds(robot: RobotModel, rates: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, "2"]:
    """Return speeds along the path at which the ends are as steep as the rest of a curve; 0 at rest."""
    natural = np.where(np.isfinite(robot.velocity), robot.velocity, BASE_SPEED)
    return np.asarray((np.abs(rates) / natural).max(axis=1))


def _fit_ends(curve: Curve, rates: Float[np.ndarray, "2 n"], speeds: Float[np.ndarray, "2"]) -> Curve:
    """Return the curve with end slopes that give the rates at speeds along the path; resting ends stay."""
    tangents = np.array(curve.tangents)
    for end, rate, speed in zip((0, -1), rates, speeds, strict=True):
        if speed > 0.0:
            tangents[end] = rate / speed
    return replace(curve, tangents=tangents)


def _list_stretches(plan: TaskPlan, borders: Sequence[float]) -> list[Stretch]:
    """Return the phases between two rests, each with its path parameters."""
    stretches: list[Stretch] = []
    is_open = False
    for phase, (first, last) in zip(plan.phases, pairwise(borders), strict=True):
        if is_open:
            stretches[-1].append((phase, first, last))
        else:
            stretches.append([(phase, first, last)])
        is_open = phase.flows
    return stretches


def _list_ends(stretches: Iterable[Stretch]) -> tuple[tuple[float, float], ...]:
    return tuple((parts[0][1], parts[-1][2]) for parts in stretches)


def _has_law(phase: PlannedPhase) -> bool:
    return phase.kept is not None and phase.kept.law is not None


def _list_speeds(
    phase: PlannedPhase, speeds: Sequence[FrameSpeed], first: float, last: float
) -> tuple[FrameSpeed, ...]:
    """Return the largest speeds of frames during a phase: its own, and those that the motion promises."""
    own = (FrameSpeed(phase.name, frame, first, last, most) for frame, most in phase.limits)
    return (*own, *(speed for speed in speeds if speed.first < last and speed.last > first))


def _place_laws(plan: TaskPlan, borders: Sequence[float]) -> Iterator[TimeLaw]:
    """Yield the time laws that phases keep, with the path parameters of the whole curve."""
    for phase, first in zip(plan.phases, borders, strict=False):
        if phase.kept is not None and phase.kept.law is not None:
            law = phase.kept.law
            yield replace(law, path=(law.path - law.path[0]) + first)
