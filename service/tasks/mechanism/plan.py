"""Plan to move a mechanism that a request gives by its URDF, with the hands that it permits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.allowance import BodyRef
from costs.kinematics import locate_links
from costs.robot import Mechanism, RobotError
from costs.robot.contact_patches import measure_surface_distance
from costs.static_region import StaticRegionError
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.hands import Hand
from service.demands.holds.leaving import LET_GO
from service.demands.holds.pushes import explain_refusal
from service.demands.mechanism.demand import GivenMechanismDemand, make_mechanism_rest, read_kept_hand
from service.demands.mechanism.given import GivenMechanism, read_given_mechanism
from service.demands.mechanism.phases import (
    list_opposite_places,
    make_mechanism_phases,
    measure_ahead,
    select_tool,
    turn_fingers,
)
from service.demands.mechanism.settling import keep_aside, settle_handle
from service.demands.mechanism.tips import list_pushing_hands
from service.demands.phase import TaskPhase, find_rotation_onto
from service.errors import RequestError
from service.request.resume import ResumeRequest
from service.request.tasks.mechanism import MechanismRequest
from service.setup.prepare import PlanSetup
from service.tasks.door.sweep import find_first_met
from service.tasks.handling import FARTHER, find_collisions, sort_hands
from service.tasks.hints import FREE_WAYPOINTS, Hints, PhaseHints
from service.tasks.rest.plan import plan_rest
from service.tasks.sequence import PhaseSequence, add_mechanism

HANDLE_MARGIN = 4e-3  # between a hand and the mechanism that it holds [m]
MOST_GAP, MOST_INSIDE = 0.010, 0.004  # between the hand's rod and what it holds [m]
SWEEP_SLIDE, SWEEP_TURN = 5e-3, float(np.deg2rad(1.0))  # between the values at which it is looked for pieces [m, rad]
ROD_POINTS = 41  # along the rod, for its distance


def plan_mechanism(setup: PlanSetup, solver: PhaseSolver, request: MechanismRequest) -> Iterator[TaskPlan]:
    """Yield a plan per permitted hand, the nearest to the handle first; one without a solution only as the last.

    Raises:
        RequestError: the robot has no such hand, or is in collision with the mechanism at the start.
        StaticRegionError: whatever the hand, the ground does not hold the robot under the loads.
    """
    given = read_given_mechanism(request)
    hands = choose_hands(solver.body, given)
    if setup.request.resume is not None:
        yield from _plan_rest(setup, solver, given, setup.request.resume)
        return
    try:
        solver = add_mechanism(solver, given.mechanism)
    except RobotError as error:
        raise RequestError(f"task.mechanism.urdf: {error}") from None
    solver = replace(solver, overrides=list_clearances(hands, given))
    collisions = tuple(find_collisions(solver.body, remedy=FARTHER))
    if collisions:
        raise RequestError(collisions)
    check_hold(solver, hands, given)
    blocked = find_blocked_move(solver.body, given)
    if blocked is not None:
        yield blocked
        return
    hints = make_mechanism_hints(setup.request.options.waypoints)
    refusals = [explain_hold(solver, given, hand) for hand in hands]
    if all(refusals):
        yield TaskPlan(solver.body, (), (str(refusals[0]),), is_impossible=True)
        return
    demand = GivenMechanismDemand(given, setup.robot, solver.hand_friction)
    unsolved: TaskPlan | None = None
    unheld: StaticRegionError | None = None
    for hand in [hand for hand, refusal in zip(hands, refusals, strict=True) if refusal is None]:
        settled = settle_handle(given, solver.body.robot, hand, solver.hand_friction)
        specs = make_mechanism_phases(settled, hand)
        left = specs[-1]
        specs = keep_aside(specs, solver.body.robot, given.mechanism, solver.hand_friction)
        try:
            phases, stuck = PhaseSequence.of(solver, given.mechanism, specs, hints=hints).plan(solver.body.nominal)
        except StaticRegionError as error:
            unheld = error
            continue
        notes = (f"{hand.side} hand at {request.handle.link}",)
        plan = TaskPlan(solver.body, phases, stuck=stuck, measure=demand.measure, notes=notes)
        lines = (specs[-1],) if specs[-2].name == LET_GO else (left, specs[-1])
        plan = _leave_anyhow(solver, plan, lines, given.mechanism)
        if plan.stuck is None:
            yield plan
        elif unsolved is None or len(phases) > len(unsolved.phases):
            unsolved = plan
    if unsolved is not None:
        yield unsolved
    elif unheld is not None:
        raise unheld


def make_mechanism_hints(free_waypoints: int | None) -> Hints:
    """Return the hints of the phases of a given mechanism: its moves are tried straight to a pose at their end."""

    def hint(phase: TaskPhase) -> PhaseHints:
        return PhaseHints("pose at the handle", free_waypoints or FREE_WAYPOINTS, aims_at_end=bool(phase.moving))

    return hint


def _plan_rest(
    setup: PlanSetup, solver: PhaseSolver, given: GivenMechanism, resume: ResumeRequest
) -> Iterator[TaskPlan]:
    """Yield plans of the rest of a task with the hand of the earlier plan.

    Raises:
        RequestError: the phase, the hand or the mechanism's joints do not fit the task.
    """
    demand = GivenMechanismDemand(given, setup.robot, solver.hand_friction)
    hints = make_mechanism_hints(setup.request.options.waypoints)
    rest, hand = make_mechanism_rest(demand, resume), read_kept_hand(demand, resume)
    solver = replace(add_mechanism(solver, rest.mechanism), overrides=list_clearances((hand,), given))
    for plan in plan_rest(solver, rest, rest.specs, resume, hints):
        yield _leave_anyhow(solver, plan, (rest.specs[-1],), rest.mechanism)


def _leave_anyhow(solver: PhaseSolver, plan: TaskPlan, lasts: Sequence[TaskPhase], mechanism: Mechanism) -> TaskPlan:
    """Return a plan whose hand cannot leave on its line with another line instead: those given, then along its rod."""
    last = lasts[-1]
    if plan.stuck is None or plan.stuck.step != last.name or last.hand is None or not last.hand.leaves:
        return plan
    at = plan.phases[-2].q[-1] if len(plan.phases) > 1 else solver.body.nominal
    values = at[-len(mechanism.joints) :]
    held = [replace(spec, first=values, last=values) for spec in lasts]
    for line in (*held[:-1], leave_along_rod(solver, held[0], at)):
        left, stuck = PhaseSequence(solver, mechanism, (line,), is_held=True).plan(at)
        if stuck is None:
            break
    return replace(plan, phases=(*plan.phases[:-1], *left), stuck=stuck)


def choose_hands(body: WholeBody, given: GivenMechanism) -> tuple[Hand, ...]:
    """Return the hands to try, the nearest to the handle first.

    Raises:
        RequestError: the robot has no such hand.
    """
    pose = given.locate(given.handle.joint, given.mechanism.start)
    at = pose[:3, :3] @ given.handle.place + pose[:3, 3]
    hands = sort_hands(body, tuple(list_pushing_hands(body.robot, given)), at)
    if not hands:
        side = {"auto": ""}.get(given.request.hand, f"{given.request.hand} ")
        raise RequestError(
            f"task.mechanism.hand: robot '{body.robot.name}' has no {side}hand with a rod, by which parts are pushed "
            "(frames tool, peg and stub), nor one with two fingers that slide and close; robot.hand: hook or gripper "
            "gives the bundled robot such hands, robot.hands names those of another robot"
        )
    return hands


def check_hold(solver: PhaseSolver, hands: Sequence[Hand], given: GivenMechanism) -> None:
    """Refuse a place at which the hand's rod, or its fingers' ends, do not touch what it holds, or is deep inside.

    Raises:
        RequestError: one line with the distance, or with the way along which closed fingers have no side.
    """
    handle, robot = given.handle, solver.body.robot
    bodies = [body for body in robot.bodies if body.name in handle.bodies]
    field, link = "task.mechanism.handle", given.request.handle.link
    if not bodies:
        raise RequestError(f"{field}.link: {link} has no <collision>; expected a link that the hand can touch")
    for hand in hands:
        turn_fingers(given, hand)
        gap, is_tip = float("inf"), given.request.handle.tool == "tip"
        if not hand.closed or not is_tip:
            rod = _list_rod(solver, given, hand)
            if is_tip:  # the rod ends flat
                rod = rod[np.linalg.norm(rod - handle.place, axis=1) >= hand.peg_radius]
            gap = min(measure_surface_distance(body, point) for body in bodies for point in rod) - hand.peg_radius
        if is_tip:
            gap = min(gap, *(measure_surface_distance(body, handle.place) for body in bodies))
        if not -MOST_INSIDE <= gap <= MOST_GAP:
            where = f"{1e3 * abs(gap):.0f} mm {'away from' if gap > 0.0 else 'inside'} {link}"
            surface = _name_surface(hand, is_tip=is_tip)
            raise RequestError(
                f"{field}.place: {surface} would be {where}; "
                f"expected at most {1e3 * MOST_GAP:g} mm away and {1e3 * MOST_INSIDE:g} mm inside"
            )


def _name_surface(hand: Hand, *, is_tip: bool) -> str:
    if hand.closed:
        return f"the {'ends' if is_tip else 'sides'} of the {hand.side} hand's closed fingers"
    return f"the {hand.side} hand's rod of {1e3 * hand.peg_radius:g} mm radius"


def _list_rod(solver: PhaseSolver, given: GivenMechanism, hand: Hand) -> Float[np.ndarray, "P 3"]:
    """Return points along the middle of a hand's rod, or closed fingers, at the handle, in the handle's link [m]."""
    tool, place, axis = select_tool(given, hand), given.handle.place, given.handle.axis
    if hand.closed:
        ahead = measure_ahead(given, hand)
        return np.asarray(place + np.linspace(hand.palm_m - ahead, hand.tip_m - ahead, ROD_POINTS)[:, None] * axis)
    poses = locate_links(solver.body.engine, solver.body.nominal, [tool, hand.stub, hand.tool])
    origin = poses[tool][:3, 3]
    first, last = ((poses[frame][:3, 3] - origin) @ poses[tool][:3, 2] for frame in (hand.stub, hand.tool))
    return np.asarray(place + np.linspace(first, last, ROD_POINTS)[:, None] * axis)


def explain_hold(solver: PhaseSolver, given: GivenMechanism, hand: Hand) -> str | None:
    """Return why a hand at the handle cannot push the mechanism, with a side that can if there is one; None if it can.

    Args:
        solver: of the robot augmented by the mechanism.
    """
    robot, friction = solver.body.robot, solver.hand_friction
    refusal = explain_refusal(make_mechanism_phases(given, hand), robot, given.mechanism, friction)
    if refusal is None:
        return None
    for place in list_opposite_places(given):
        turned = replace(given, handle=replace(given.handle, place=place))
        if explain_refusal(make_mechanism_phases(turned, hand), robot, given.mechanism, friction) is None:
            link = given.read.links[given.request.handle.link].pose
            own = np.round((place - link[:3, 3]) @ link[:3, :3], 4) + 0.0
            return f"{refusal}; a hand at handle.place {own.tolist()} could push it"
    return f"{refusal}; a hand on the opposite side could not push it either"


def find_blocked_move(body: WholeBody, given: GivenMechanism) -> TaskPlan | None:
    """Return the plan that says which piece or planted link the mechanism meets on its way; None if it meets none.

    Args:
        body: augmented by the mechanism, at the start.
    """
    values, names = given.mechanism.start, [joint.name for joint in given.mechanism.joints]
    for move in given.request.moves:
        column, joint = names.index(move.joint), given.mechanism.joint(move.joint)
        step = SWEEP_SLIDE if joint.kind == "prismatic" else SWEEP_TURN
        count = int(np.ceil(abs(move.to - values[column]) / step)) + 1
        way = np.linspace(values[column], move.to, count)[1:]
        q = np.tile(body.nominal, (len(way), 1))
        q[:, -len(names) :] = values
        q[:, q.shape[1] - len(names) + column] = way
        met = next((met for met in find_first_met(body, q, way) if met.stands_still), None)
        if met is not None:
            unit = "m" if joint.kind == "prismatic" else "rad"
            remedy = "" if met.is_piece else FARTHER
            words = f"{met.part} meets {met.name} with {move.joint} at {met.angle:.3f} {unit} of {move.to:g}{remedy}"
            return TaskPlan(body, (), (words,), is_impossible=met.is_piece)
        values = np.where(np.arange(len(names)) == column, move.to, values)
    return None


def leave_along_rod(solver: PhaseSolver, spec: TaskPhase, at: Float[np.ndarray, "n"]) -> TaskPhase:
    """Return the line on which a hand leaves, turned along its rod as it leans at configuration ``at``.

    A rod that leans would meet what it holds on its way along the handle's axis.
    """
    hand = spec.hand
    if hand is None or hand.offset is None or hand.link is None:
        return spec
    poses = locate_links(solver.body.engine, at, [hand.tool, hand.link])
    axis = poses[hand.link][:3, :3].T @ poses[hand.tool][:3, 2]
    turn = find_rotation_onto(hand.axis, axis / np.linalg.norm(axis))
    return spec.with_hand(replace(hand, axis=turn @ hand.axis, offset=turn @ hand.offset))


def list_clearances(hands: tuple[Hand, ...], given: GivenMechanism) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
    """Return the required clearances between hands and the mechanism [m]."""
    return tuple(
        (BodyRef.of_link(link), BodyRef("mechanism", joint.link), HANDLE_MARGIN)
        for hand in hands
        for link in hand.pushing_links
        for joint in given.mechanism.joints
    )
