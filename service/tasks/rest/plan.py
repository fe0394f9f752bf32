"""Plan the rest of a task from one of its phases on, with the robot and the mechanism as they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from costs.kinematics import locate_links
from service.body.phases import PhaseSolver
from service.body.task_plan import PlannedPhase, Stuck, TaskPlan
from service.body.whole_body import WholeBody
from service.demands.phase import AXIS, FrameMotion, TaskPhase
from service.demands.rest.displacement import measure_displacement
from service.demands.rest.earlier_motion import EarlierMotion, read_earlier_motion
from service.demands.rest.phases import TAKE_HOLD, Beginning, RestTask, can_reach, find_index, list_rest_phases
from service.errors import RequestError
from service.request.resume import ResumeRequest
from service.tasks.handling import find_collisions
from service.tasks.hints import Hints, PhaseHints
from service.tasks.rest.compliance import MOST_M, MOST_RAD, CannotFollowError, keep_motion
from service.tasks.sequence import PhaseSequence

AT_PLACE = 5e-4  # of a hand that needs no phase that takes hold [m]
MOST_OF_LINE = 0.9  # of a line on which the hand leaves, that it may have behind it
TAKE_WAYPOINTS = 4  # of a phase that takes hold
N_RANDOM = 4  # configurations from which a pose is searched where the robot's postures lead to none
NEAR, NEAR_TILT = 0.015, np.deg2rad(5.0)  # of a hand that takes hold again [m], and beyond its lean [rad]


@dataclass(frozen=True)
class HandOff:
    """How far a hand is from its place.

    Attributes:
        distance: of the tool from its place, or from where it may slide to [m].
        tilt: angle beyond the lean that the hand may have [rad].
    """

    distance: float
    tilt: float

    @property
    def is_at_place(self) -> bool:
        """Whether the phase can begin as it is."""
        return self.distance <= AT_PLACE and self.tilt <= 0.0

    @property
    def is_near(self) -> bool:
        """Whether a short phase takes hold again."""
        return self.distance <= NEAR and self.tilt <= NEAR_TILT


def plan_rest(
    solver: PhaseSolver,
    demand: RestTask,
    specs: Sequence[TaskPhase],
    resume: ResumeRequest,
    hints: Hints,
) -> Iterator[TaskPlan]:
    """Yield plans of the rest of a task from the nominal configuration of the body.

    The first is the earlier motion itself, with the arm displaced that holds the mechanism, where that is enough.

    Args:
        solver: of the body augmented by the mechanism, whose joints are at their start.
        demand: what the rest of the task demands.
        specs: phases of the whole task, as the planner has them.
        resume: the request for the rest, with the earlier motion.
        hints: how to go about each phase.

    Raises:
        RequestError: the hand is nowhere near a place that it has to leave or to hold on to, or the start is in
            collision.
    """
    body, start = solver.body, demand.mechanism.start
    index = find_index(specs, demand.phase)
    begun = _shorten_line(body, specs[index])
    earlier = read_earlier_motion(body.robot, resume.nominal, body.nominal)
    beginnings = list(_choose_beginnings(body, specs, index, begun.hand))
    problems = tuple(find_collisions(body, () if beginnings[0] is Beginning.REACH else begun.touches))
    if problems:
        raise RequestError(problems)
    kept, refusal = _keep_earlier(solver, demand, specs, resume, earlier)
    if kept is not None:
        yield kept
    best: tuple[tuple[PlannedPhase, ...], Stuck | None] = ((), None)
    for beginning in beginnings:
        is_reach = beginning is Beginning.REACH
        whole = specs if is_reach else [*specs[:index], begun, *specs[index + 1 :]]
        rest = list_rest_phases(whole, demand.phase, start, beginning)
        is_held = begun.hand is not None and not is_reach
        sequence = PhaseSequence.of(
            solver,
            demand.mechanism,
            rest,
            is_held=is_held,
            n_random=N_RANDOM,
            earlier=earlier,
            hints=partial(_hint_rest, hints),
        )
        planned = sequence.plan(body.nominal)
        if planned[1] is None:
            note = f"planned again from '{demand.phase}' on"
            yield TaskPlan(body, planned[0], measure=demand.measure, notes=(*refusal, note))
            return
        if len(planned[0]) >= len(best[0]):
            best = planned
    yield TaskPlan(body, best[0], stuck=best[1], measure=demand.measure, notes=refusal)


def _hint_rest(hints: Hints, phase: TaskPhase) -> PhaseHints:
    """Return the hints of a phase of the rest; the hand that takes hold is near its place already."""
    own = hints(phase)
    return replace(own, free_waypoints=TAKE_WAYPOINTS) if phase.name == TAKE_HOLD else own


def _keep_earlier(
    solver: PhaseSolver,
    demand: RestTask,
    specs: Sequence[TaskPhase],
    resume: ResumeRequest,
    earlier: EarlierMotion,
) -> tuple[TaskPlan | None, tuple[str, ...]]:
    """Return the earlier motion with the arm displaced that holds, or None; and what a plan made anew has to say of it.

    Without ``resume.is_compliant`` the arm may be anywhere, and a new plan says nothing of it.
    """
    if resume.nominal is None or not resume.nominal.has_curve:
        return None, ()
    rest = list_rest_phases(specs, demand.phase, demand.mechanism.start, Beginning.AT_ONCE)
    try:
        kept, off = keep_motion(PhaseSequence.of(solver, demand.mechanism, rest), earlier)
    except CannotFollowError as error:
        return None, (f"the earlier motion is not kept: {error}",) if resume.is_compliant else ()
    if resume.is_compliant and off.is_compliance:
        note = f"the earlier motion is kept: {off}"
        refusal = "the earlier motion is not kept: its certificate fails where only the arm yields"
        nominal = resume.nominal
        measure = lambda motion: {**demand.measure(motion), **measure_displacement(motion, rest, nominal)}  # noqa: E731
        return replace(kept, measure=measure, notes=(note,)), (refusal,)
    most = f"{1e3 * MOST_M:.0f} mm and {np.rad2deg(MOST_RAD):.0f} deg"
    refusals = (f"the earlier motion is not kept: {off}; expected at most {most}",) if resume.is_compliant else ()
    note = f"the earlier motion with an arm elsewhere: {off}"
    return replace(kept, measure=demand.measure, notes=(*refusals, note)), refusals


def _choose_beginnings(
    body: WholeBody, specs: Sequence[TaskPhase], index: int, hand: FrameMotion | None
) -> Iterator[Beginning]:
    """Yield the ways to begin with a phase that are to be tried, by where the hand is.

    Args:
        body: at its start.
        specs: phases of the whole task.
        index: of the phase.
        hand: its motion, from where on a line it is.

    Raises:
        RequestError: there is none.
    """
    if hand is None:
        yield Beginning.AT_ONCE
        return
    reaches = can_reach(specs, index)
    off = measure_hand(body, _first_place(hand))
    if off.is_near:
        if hand.is_line or off.is_at_place:
            yield Beginning.AT_ONCE
        if not hand.is_line:
            yield Beginning.TAKE_HOLD
        elif reaches:
            yield Beginning.REACH
        return
    if not reaches:
        raise RequestError(
            f"resume.phase: {hand.tool} is {off.distance:.3f} m from its place in '{specs[index].name}', and at most "
            f"{NEAR:g} m can be planned from; expected an earlier phase, or the hand at its place"
        )
    yield Beginning.REACH


def _shorten_line(body: WholeBody, spec: TaskPhase) -> TaskPhase:
    """Return a phase in which the hand moves on a line, from where on the line the hand is."""
    hand = spec.hand
    if hand is None or hand.offset is None:
        return spec
    share = float(_locate_tool(body, hand) @ hand.offset / (hand.offset @ hand.offset))
    if hand.leaves:
        share = float(np.clip(share, 0.0, MOST_OF_LINE))
        left = replace(hand, place=hand.place + share * hand.offset, offset=(1.0 - share) * hand.offset)
        return spec.with_hand(left)
    share = float(np.clip(share, 1.0 - MOST_OF_LINE, 1.0))
    return spec.with_hand(replace(hand, offset=share * hand.offset))


def _first_place(hand: FrameMotion) -> FrameMotion:
    """Return the hand at rest where its motion begins."""
    if hand.offset is None or hand.leaves:
        return replace(hand, offset=None)
    return replace(hand, place=hand.place + hand.offset, offset=None)


def _locate_tool(body: WholeBody, hand: FrameMotion) -> Float[np.ndarray, "3"]:
    """Return the tool's offset from its place in the nominal configuration, in the axes of the place's link [m]."""
    poses = locate_links(body.engine, body.nominal, [name for name in (hand.tool, hand.link) if name is not None])
    link = np.eye(4) if hand.link is None else poses[hand.link]
    return np.asarray(link[:3, :3].T @ (poses[hand.tool][:3, 3] - link[:3, 3]) - hand.place)


def measure_hand(body: WholeBody, hand: FrameMotion) -> HandOff:
    """Measure how far a hand is from its place in the nominal configuration."""
    off = _locate_tool(body, hand)
    if hand.slide is not None:
        share = np.clip(off @ hand.slide / (hand.slide @ hand.slide), -1.0, 1.0)
        off = off - share * hand.slide
    poses = locate_links(body.engine, body.nominal, [name for name in (hand.tool, hand.turns_with) if name is not None])
    wanted = hand.axis if hand.turns_with is None else poses[hand.turns_with][:3, :3] @ hand.axis
    lean = float(np.arccos(np.clip(poses[hand.tool][:3, :3] @ AXIS @ wanted, -1.0, 1.0)))
    return HandOff(float(np.linalg.norm(off)), max(lean - hand.tilt_rad, 0.0))
