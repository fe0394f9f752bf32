"""Plan a door request: the door that the scan shows or the request gives, and the hands to try."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from costs.allowance import BodyRef
from costs.static_region import StaticRegionError
from costs.stopping import Stopped
from service.body.monitor import Interrupted
from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.door.demand import DoorDemand, choose_door, make_door, make_door_rest, measure_lever_room, set_back
from service.demands.door.door import FREE_BEYOND, Door
from service.demands.hands import Hand
from service.errors import RequestError
from service.request.tasks.door import DoorRequest
from service.setup.prepare import PlanSetup
from service.tasks.door.hints import make_door_hints
from service.tasks.door.opening import LEAST_FIRST, DoorOpening
from service.tasks.door.places import find_narrow_gap
from service.tasks.door.sweep import BlockedOpening, find_blocked_opening
from service.tasks.handling import FARTHER, find_collisions, list_hands
from service.tasks.rest.plan import plan_rest
from service.tasks.sequence import add_mechanism

STANCE_ADVICE = "the door may open farther from elsewhere: `scopt stance REQUEST` searches for a place to stand"
BEFORE_OBSTACLE = np.deg2rad(3.0)  # the leaf stops in a best attempt, of the angle at which it meets something
HANDLE_MARGIN = 4e-3  # between a hand and the door that it holds [m]


def plan_door(setup: PlanSetup, solver: PhaseSolver, request: DoorRequest) -> Iterator[TaskPlan]:
    """Yield plans to open the request's door; each further one stays at the handle for a smaller angle."""
    begun = _begin(setup, solver, request)
    if not isinstance(begun, tuple):
        yield from begun
        return
    opening, notes = begun
    for plan in opening.plans():
        advice = () if plan.is_feasible else (STANCE_ADVICE,)
        yield replace(plan, obstacle=(*plan.obstacle, *advice), notes=(*notes, *plan.notes))


def _begin(
    setup: PlanSetup, solver: PhaseSolver, request: DoorRequest
) -> Iterable[TaskPlan] | tuple[DoorOpening, tuple[str, ...]]:
    """Return what there is to open and notes about it, or plans where there is nothing to search for."""
    found = find_door(setup, request)
    if isinstance(found, str):
        return [TaskPlan(solver.body, (), (found,))]
    door, note = set_back(found[0], setup.request.resume), found[1]
    target = float(np.deg2rad(request.open_deg))
    loose = door.explain_loose(target)
    if loose is not None:
        raise RequestError(loose)
    hands = choose_hands(solver.body, request, door)
    refused = find_shut(request, door) or find_narrow_lever(solver.body, door, hands)
    if refused is not None:
        narrow = find_no_edge(solver.body, door, hands)
        if narrow is not None:
            return [TaskPlan(solver.body, (), (refused, *narrow))]
    near = list_clearances(hands, door)
    hints = make_door_hints(setup.request.options.waypoints)
    if setup.request.resume is not None:
        rest = make_door_rest(DoorDemand(door, request, setup.robot), setup.request.resume)
        solver = replace(add_mechanism(solver, rest.mechanism), overrides=near)
        opening = DoorOpening(solver, door, hands, target, request.stays, hints)
        plans = plan_rest(solver, rest, rest.specs, setup.request.resume, hints)
        return (replace(plan, notes=(note, *plan.notes)) for plan in plans)
    solver = replace(add_mechanism(solver, door.mechanism), overrides=near)
    collisions = tuple(find_collisions(solver.body, remedy=FARTHER))
    if collisions:
        raise RequestError(collisions)
    blocked = find_blocked_opening(solver.body, door, target)
    obstacles = [met for met in blocked if met.stands_still]
    if obstacles:
        least = door.geometry.ajar + LEAST_FIRST
        free = max(min(met.angle for met in obstacles) - BEFORE_OBSTACLE, least)
        opening = DoorOpening(solver, door, hands, free, request.stays, hints)
        return _open_up_to(opening, obstacles, target, note)
    notes = (note, *(met.describe(target) for met in blocked))
    return DoorOpening(solver, door, hands, target, request.stays, hints), notes


def _open_up_to(
    opening: DoorOpening, obstacles: Sequence[BlockedOpening], target: float, note: str
) -> Iterator[TaskPlan]:
    """Yield what is known without a search, then the best attempt: it goes as far as the leaf is free.

    Args:
        opening: to where the leaf is free.
        obstacles: what the leaf meets.
        target: requested angle [rad].
        note: about the door.
    """
    is_piece = any(met.is_piece for met in obstacles)
    sentences = tuple(met.describe(target) for met in obstacles)
    advice = () if is_piece else (STANCE_ADVICE,)
    known = TaskPlan(opening.solver.body, (), (*sentences, *advice), notes=(note,), is_impossible=is_piece)
    yield known
    if min(met.angle for met in obstacles) <= opening.target:
        return
    try:
        attempt = opening.plan()
    except StaticRegionError:
        return
    except (Interrupted, Stopped):
        opening.solver.monitor.check_stop()
        return  # the verdict needs no more time
    yield replace(
        known, body=attempt.body, phases=attempt.phases, measure=attempt.measure, notes=(note, *attempt.notes)
    )


def find_shut(request: DoorRequest, door: Door) -> str | None:
    """Return a sentence where no hand of a robot can open the door.

    Raises:
        RequestError: the leaf is open already.
    """
    if door.geometry.ajar >= np.deg2rad(request.open_deg):
        raise RequestError(
            f"task.door.open_deg: {request.open_deg:g}; the leaf is open by {np.rad2deg(door.geometry.ajar):.0f} deg "
            "already; expected more"
        )
    has_knob = door.handle is not None and door.handle.kind == "knob"
    if has_knob and (door.geometry.ajar < FREE_BEYOND or not door.is_push):
        return "the door has a knob; no hand of this robot can turn a knob"
    if door.handle is None and not door.is_push:
        return "the door opens towards the robot and has no handle to pull it by"
    return None


def find_no_edge(body: WholeBody, door: Door, hands: Sequence[Hand]) -> tuple[str, ...] | None:
    """Return why no hand pulls a leaf by its free edge, if that is worth saying; None where one may."""
    if door.is_push or door.is_latched or door.geometry.ajar < FREE_BEYOND:
        return ()
    narrow = find_narrow_gap(door, hands, body.robot, door.geometry.ajar)
    return None if narrow is None else (narrow,)


def find_narrow_lever(body: WholeBody, door: Door, hands: Sequence[Hand]) -> str | None:
    """Return a sentence where a pulled lever is too near to its leaf for the peg of every hand; None where it is not.

    Only the hand's front turns the lever while the peg behind it pulls, so that no other hold opens the door.
    """
    handle, geometry = door.handle, door.geometry
    if handle is None or handle.kind != "lever" or door.is_push:
        return None
    off = float((handle.centre - geometry.hinge) @ geometry.normal) - geometry.face
    needed = min(measure_lever_room(body.robot, hand, handle.radius) for hand in hands)
    if off >= needed:
        return None
    return (
        f"the middle of the lever is {1e3 * off:.0f} mm off the leaf; the peg behind it, with the hand above it, needs "
        f"{np.ceil(1e3 * needed):.0f} mm"
    )


def list_clearances(hands: tuple[Hand, ...], door: Door) -> tuple[tuple[BodyRef, BodyRef, float], ...]:
    """Return the required clearances between hands and the door that they hold [m]."""
    return tuple(
        (BodyRef.of_link(link), BodyRef("mechanism", joint.link), HANDLE_MARGIN)
        for hand in hands
        for link in (hand.hook, hand.link)
        for joint in door.mechanism.joints
    )


def find_door(setup: PlanSetup, request: DoorRequest) -> tuple[Door, str] | str:
    """Return the door to open and a note about it, or a sentence why there is none."""
    base = setup.start[:3] if setup.robot.is_floating else np.zeros(3)
    if request.leaf is None and setup.request.scene.cloud is None:
        raise RequestError("task.door: no scan to find it in; give scene.cloud, or leaf and handle")
    doors, pieces = setup.surroundings.doors, setup.scene.pieces
    geometry = choose_door(request, doors, base, pieces)
    if isinstance(geometry, str):
        return geometry
    is_shown = request.leaf is None and request.moved_m is None
    door = make_door(request, geometry, setup.surroundings.seen if is_shown else None)
    is_told = request.opens != "auto" or request.leaf is not None or doors[0].geometry.opens is not None
    other = "pull" if geometry.opens == "push" else "push"
    return door, describe_door(door) + ("" if is_told else f"; a {other} would meet its frame at once")


def describe_door(door: Door) -> str:
    """Return a sentence that says which door was planned for."""
    geometry = door.geometry
    handle = "no handle" if door.handle is None else f"a {door.handle.kind.replace('_', ' ')}"
    place = np.round(geometry.hinge, 3).tolist()
    ajar = f", {np.rad2deg(geometry.ajar):.0f} deg ajar" if geometry.ajar > 0.0 else ""
    return (
        f"{geometry.opens} door {geometry.width:.2f} m wide{ajar}, hinge axis at {place}, with {handle}; planned for "
        f"{door.hinge_nm:g} N m at the hinge and {door.lever_nm:g} N m at a lever"
    )


def choose_hands(body: WholeBody, request: DoorRequest, door: Door) -> tuple[Hand, ...]:
    """Return the hands to try, the nearest to the handle first.

    Raises:
        RequestError: the robot has no such hand.
    """
    at = door.geometry.hinge + door.geometry.width * door.geometry.along if door.handle is None else door.handle.centre
    known = list_hands(body, request.hand, at, ("tool", "peg", "stub"))
    if not known:
        frames = "l_tool, l_peg, l_stub or r_tool, r_peg, r_stub"
        raise RequestError(
            f"task.door.hand: robot '{body.robot.name}' has no {request.hand} hand with a rod ({frames}, or those of "
            "robot.hands); closed fingers open a door by task.mechanism"
        )
    return known
