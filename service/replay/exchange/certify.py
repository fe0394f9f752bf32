"""Certificates for motions of other planners: a trajectory is held to a request, exactly as it is interpolated."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from costs.robot import RobotModel
from costs.stopping import never, poll, stops_when
from service.demands import Demands, Distances, hold_to_request
from service.errors import RequestError
from service.replay.exchange.interpolation import (
    READ_AS,
    SENTENCES,
    Interpolation,
    choose_interpolation,
    make_curve,
    make_even_law,
)
from service.replay.exchange.joint_trajectory import JointTrajectory
from service.replay.exchange.placing import Points, place_points
from service.replay.exchange.plausibility import find_other_start, note_model, note_start, note_times
from service.replay.exchange.start_state import StartState
from service.replay.rebuild import make_setup_demands
from service.request.schema import PlanRequest
from service.setup.prepare import PlanSetup, prepare
from service.verify import (
    Approach,
    Basis,
    Certificate,
    Check,
    Motion,
    Phase,
    Status,
    VerifyError,
    VerifySettings,
    Where,
    list_waived_checks,
    verify,
)

PHASE = "motion"
START_TOLERANCE = 1e-3  # of the first point from the request's start [rad, m]
REST_SPEED = 1e-3  # at both ends; other planners round to single precision [rad/s, m/s]
CORNERS = (
    "a controller that is given positions alone moves on lines with corners; give velocities, or certify the spline "
    "through the points (--interpolation spline) or the path alone (--untimed)"
)


@dataclass(frozen=True)
class CertifiedTrajectory:
    """Verdict on a trajectory of another planner.

    Attributes:
        request: what the trajectory is held to.
        motion: the trajectory as the verifier reads it.
        certificate: proof or refutation; its status is the verdict, its notes name the interpolation.
        interpolation: ``linear``, ``cubic``, ``quintic`` or ``spline``.
        failures: where it fails: time, links and pieces, millimetres; one sentence each.
        notes: assumptions about the trajectory.
        timings: seconds by step.
    """

    request: PlanRequest
    motion: Motion
    certificate: Certificate
    interpolation: str
    failures: tuple[str, ...]
    notes: tuple[str, ...]
    timings: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_certified(self) -> bool:
        """Whether every check holds, by proof where proofs exist."""
        return self.certificate.status is Status.CERTIFIED

    def __repr__(self) -> str:
        end = f": {self.failures[0]}" if self.failures else ""
        return f"<CertifiedTrajectory {self.certificate.status.value}, {self.interpolation}{end}>"


def certify(
    trajectory: JointTrajectory,
    request: PlanRequest,
    interpolation: Interpolation = "auto",
    *,
    timed: bool = True,
    robot: RobotModel | None = None,
    should_stop: Callable[[], bool] = never,
    on_step: Callable[[str], None] | None = None,
) -> CertifiedTrajectory:
    """Prove or refute that a trajectory of another planner answers a request.

    Robot, start, scene, goal, kept poses and planted feet come from the request.  Clearance of all pairs of links and
    pieces, joint limits, speeds and accelerations, planted feet, balance and the goal are proven on the whole curve;
    torques and ZMP at samples, as for a plan of our own.  Joints that the trajectory leaves out stay at the request's
    start.  Speeds and accelerations are held to the robot's own limits: the request's ``velocity_scale`` and
    ``acceleration_scale`` are aims of the planner.

    Args:
        trajectory: points, with derivatives where the planner gives them.
        request: a goal or a TrajOpt problem; tasks with phases of their own are refused.
        interpolation: how the robot's controller reads the points; ``auto`` takes quintics where accelerations are
            given, else cubics where velocities are, else lines, as ros2_control does.
        timed: whether times count; otherwise only the path is certified, and the certificate says so.
        robot: the request's robot if it is loaded already.
        should_stop: polled often; once it returns True, ``costs.stopping.Stopped`` is raised.
        on_step: called with the name of each step.

    Raises:
        RequestError: the request, or the trajectory for it, cannot be used: names, shapes, times, values.
    """
    announce = on_step or (lambda step: None)
    timings: dict[str, float] = {}
    started = time.perf_counter()
    with stops_when(should_stop):
        _refuse_tasks(request)
        timed = timed and request.options.timed
        request = replace(request, options=replace(request.options, timed=timed))
        setup = prepare(request, announce, robot, should_stop, checks_start=False, finds_package=True)
        poll()
        timings["prepare"] = time.perf_counter() - started
        announce("read trajectory")
        kind = choose_interpolation(trajectory, interpolation)
        points, notes = place_points(trajectory, setup.robot, setup.start, kind)
        notes += _list_doubts(trajectory, points, setup, timed=timed)
        motion = _make_motion(points, setup, kind, timed=timed, source=trajectory.source)
        announce("certificate")
        started = time.perf_counter()
        demands = make_setup_demands(setup)
        held = _hold(demands, motion)
        try:
            certificate = verify(held, VerifySettings(rest_speed=REST_SPEED))
        except VerifyError as error:
            raise RequestError(f"{trajectory.source}: {error}") from None
        certificate = _add_start(certificate, held, demands, trajectory.start)
        timings["certificate"] = time.perf_counter() - started
    sentence = f"{SENTENCES[kind]}; all checks are of this curve"
    kept = [note for note in certificate.notes if not note.startswith("the curve itself is certified")]
    certificate = replace(certificate, notes=(sentence, *kept))
    failures = list_failures(certificate, held)
    if kind == "linear" and any(check.name in ("limits.jump", "limits.rest") for check in certificate.failed()):
        notes += (CORNERS,)
    return CertifiedTrajectory(request, held, certificate, kind, failures, (*notes, *setup.notes), timings)


def list_failures(certificate: Certificate, motion: Motion) -> tuple[str, ...]:
    """Return where a motion fails: each sentence of a check that does not hold, with its time and place."""
    checks = certificate.failed() or tuple(c for c in certificate.checks if c.basis is Basis.UNPROVEN)
    return tuple(_locate(check, motion) for check in checks)


def to_json(outcome: CertifiedTrajectory) -> dict[str, Any]:
    """Return what ``scopt certify --json`` prints: verdict, failures, interpolation, checks and coverage."""
    from service.result.result_json import proof_summary

    certificate, law = outcome.certificate, outcome.motion.law
    return {
        "verdict": certificate.status.value,
        "explanation": list(outcome.failures),
        "interpolation": outcome.interpolation,
        "held_to": f"read as {READ_AS[outcome.interpolation]}",
        "notes": [*certificate.notes, *outcome.notes],
        "duration_s": None if law is None else float(law.times[-1] - law.times[0]),
        "timings": dict(outcome.timings),
        **proof_summary(certificate),
    }


def _refuse_tasks(request: PlanRequest) -> None:
    if not request.section.takes_trajectories:
        raise RequestError(
            f"{request.kind.field}: its phases are made by the planner; a trajectory is certified for a goal or "
            "task.trajopt"
        )
    if request.resume is not None:
        raise RequestError("resume: a trajectory is certified as a whole; leave it out")


def _make_motion(points: Points, setup: PlanSetup, kind: str, *, timed: bool, source: str) -> Motion:
    """Return the motion with a single phase, without promises.

    Raises:
        RequestError: a timed motion is wanted, and there are no times.
    """
    times = points.times
    if timed and times is None:
        raise RequestError(f"{source}: has no times, or all are 0; --untimed (or timed=False) certifies the path alone")
    is_by_time = times is not None and kind != "linear"  # derivatives are by time, also where only the path counts
    if times is None and kind in ("cubic", "quintic"):
        raise RequestError(f"{source}: has velocities and no times; {kind} needs both")
    s = times if times is not None and (timed or is_by_time) else np.arange(float(len(points.positions)))
    distances = Distances.of(setup.request.options, setup.scene)
    curve = make_curve(s, points.positions, points.velocities, points.accelerations, kind)
    return Motion(
        robot=setup.robot,
        scene=setup.scene,
        curve=curve,
        law=make_even_law(s) if timed else None,
        phases=(Phase(PHASE, float(s[0]), float(s[-1])),),
        waived=list_waived_checks(is_timed=timed, is_balanced=setup.robot.can_balance),
        clearance_m=distances.clearance_m,
        sway=distances.sway,
        padding=distances.padding,
        jerk_scale=setup.request.options.jerk_scale,
        tool_speed_m_s=setup.request.options.tool_speed_m_s,
        pace=setup.request.options.pace,
        approach=Approach.of(setup.request.hand_servo),
        start_rates=setup.request.end_rates[0],
        end_rates=setup.request.end_rates[1],
    )


def _list_doubts(trajectory: JointTrajectory, points: Points, setup: PlanSetup, *, timed: bool) -> tuple[str, ...]:
    """Return notes on times, robot and start that are perhaps not what the planner meant."""
    robot, attached = setup.robot, [body.name for body in setup.request.attached]
    notes = [*note_model(trajectory.model_id, robot), *note_start(trajectory.start, robot, attached)]
    if timed and points.times is not None:
        notes += note_times(points.times, points.positions, robot.velocity)
    return tuple(notes)


def _hold(demands: Demands, motion: Motion) -> Motion:
    """Return the motion with the request's promises.

    Raises:
        RequestError: no point of the trajectory does what a step of a TrajOpt problem demands.
    """
    held = hold_to_request(demands, motion)
    missed = [line for line in held.differences if line.startswith("no waypoint does")]
    if missed:
        raise RequestError(missed)
    return held.motion


def _add_start(
    certificate: Certificate,
    motion: Motion,
    demands: Demands,
    state: StartState | None,
) -> Certificate:
    """Return the certificate with checks of the first point and of the planner's own start against the request's start.

    A TrajOpt problem adds those of its fixed joints.
    """
    q, start, robot = motion.curve.positions, demands.world.start, demands.robot
    off = np.abs(q[0] - start)
    worst = int(off.argmax())
    name, s = robot.joint_names[worst], float(motion.curve.knots[0])
    value = float(off[worst])
    is_ok = value <= START_TOLERANCE
    text = f"the first point is within {value:.2g} rad of the request's start"
    if not is_ok:
        text = f"{name} starts at {q[0, worst]:.4f}, the request's start has {start[worst]:.4f}"
    where = Where(s, None if motion.law is None else s, None, (name,))
    checks = [Check("start", is_ok, value, START_TOLERANCE, "rad", text, where, Basis.PROOF)]
    other = find_other_start(state, robot, start, START_TOLERANCE)
    if other is not None:
        checks.append(Check("start.state", False, other[1], START_TOLERANCE, "rad", other[0], where, Basis.PROOF))
    strays = demands.task.find_strays(demands.world, q)
    checks += [Check("start.fixed", False, 1.0, 0.0, "1", line, where, Basis.PROOF) for line in strays]
    is_violated = any(not check.ok for check in checks)
    status = Status.VIOLATED if is_violated else certificate.status
    return replace(certificate, status=status, checks=(*checks, *certificate.checks))


def _locate(check: Check, motion: Motion) -> str:
    """Return a check's sentence with its time, or its place on the path, and the points that it lies between."""
    if check.where is None:
        return check.text
    knots = motion.curve.knots
    row = int(np.clip(np.searchsorted(knots, check.where.s, side="right") - 1, 0, len(knots) - 2))
    at = f"after point {row}" if check.where.time_s is None else f"at {check.where.time_s:.3f} s, after point {row}"
    return f"{check.text} ({at})"
