"""Plan a valve request: wheel and hands to try, the turn, and advice where to stand if the rim is out of reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.allowance import BodyRef
from costs.kinematics import locate_links
from costs.robot import Mechanism
from costs.scene import Scene
from costs.terms import AxisDirection, FramePose, WithinTolerance
from perception import ValveDetection, has_clear_spokes
from scopt import Constraint, Sense
from service.body.holds import POSITION
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.hands import Hand, list_robot_hands
from service.demands.phase_spec import AXIS, REACH_WAYPOINTS
from service.demands.valve_demand import ValveDemand, read_kept_stroke, resume_valve, turn_back
from service.demands.wheel import (
    HOOK_ROOM,
    RIM_TOLERANCE,
    Wheel,
    make_wheel,
    make_wheel_mechanism,
)
from service.errors import RequestError
from service.explain.distance import find_out_of_reach
from service.request.names import VALVE_LINK
from service.request.resume import ResumeRequest
from service.request.schema import ValveRequest
from service.scan.scene_file import wheel_from_circle
from service.setup.prepare import PlanSetup
from service.tasks.handling import FARTHER, find_collisions, list_hands
from service.tasks.resume import plan_rest
from service.tasks.sequence import add_mechanism
from service.tasks.valve import ValveTurn

SURE = 0.5  # least confidence of a detection that is used
TUBE_RADIUS = 0.015  # when the request gives only the rim circle [m]
HOOK_MARGIN = 5e-3  # between the hook and the wheel it reaches into [m]
MOST_GAPS = 3  # tried with each hand, the nearest first
SHIFTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)  # of the pelvis [m]
ANGLES = np.deg2rad([0.0, 120.0, 240.0])  # of the rim that must be in reach after a shift
# A solvable shift takes few steps.
ADVICE_EFFORT: dict[str, Any] = {"max_iterations": 20, "max_penalty_raises": 2}
ADVICE_AXIS_AIM = np.deg2rad(1.5)


def plan_valve(setup: PlanSetup, solver: PhaseSolver, request: ValveRequest) -> TaskPlan:
    """Plan to turn the request's valve, detected in the scan or given by centre, axis and radius."""
    valve = find_valve(setup, request)
    if isinstance(valve, str):
        return TaskPlan(solver.body, (), (valve,))
    valve = turn_back(valve, setup.request.resume)
    hands = choose_hands(solver.body, request, valve)
    farthest = valve.rim_radius + RIM_TOLERANCE
    reasons = [find_out_of_reach(solver.body, hand.tool, valve.centre, farthest) for hand in hands]
    if all(reasons):
        return TaskPlan(solver.body, (), tuple(reason for reason in reasons if reason), is_impossible=True)
    wheel = _make_wheel(solver.body, valve, hands[0])
    waypoints = setup.request.options.waypoints or REACH_WAYPOINTS
    if setup.request.resume is not None:
        return _plan_rest(solver, wheel, request, setup.request.resume, waypoints)
    plan = _plan_turn(solver, wheel, hands, request, waypoints)
    note = (
        f"valve at {np.round(valve.centre, 3).tolist()}, axis {np.round(valve.axis, 3).tolist()}, "
        f"rim radius {valve.rim_radius:.3f} m, confidence {valve.confidence:.2f}"
    )
    if not has_clear_spokes(valve):
        note += f"; its spokes are not known, it is taken as solid up to {HOOK_ROOM:.2f} m from the rim's centre line"
    if plan.is_feasible:
        return replace(plan, notes=(note, *plan.notes))
    return replace(plan, obstacle=(*plan.obstacle, _advise_stance(solver, wheel, hands[0])), notes=(note, *plan.notes))


def read_given_valve(request: ValveRequest) -> ValveDetection | None:
    """Return the valve that a request gives by its rim circle; None where the scan must show it.

    Raises:
        RequestError: some of centre, axis and radius are missing.
    """
    if all(value is None for value in (request.centre, request.axis, request.radius)):
        return None
    if request.centre is None or request.axis is None or request.radius is None:
        raise RequestError("task.valve: centre, axis and radius come together; give all three or none")
    return wheel_from_circle(np.array(request.centre), np.array(request.axis), request.radius, TUBE_RADIUS)


def find_valve(setup: PlanSetup, request: ValveRequest) -> ValveDetection | str:
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


def choose_hands(body: WholeBody, request: ValveRequest, valve: ValveDetection) -> tuple[Hand, ...]:
    """Return the hands to try, the nearest to the valve first."""
    known = list_hands(body, request.hand, valve.centre, ("tool",))
    if not known:
        raise RequestError(
            f"task.valve.hand: robot '{body.robot.name}' has no {request.hand} tool frame (l_tool, r_tool)"
        )
    return known


def _make_wheel(body: WholeBody, valve: ValveDetection, hand: Hand) -> Wheel:
    """Return the wheel as a mechanism, with its gaps ordered by distance from the hand."""
    wheel = make_wheel(valve)
    at = locate_links(body.engine, body.nominal, [hand.tool])[hand.tool][:3, 3]
    gaps = sorted(wheel.gaps, key=lambda angle: float(np.linalg.norm(wheel.rim_point(angle) - at)))
    return replace(wheel, gaps=tuple(gaps))


def _plan_turn(
    solver: PhaseSolver, wheel: Wheel, hands: Sequence[Hand], request: ValveRequest, reach_waypoints: int
) -> TaskPlan:
    """Try hands and gaps in turn; return the first plan that works, else the one with most phases.

    Raises:
        RequestError: a link of the robot is in the wheel at the start.
    """
    solver = _add_wheel(solver, make_wheel_mechanism(wheel), hands)
    collisions = tuple(find_collisions(solver.body, remedy=FARTHER))
    if collisions:
        raise RequestError(collisions)
    best: TaskPlan | None = None
    for hand, entry in product(hands, wheel.gaps[:MOST_GAPS]):
        turn = np.deg2rad(request.turn_deg)
        plan = ValveTurn(solver, wheel, hand, request.mode, turn, entry, request.torque_nm, reach_waypoints).plan()
        if plan.is_feasible:
            return plan
        if best is None or len(plan.phases) > len(best.phases):
            best = plan
    if best is None:
        raise ValueError("a wheel needs a gap and the robot a hand")
    return best


def _add_wheel(solver: PhaseSolver, mechanism: Mechanism, hands: Sequence[Hand]) -> PhaseSolver:
    """Return the solver of the robot with the wheel, which hooks may come near."""
    return replace(add_mechanism(solver, mechanism), overrides=list_clearances(hands))


def list_clearances(hands: Sequence[Hand]) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
    """Return the required clearances between hooks and the wheel that they reach into [m]."""
    return tuple((BodyRef.of_link(hand.hook), BodyRef("mechanism", VALVE_LINK), HOOK_MARGIN) for hand in hands)


def _plan_rest(
    solver: PhaseSolver, wheel: Wheel, request: ValveRequest, resume: ResumeRequest, reach_waypoints: int
) -> TaskPlan:
    """Plan the rest of a turn with the hand, the gap and the grasps of the earlier plan."""
    hands = list_robot_hands(solver.body.robot)
    rest = resume_valve(ValveDemand(wheel, request, hands), resume)
    hand, stroke = read_kept_stroke(request, resume, hands)
    solver = _add_wheel(solver, rest.mechanism, [hand])
    turn = np.deg2rad(request.turn_deg)
    turning = ValveTurn(solver, wheel, hand, request.mode, turn, stroke.gap_rad, request.torque_nm, reach_waypoints)
    specs = turning.list_phases()
    if [spec.name for spec in specs] != [spec.name for spec in rest.specs]:
        raise RequestError(f"resume.stroke.strokes: {stroke.strokes}; this robot turns the wheel in another number")
    return plan_rest(solver, rest, specs, turning.measure)


def _advise_stance(solver: PhaseSolver, wheel: Wheel, hand: Hand) -> str:
    """Return a sentence about the pelvis shift that would bring the whole rim into reach within limits and balance.

    Obstacles are left out: a plan from the new stance shows whether it is free.
    """
    quick = replace(solver, body=replace(solver.body, scene=Scene())).with_settings(**ADVICE_EFFORT)
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
        [np.tile(body.nominal, (len(ANGLES), 1))],
        {},
        constraints=(
            Constraint("tool on the rim", position, Sense.EQUAL_ZERO, 2e-3),
            Constraint("hand axis", WithinTolerance(direction, aim), tolerance=0.2 * aim),
        ),
    )
    return result.is_feasible
