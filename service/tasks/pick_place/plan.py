"""Plan a request to take an object and put it elsewhere: refuse what cannot be done, then try hands and grasps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float

from service.body.phases import PhaseSolver
from service.body.task_plan import TaskPlan
from service.body.whole_body import WholeBody
from service.demands.grasping.gripper import Gripper
from service.demands.pick_place.demand import PickPlaceDemand
from service.demands.pick_place.work import FIELD, PickPlace, choose_grippers, place_object
from service.explain.distance import find_out_of_reach
from service.request.tasks.pick_place import PickRequest
from service.setup.checks import describe_overload
from service.setup.prepare import PlanSetup
from service.tasks.pick_place.carrying import CarrySequence
from service.tasks.pick_place.choices import Choice, find_blocked, list_choices, rank_choices
from service.verify import GRAVITY, REST_MARGIN_M, CoalSolid, DistanceQuery

MOST_CHOICES = 6  # that are planned
ON_TOP_M = 0.01  # above an object, within which a piece rests on it
ON_TOP_SHARE = 0.5  # of an object's height that such a piece is above


def plan_pick_place(setup: PlanSetup, solver: PhaseSolver, section: PickRequest) -> Iterator[TaskPlan]:
    """Yield a plan for one hand and grasp after the other; where none is feasible, the one with most phases.

    Raises:
        RequestError: there is no such object, or the robot has no such hand.
    """
    body = solver.body
    work = PickPlace.of(section, setup.request, body.robot, body.scene)
    grippers = choose_grippers(body.robot, section)
    reason = find_obstacle(body, work, grippers)
    if reason is not None:
        yield TaskPlan(body, (), (reason,), is_impossible=True)
        return
    choices, refused = list_choices(work, grippers)
    if not choices:
        yield TaskPlan(body, (), (f"{work.item.name} is {refused[0]}",), is_impossible=True)
        return
    blocked = {choice: find_blocked(body, work, choice) for choice in choices}
    free = [choice for choice in choices if blocked[choice] is None]
    if not free:
        yield TaskPlan(body, (), (str(blocked[choices[0]]),), is_impossible=True)
        return
    ranked = rank_choices(body, work, free)
    if not ranked:
        where = "both where it is and where it is put, in balance, from where the robot stands"
        words = f"no hand reaches any of the {len(free)} grasps of {work.item.name} {where}"
        yield TaskPlan(body, (), (words,))
        return
    demand = PickPlaceDemand(work, grippers)
    unsolved: TaskPlan | None = None
    is_found = False
    for is_patient, (choice, first, last) in product((False, True), ranked[:MOST_CHOICES]):
        if is_patient and is_found:
            return
        sequence = replace(CarrySequence.of(solver, work, choice.grasps), is_patient=is_patient)
        phases, stuck = sequence.plan(first, last)
        notes = (f"{work.item.name} is taken by {choice.describe()}",)
        plan = TaskPlan(body, phases, stuck=stuck, measure=demand.measure, notes=notes, objects=(work.item,))
        if stuck is None:
            is_found = True
            yield plan
            continue
        if unsolved is None or len(phases) > len(unsolved.phases):
            overload = _describe_weight(sequence, work, choice, first, last)
            unsolved = plan if overload is None else replace(plan, obstacle=(overload,))
    if unsolved is not None and not is_found:
        yield unsolved


def find_obstacle(body: WholeBody, work: PickPlace, grippers: Sequence[Gripper]) -> str | None:
    """Return a sentence on what forbids the work whatever the grasp; None where nothing does."""
    item, section = work.item, work.request
    at = np.round(work.place[:3, 3], 3).tolist()
    above = _find_on_top(body, work)
    if above:
        return f"{item.name} is under {above}; that has to be taken away first"
    for margin, names, where in (
        (work.margins[0], work.supports, "where it is"),
        (work.margins[1], work.ends_on, f"at {FIELD}.to {at}"),
    ):
        if margin >= REST_MARGIN_M:
            continue
        if not names:
            return f"{item.name} does not rest {where}: nothing is within 3 mm below it"
        return f"{item.name} does not rest {where}: {' and '.join(names)} would let it tip or slide"
    met = _find_inside(body, work)
    if met is not None:
        return (
            f"there is no place for {item.name} at {FIELD}.to {at}: it would be {1e3 * met[1]:.0f} mm inside {met[0]}"
        )
    weak = [gripper for gripper in grippers if gripper.force_n < section.grip_n]
    if weak:
        return (
            f"{FIELD}.grip_n: {section.grip_n:g} N; the fingers of the {weak[0].side} hand press with at most "
            f"{weak[0].force_n:g} N"
        )
    needed = GRAVITY * item.inertia.mass / (2.0 * work.friction * (2 if section.hand == "both" else 1))
    if needed > section.grip_n:
        return (
            f"{item.name} of {item.inertia.mass:g} kg is too heavy: each finger would have to press with "
            f"{needed:.0f} N at a friction of {work.friction:g}, {FIELD}.grip_n is {section.grip_n:g} N"
        )
    for pose, where in ((item.start, "where it is"), (work.place, "where it is put")):
        radius = float(np.linalg.norm(item.vertices, axis=1).max()) + 0.2
        reasons = [find_out_of_reach(body, gripper.tool, pose[:3, 3], radius) for gripper in grippers]
        if all(reasons):
            return f"{item.name} is out of reach {where}: {reasons[0]}"
    return None


def _find_on_top(body: WholeBody, work: PickPlace) -> str:
    """Return the pieces that lie on the object, joined by a word; empty where none does."""
    vertices = work.item.vertices @ work.item.start[:3, :3].T + work.item.start[:3, 3]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    names = []
    for piece in body.scene.pieces:
        overlaps = np.all(piece.lower[:2] < high[:2] - 1e-3) and np.all(piece.upper[:2] > low[:2] + 1e-3)
        is_above = piece.lower[2] > low[2] + ON_TOP_SHARE * (high[2] - low[2])
        if overlaps and is_above and abs(piece.lower[2] - high[2]) < ON_TOP_M:
            names.append(piece.name)
    return " and ".join(names)


def _find_inside(body: WholeBody, work: PickPlace) -> tuple[str, float] | None:
    """Return the piece in which the object would be deepest where it is put, and how deep [m]; None where in none."""
    own = CoalSolid.of_body(place_object(body.robot, work.item, None, work.place).bodies[-1])
    query, worst = DistanceQuery(), None
    for piece in body.scene.pieces:
        if np.any(piece.lower > own.vertices.max(axis=0)) or np.any(piece.upper < own.vertices.min(axis=0)):
            continue
        solid = CoalSolid.of_piece(piece)
        distances, _ = query.closest([own.convex], np.eye(3)[None], np.zeros((1, 3)), [solid.convex])
        depth = -float(distances[0])
        if depth > (3e-3 if piece.name in work.ends_on else 1e-6) and (worst is None or depth > worst[1]):
            worst = piece.name, depth
    return worst


def _describe_weight(
    sequence: CarrySequence,
    work: PickPlace,
    choice: Choice,
    first: Float[np.ndarray, "n"],
    last: Float[np.ndarray, "n"],
) -> str | None:
    """Return which joint cannot hold the object at either end; None where all can."""
    if len(choice.grasps) > 1:
        return None
    planted = tuple(foot.link for foot in sequence.held.body.planted)
    for q, where in ((first, "where it is taken"), (last, "where it is put")):
        line = describe_overload(sequence.held.body.robot, q, planted)
        if line is not None:
            return f"{work.item.name} of {work.item.inertia.mass:g} kg is too heavy {where}: {line}"
    return None
