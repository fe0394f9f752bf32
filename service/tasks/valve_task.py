"""From a valve request to the wheel and the hands it is turned with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from costs.kinematics import locate_links
from perception import ValveDetection, has_clear_spokes
from service.body.phases import PhaseSolver, TaskPlan
from service.body.reach import find_out_of_reach
from service.body.whole_body import WholeBody
from service.demands.wheel import HANDS, HOOK_ROOM, RIM_TOLERANCE, Hand, Wheel, make_wheel
from service.errors import RequestError
from service.request.schema import ValveRequest
from service.scan.scene_file import wheel_from_circle
from service.setup.prepare import PlanSetup
from service.tasks.stance import stance_advice
from service.tasks.valve import plan_turn

SURE = 0.5  # confidence from which a detection is acted on
TUBE_RADIUS = 0.015  # of a valve given by its circle alone [m]


def plan_valve(setup: PlanSetup, solver: PhaseSolver, request: ValveRequest) -> TaskPlan:
    """Turn the valve of a request: detected in the scan, or given by centre, axis and radius."""
    found = _valve(setup, request)
    if isinstance(found, str):
        return TaskPlan(solver.body, (), (found,))
    hands = _hands(solver.body, request, found)
    farthest = found.rim_radius + RIM_TOLERANCE
    reasons = [find_out_of_reach(solver.body, hand.tool, found.centre, farthest) for hand in hands]
    if all(reasons):
        return TaskPlan(solver.body, (), tuple(reason for reason in reasons if reason), is_impossible=True)
    wheel = _wheel(solver.body, found, hands[0])
    count = setup.request.options.waypoints
    effort = {} if count is None else {"reach_waypoints": count}
    plan = plan_turn(solver, wheel, hands, request.mode, np.deg2rad(request.turn_deg), **effort)
    note = (
        f"valve at {np.round(found.centre, 3).tolist()}, axis {np.round(found.axis, 3).tolist()}, "
        f"rim radius {found.rim_radius:.3f} m, confidence {found.confidence:.2f}"
    )
    if not has_clear_spokes(found):
        note += f"; its spokes are not known, it is taken as solid up to {HOOK_ROOM:.2f} m from the rim's centre line"
    if plan.is_feasible:
        return replace(plan, notes=(note, *plan.notes))
    return replace(plan, obstacle=(*plan.obstacle, stance_advice(solver, wheel, hands[0])), notes=(note, *plan.notes))


def given_valve(request: ValveRequest) -> ValveDetection | None:
    """The valve that a request gives by its circle; None where it is to be found in the scan.

    Raises:
        RequestError: some of centre, axis and radius are missing.
    """
    if all(value is None for value in (request.centre, request.axis, request.radius)):
        return None
    if request.centre is None or request.axis is None or request.radius is None:
        raise RequestError("task.valve: centre, axis and radius come together; give all three or none")
    return wheel_from_circle(np.array(request.centre), np.array(request.axis), request.radius, TUBE_RADIUS)


def _valve(setup: PlanSetup, request: ValveRequest) -> ValveDetection | str:
    """The valve to turn, or a sentence that says why there is none."""
    given = given_valve(request)
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


def _hands(body: WholeBody, request: ValveRequest, valve: ValveDetection) -> list[Hand]:
    """The hands to try, the one on the valve's side first."""
    known = [hand for hand in HANDS.values() if body.robot.model.existFrame(hand.tool)]
    if request.hand != "auto":
        known = [hand for hand in known if hand.side == request.hand]
    if not known:
        raise RequestError(
            f"task.valve.hand: robot '{body.robot.name}' has no {request.hand} tool frame (l_tool, r_tool)"
        )
    poses = locate_links(body.engine, body.nominal, [hand.tool for hand in known])
    return sorted(known, key=lambda hand: float(np.linalg.norm(poses[hand.tool][:3, 3] - valve.centre)))


def _wheel(body: WholeBody, valve: ValveDetection, hand: Hand) -> Wheel:
    """The wheel as a mechanism, its gaps ordered by how near they are to the hand."""
    wheel = make_wheel(valve)
    at = locate_links(body.engine, body.nominal, [hand.tool])[hand.tool][:3, 3]
    gaps = sorted(wheel.gaps, key=lambda angle: float(np.linalg.norm(wheel.rim_point(angle) - at)))
    return replace(wheel, gaps=tuple(gaps))
