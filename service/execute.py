"""From a task's phases to the motion that is executed: spline, time law, samples, and its certificate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from costs.curve import TimeLaw
from costs.state import MotionState
from costs.terms import FramePose
from scopt import Residual
from service.phases import PlannedPhase, TaskPlan
from service.spline import Hold, Path, Spline, make_spline
from service.timing import TimingSettings, slow_until_zmp_inside, time_curve
from service.verify import Motion, Phase, PlantedContact, SupportPolygon
from service.verify.timeline import time_of
from service.whole_body import PlantedLink, WholeBody

SAMPLE_PERIOD_S = 0.01
ZMP_RESERVE = 0.015  # how far inside the feet the motion is slowed to keep the ZMP [m]
BASE_SPEED = 0.5  # natural speed of a coordinate without a velocity limit [m/s, rad/s]


def make_motion(plan: TaskPlan, velocity_scale: float, acceleration_scale: float) -> Motion:
    """The timed and sampled motion of a task's phases.

    Args:
        plan: at least one phase.
        velocity_scale, acceleration_scale: share of the robot's limits that is used.
    """
    body = plan.body
    spline = _spline(body, plan.phases)
    knots = spline.curve.knots
    borders = [float(knots[end]) for end in spline.ends]
    timing = TimingSettings(velocity_scale, acceleration_scale, support_links=tuple(foot.link for foot in body.planted))
    law = time_curve(body.robot, spline.curve, borders, timing)
    phases = tuple(
        _phase(body, phase, first, last)
        for phase, first, last in zip(plan.phases, borders[:-1], borders[1:], strict=True)
    )
    motion = Motion(
        robot=body.robot,
        scene=body.scene,
        curve=spline.curve,
        law=law,
        phases=phases,
        mechanism_links=body.robot.mechanism_links,
    )
    law = slow_until_zmp_inside(motion, reserve_m=ZMP_RESERVE)
    return replace(motion, law=law, samples=_samples(knots, law))


def _spline(body: WholeBody, phases: Sequence[PlannedPhase]) -> Spline:
    robot = body.robot
    planted = tuple(_planted(body, foot) for foot in body.planted)
    paths = [Path(phase.name, phase.q, (*planted, *phase.holds)) for phase in phases]
    speed = np.where(np.isfinite(robot.velocity), robot.velocity, BASE_SPEED)
    return make_spline(body.engine, paths, robot.lower, robot.upper, speed)


def _planted(body: WholeBody, foot: PlantedLink) -> Hold:
    def hold(waypoints: Int[np.ndarray, "S"]) -> Residual[MotionState]:
        return FramePose(body.robot, foot.link, waypoints, foot.pose_world_link)

    return hold


def _phase(body: WholeBody, phase: PlannedPhase, first: float, last: float) -> Phase:
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
        targets=phase.targets(last),
        support=support,
    )


def _samples(knots: Float[np.ndarray, "K"], law: TimeLaw) -> Float[np.ndarray, "M"]:
    """Path parameters of the exported samples: all knots, and between them at least one every sample period."""
    times = np.array([time_of(law, float(knot)) for knot in knots])
    samples = [knots[:1]]
    for first, last, s_last in zip(times[:-1], times[1:], knots[1:], strict=True):
        count = max(int(np.ceil((last - first) / SAMPLE_PERIOD_S)), 1)
        inner = law.at(np.linspace(first, last, count + 1)[1:-1])[0]
        samples += [inner, np.array([s_last])]
    return np.unique(np.concatenate(samples))
