"""Plan a valve request: wheel and hands to try, the turn, and advice where to stand if the rim is out of reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float

from costs.allowance import BodyRef
from costs.kinematics import locate_links
from costs.robot import Mechanism
from costs.scene import Scene
from costs.terms import AxisDirection, FramePose, WithinTolerance
from perception import LeverDetection, ValveDetection, has_clear_spokes
from scopt import Constraint, Sense
from service.body.effort import Effort
from service.body.holds import POSITION
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.hands import Hand, list_robot_hands
from service.demands.phase import AXIS
from service.demands.valve.demand import ValveDemand, make_valve_rest, read_kept_choice, turn_back
from service.demands.valve.given import read_given_valve
from service.demands.valve.strokes import (
    PROBE,
    ROCK,
    STUCK_FACTOR,
    TurnChoice,
    find_fault,
    find_least_count,
    find_pressed_part,
    list_strokes,
    list_usable_entries,
)
from service.demands.valve.wheel import ROOMS, Wheel, find_stops, make_wheel, make_wheel_mechanism
from service.errors import RequestError
from service.explain.distance import find_out_of_reach
from service.request.resume import ResumeRequest
from service.request.tasks.valve import VALVE_LINK, ValveRequest
from service.setup.prepare import PlanSetup
from service.tasks.handling import FARTHER, find_collisions, list_hands
from service.tasks.rest.plan import plan_rest
from service.tasks.sequence import add_mechanism
from service.tasks.valve.turn import ValveTurn, measure_wrist
from service.verify import is_shown

SURE = 0.5  # least confidence of a detection that is used
HOOK_MARGIN = 5e-3  # between the hand and the wheel it reaches into [m]
LEAST_PEG = 0.06  # length of the free peg that reaches through a wheel [m]
MOST_PLANS = 4  # that are made into motions
MORE_STROKES = (1, 2, 3)  # times the least number of strokes, tried in turn
MOST_RETRIED = 4  # choices that are tried with more poses
MOST_ENTRIES = 3  # tried with each hand, the nearest first
N_RANDOM = 4  # configurations from which the first pose at a wheel is searched where the robot's postures lead to none
SHIFTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)  # of the pelvis [m]
ANGLES = np.deg2rad([0.0, 120.0, 240.0])  # of the rim that must be in reach after a shift
# A solvable shift takes few steps.
ADVICE_AXIS_AIM = np.deg2rad(1.5)


def plan_valve(setup: PlanSetup, solver: PhaseSolver, request: ValveRequest) -> Iterator[TaskPlan]:
    """Yield plans to turn the request's valve, detected in the scan or given by centre, axis and radius.

    Each further plan makes other choices; where none is feasible, the one with most phases comes with advice.
    """
    valve = find_valve(setup, request)
    if isinstance(valve, str):
        yield TaskPlan(solver.body, (), (valve,))
        return
    valve = turn_back(valve, setup.request.resume)
    refused = refuse_lever(valve, request)
    if refused is not None:
        yield TaskPlan(solver.body, (), (refused,))
        return
    hands = choose_hands(solver.body, request, valve)
    is_shown = read_given_valve(request) is None and request.moved_m is None
    seen = setup.surroundings.seen if is_shown else None
    wheel = make_wheel(valve, request, seen)
    reasons = [find_out_of_reach(solver.body, hand.tool, valve.centre, valve.rim_radius) for hand in hands]
    if all(reasons):
        yield TaskPlan(solver.body, (), tuple(reason for reason in reasons if reason), is_impossible=True)
        return
    fault = find_no_entry(wheel, hands[0], request)
    if fault is not None:
        yield TaskPlan(solver.body, (), (fault,))
        return
    waypoints = setup.request.options.waypoints
    if setup.request.resume is not None:
        yield from _plan_rest(solver, wheel, request, setup.request.resume, waypoints)
        return
    notes = describe_valve(valve, wheel, request)
    for plan in _list_turns(solver, wheel, hands, request, waypoints):
        advice = () if plan.is_feasible else (_advise_stance(solver, wheel, hands[0]),)
        yield replace(plan, obstacle=(*plan.obstacle, *advice), notes=(*notes, *plan.notes))


def describe_valve(valve: ValveDetection | LeverDetection, wheel: Wheel, request: ValveRequest) -> tuple[str, ...]:
    """Return sentences about the wheel, what is assumed of it, and what the options add to the turn."""
    place = f"at {np.round(valve.centre, 3).tolist()}, axis {np.round(valve.axis, 3).tolist()}"
    notes: list[str]
    if isinstance(valve, LeverDetection):
        notes = [f"{describe_lever(valve)} {place}, confidence {valve.confidence:.2f}"]
        if wheel.stops is not None:
            low, high = np.rad2deg(wheel.stops) + 0.0
            source = "assumed to stop" if request.stops_deg is None else "stops"
            notes.append(
                f"the lever is {source} {abs(low):.0f} deg clockwise and {high:.0f} deg counter-clockwise from here"
            )
    else:
        notes = [f"valve {place}, rim radius {valve.rim_radius:.3f} m, confidence {valve.confidence:.2f}"]
        notes += _describe_spokes(valve, wheel, request)
    if request.sense == "unknown":
        notes.append(
            f"the sense of the turn is not known: the wheel is tried by {np.rad2deg(PROBE):.0f} deg each way; stop a "
            f"stroke and go back on its path where the torque passes {request.torque_nm:g} N m, then request the turn"
        )
    if request.stuck:
        torque = STUCK_FACTOR * request.torque_nm
        notes.append(
            f"the wheel may be stuck: it is rocked by {np.rad2deg(ROCK):.0f} deg to either side first, for which the "
            f"robot is held with {torque:g} N m"
        )
    return tuple(notes)


def _describe_spokes(valve: ValveDetection, wheel: Wheel, request: ValveRequest) -> Iterator[str]:
    """Yield a sentence about the spokes of a wheel."""
    if not has_clear_spokes(valve):
        assumed = "; a spoke is assumed to meet the side of the peg" if request.mode == "hook" else ""
        yield (
            f"its spokes are not known: it is taken as solid from the axis to {ROOMS[request.mode]:.3f} m inside the "
            f"rim's inner edge, and as open between there and the rim{assumed}"
        )
    elif request.mode == "hook":
        yield (
            f"{len(wheel.spokes)} spokes are known, {2e3 * wheel.spokes[0].half_width:.0f} mm wide; the side of the "
            "peg presses one of them"
        )


def describe_lever(lever: LeverDetection) -> str:
    """Return what turns a valve without a wheel, with its sizes."""
    if lever.grip_length > 0.0:
        return f"crank {lever.length:.3f} m long with a grip of {lever.grip_length:.3f} m"
    return f"lever valve, {lever.length:.3f} m long,"


def refuse_lever(valve: ValveDetection | LeverDetection, request: ValveRequest) -> str | None:
    """Return why a lever that a scan shows cannot be turned as requested; None for what can."""
    if not isinstance(valve, LeverDetection):
        return None
    what = describe_lever(valve).rstrip(",")
    if request.mode == "grasp":
        return f"the valve is a {what}; task.valve.mode: expected hook, whose peg pushes it"
    stops = find_stops(request, has_grip=valve.grip_length > 0.0)
    turns = [float(np.rad2deg(angle)) for stroke in list_strokes(request, 1) for angle in (stroke.first, stroke.last)]
    if stops is None or (min(turns) >= np.rad2deg(stops[0]) - 1e-6 and max(turns) <= np.rad2deg(stops[1]) + 1e-6):
        return None
    low, high = np.rad2deg(stops)
    return (
        f"the valve is a {what}: task.valve turns it from {min(turns):g} to {max(turns):g} deg, and it stops at "
        f"{low:g} and {high:g} deg; expected turn_deg within them, or other task.valve.stops_deg"
    )


def find_no_entry(wheel: Wheel, hand: Hand, request: ValveRequest) -> str | None:
    """Return why a hand cannot enter a wheel anywhere; None if it can."""
    sense = list_strokes(request, 1)[0].sense
    if list_usable_entries(wheel, hand, request.mode, sense):
        return None
    return find_fault(wheel, hand, request.mode, wheel.list_entries(request.mode)[0], sense)


def find_valve(setup: PlanSetup, request: ValveRequest) -> ValveDetection | LeverDetection | str:
    """Return the valve to turn, or a sentence why there is none."""
    given = read_given_valve(request)
    if given is not None:
        return given
    scene = setup.request.scene
    if scene.cloud is None and scene.file is None:
        raise RequestError("task.valve: no scan to find it in; give scene.cloud, or centre, axis and radius")
    valves = setup.surroundings.valves
    if not valves and scene.file is not None:
        return "the scene has no valve; `scopt scene --detect valve` puts one in, or give centre, axis and radius"
    if not valves:
        return "no valve was found in the scan; scene.hint (a point near it) would help, or centre, axis and radius"
    if valves[0].confidence < SURE:
        centre = np.round(valves[0].centre, 2).tolist()
        return (
            f"no valve was found with confidence: the best candidate, at {centre}, has {valves[0].confidence:.2f} "
            f"of the {SURE} needed; scene.hint (a point near it) would help, or centre, axis and radius"
        )
    return valves[0]


def choose_hands(body: WholeBody, request: ValveRequest, valve: ValveDetection | LeverDetection) -> tuple[Hand, ...]:
    """Return the hands to try, the nearest to the valve first."""
    model, name = body.robot.model, body.robot.name
    if request.mode == "grasp":
        grips = tuple(
            hand
            for hand in list_hands(body, request.hand, valve.centre, ("tool", "palm"))
            if all(model.existJointName(grip) for grip in hand.grips)
        )
        if not grips:
            raise RequestError(
                f"task.valve.mode: grasp needs a hand with fingers, and the {request.hand} hand of robot '{name}' has "
                "none; robot.hand: gripper gives the bundled robot one, or mode: hook turns the wheel with a peg"
            )
        return grips
    known = list_hands(body, request.hand, valve.centre, ("tool", "peg", "stub"))
    if not known and model.existFrame("l_palm"):
        raise RequestError(f"task.valve.mode: hook needs a peg, and robot '{name}' has grippers; expected grasp")
    if not known:
        frames = "l_tool, l_peg, l_stub or r_tool, r_peg, r_stub"
        raise RequestError(f"task.valve.hand: robot '{name}' has no {request.hand} hand ({frames})")
    poses = locate_links(body.engine, body.nominal, [frame for hand in known for frame in (hand.stub, hand.tool)])
    free = [float(np.linalg.norm(poses[hand.tool][:3, 3] - poses[hand.stub][:3, 3])) for hand in known]
    if min(free) < LEAST_PEG:
        raise RequestError(
            f"task.valve.mode: the free peg of the hook is {min(free):.3f} m long; at least {LEAST_PEG} m reach "
            "through a wheel"
        )
    return known


def _list_turns(
    solver: PhaseSolver, wheel: Wheel, hands: Sequence[Hand], request: ValveRequest, free_waypoints: int | None
) -> Iterator[TaskPlan]:
    """Yield the feasible plans among the choices, one after another; if there is none, the one with most phases.

    Raises:
        RequestError: a link of the robot is in the wheel at the start.
    """
    mechanism = make_wheel_mechanism(wheel, float(np.deg2rad(request.turn_deg)))
    solver = _add_wheel(solver, mechanism, hands)
    collisions = tuple(find_collisions(solver.body, remedy=FARTHER))
    if collisions:
        raise RequestError(collisions)
    choices = list(list_choices(solver.body, wheel, hands, request))
    failed: list[tuple[TaskPlan, TurnChoice]] = []
    n_feasible = 0
    # A lever has a single place to hold. More poses are for a wheel that none turns, where a choice got farthest first.
    for n_random in (N_RANDOM,) if wheel.is_lever else (0, N_RANDOM):
        for choice in choices:
            plan = ValveTurn(solver, wheel, request, choice, free_waypoints, n_random).plan()
            if plan.is_feasible:
                n_feasible += 1
                yield plan
            else:
                failed.append((plan, choice))
            if n_feasible == MOST_PLANS:
                return
        if n_feasible:
            return
        failed.sort(key=lambda tried: -len(tried[0].phases))
        choices = [choice for _, choice in failed[:MOST_RETRIED]]
    if failed:
        yield failed[0][0]


def list_choices(body: WholeBody, wheel: Wheel, hands: Sequence[Hand], request: ValveRequest) -> Iterator[TurnChoice]:
    """Yield the choices to try: few strokes first, and entries that bring the first stroke near the hand."""
    least = find_least_count(request)
    counts = tuple(least * factor for factor in MORE_STROKES) if request.mode == "hook" else (least, least + 1)
    poses = locate_links(body.engine, body.nominal, [hand.tool for hand in hands])
    for count in (1,) if request.sense == "unknown" else counts:
        stroke = list_strokes(request, count)[0]
        for hand in hands:
            at = poses[hand.tool][:3, 3]

            def distance(entry: float, at: Float[np.ndarray, "3"] = at, middle: float = 0.5 * stroke.last) -> float:
                return float(np.linalg.norm(wheel.rim_point(entry + middle) - at))

            entries = list_usable_entries(wheel, hand, request.mode, stroke.sense)
            nearest = sorted((TurnChoice(hand, entry, count) for entry in entries), key=lambda own: distance(own.entry))
            # What the scan does not show rules out a certificate.
            hidden = [not is_shown(find_pressed_part(wheel, own, request.mode, stroke.sense)) for own in nearest]
            choices = [nearest[k] for k in np.argsort(hidden, kind="stable").tolist()][:MOST_ENTRIES]
            if request.mode == "grasp":
                flipped = [replace(choice, is_flipped=True) for choice in choices]
                choices = sorted((*choices, *flipped), key=lambda choice: -measure_wrist(body, wheel, request, choice))
            yield from choices[:MOST_ENTRIES]


def _add_wheel(solver: PhaseSolver, mechanism: Mechanism, hands: Sequence[Hand]) -> PhaseSolver:
    """Return the solver of the robot with the wheel, which hooks may come near."""
    return replace(add_mechanism(solver, mechanism), overrides=list_clearances(hands))


def list_clearances(hands: Sequence[Hand]) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
    """Return the required clearances between hands and the wheel that they reach into [m]."""
    return tuple(
        (BodyRef.of_link(link), BodyRef("mechanism", VALVE_LINK), HOOK_MARGIN)
        for hand in hands
        for link in (hand.link, hand.hook, hand.palm, *hand.fingers)
    )


def _plan_rest(
    solver: PhaseSolver, wheel: Wheel, request: ValveRequest, resume: ResumeRequest, free_waypoints: int | None
) -> Iterator[TaskPlan]:
    """Yield plans of the rest of a turn with the hand, the entry and the strokes of the earlier plan."""
    demand = ValveDemand(wheel, request, list_robot_hands(solver.body.robot), solver.hand_friction[1])
    rest, choice = make_valve_rest(demand, resume), read_kept_choice(demand, resume)
    solver = _add_wheel(solver, rest.mechanism, [choice.hand])
    turning = ValveTurn(solver, wheel, request, choice, free_waypoints)
    return plan_rest(solver, rest, turning.list_phases(), resume, turning.hints)


def _advise_stance(solver: PhaseSolver, wheel: Wheel, hand: Hand) -> str:
    """Return a sentence about the pelvis shift that would bring the whole rim into reach within limits and balance.

    Obstacles are left out: a plan from the new stance shows whether it is free.
    """
    quick = replace(solver, body=replace(solver.body, scene=Scene())).with_effort(Effort.QUICK_POSE)
    yaw = solver.body.nominal[3]
    forward, left = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    signed = [-shift for shift in SHIFTS[1:4]] + list(SHIFTS)
    for ahead, aside in sorted(product(signed, (-0.2, 0.0, 0.2)), key=lambda shift: np.hypot(*shift)):
        if _is_reachable(quick, wheel, hand, ahead * forward + aside * left):
            if ahead == aside == 0.0:
                return f"the rim is within reach of the {hand.side} hand from here; obstacles around it are in the way"
            words = [f"{abs(ahead):.1f} m {'forward' if ahead > 0 else 'back'}"] if ahead else []
            words += [f"{abs(aside):.1f} m to the {'left' if aside > 0 else 'right'}"] if aside else []
            return f"moving the pelvis (and the feet) {' and '.join(words)} would bring the rim within reach"
    return f"no shift of the pelvis by up to {max(SHIFTS):.1f} m brings the rim within reach of the {hand.side} hand"


def _is_reachable(solver: PhaseSolver, wheel: Wheel, hand: Hand, shift: Float[np.ndarray, "3"]) -> bool:
    """Return whether the hand reaches points all round the rim, with the wheel shifted instead of the robot."""
    body = solver.body
    waypoints = np.arange(len(ANGLES))
    targets = np.tile(np.eye(4), (len(ANGLES), 1, 1))
    targets[:, :3, 3] = [wheel.rim_point(angle) - shift for angle in ANGLES]
    position = FramePose(body.robot, hand.tool, waypoints, targets, POSITION)
    direction = AxisDirection(body.robot, hand.tool, waypoints, AXIS, -wheel.axis)
    aim = ADVICE_AXIS_AIM
    result = solver.solve_trajectory(
        "stance",
        np.tile(body.nominal, (len(ANGLES), 1)),
        {},
        constraints=(
            Constraint("tool on the rim", position, Sense.EQUAL_ZERO, 2e-3),
            Constraint("hand axis", WithinTolerance(direction, aim), tolerance=0.2 * aim),
        ),
    )
    return result.is_feasible
