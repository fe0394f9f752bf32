"""Checks of a request against its robot and scene: names, limits, planted feet, and the start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import BASE_NAMES, RobotModel
from costs.scene import Scene
from costs.work_space import borrow_data
from service.demands import list_planted_feet
from service.demands.contacts.stances import ContactStance
from service.demands.kind import find_demand_part
from service.demands.targets import find_goal_joints
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.start.configuration import find_unknown_links, is_sliding
from service.start.overlaps import (
    Overlap,
    describe_dead_end,
    find_hull_overlaps,
    find_overlaps_and_unresolved,
)
from service.start.resting import find_rests
from service.start.split_links import suggest_split
from service.start.standing import (
    FEET_GROUP,
    FLOOR_KIND,
    find_ground_problems,
    find_lowest_links,
    find_standing_problems,
    sole_corners,
)
from service.verify import STANDING_DEPTH_M

if TYPE_CHECKING:
    from service.trajopt import Program

OWN_POINTS = "scene.file: where the robot stood in the scan, `scopt scene --robot NAME` leaves its own points out"

MOST_NAMED = 8


@dataclass(frozen=True)
class StartCheck:
    """The result of checking a start that can be planned from.

    Attributes:
        overlaps: overlapping hulls that the first phase separates.
        rests: carried bodies and the pieces on which they rest, from which the first phase raises them.
        unresolved: sentences about pairs that are apart but whose hulls overlap, so that they cannot be certified.
        notes: sentences about collisions that the first phase resolves.
    """

    overlaps: tuple[Overlap, ...]
    unresolved: tuple[str, ...]
    notes: tuple[str, ...]
    rests: tuple[tuple[str, str], ...] = ()


def check_names_and_values(robot: RobotModel, request: PlanRequest) -> None:
    """Check the names and joint values of ``keep`` and of the goal or the task.

    Raises:
        RequestError: one line per unknown joint, posture or link, or joint value beyond its limits.
    """
    problems = list(find_demand_part(request).list_name_problems(request.section, request, robot))
    problems += _list_sway_problems(robot, request)
    for index, keep in enumerate(request.keep):
        problems += find_unknown_links(robot, (keep.link,), f"keep[{index}].link")
        if keep.relative_to is not None:
            problems += find_unknown_links(robot, (keep.relative_to,), f"keep[{index}].relative_to")
    if problems:
        raise RequestError(problems)


def _list_sway_problems(robot: RobotModel, request: PlanRequest) -> list[str]:
    """Return what a base that sways cannot go with: one that moves by itself, and tasks beside goals."""
    options = request.options
    field, value = ("sway_m", options.sway_m) if options.sway_m else ("sway_deg", options.sway_deg)
    if not value:
        return []
    if robot.is_floating or robot.is_planar:
        return [
            f"options.{field}: {value:g} with a robot whose base is planned; expected robot.root: fixed, "
            "since only a base that something else balances sways"
        ]
    legs = _list_leg_joints(robot)
    if legs:
        more = f" and {len(legs) - 1} others" if len(legs) > 1 else ""
        return [
            f"options.{field}: {value:g}, and {legs[0]}{more} move the legs, which something else balances on; "
            f"expected them in robot.locked, at their positions: {', '.join(legs)}"
        ]
    if request.task is not None:
        return [f"options.{field}: {value:g} with a task; expected a goal, as hands that press do not make up for sway"]
    return []


def _list_leg_joints(robot: RobotModel) -> list[str]:
    """Return the joints between the base and the links of the robot's group ``feet``."""
    model, found = robot.model, set[int]()
    for link in robot.link_groups.get(FEET_GROUP, ()):
        joint = int(model.frames[model.getFrameId(link)].parentJoint)
        while joint > 0:
            found.add(joint)
            joint = int(model.parents[joint])
    return [str(model.names[joint]) for joint in sorted(found)]


def find_soles(
    robot: RobotModel, start: Float[np.ndarray, "n"], request: PlanRequest, program: Program | None
) -> dict[str, np.ndarray]:
    """Return the (C, 3) sole corners of every planted link in the world [m]; none for a fixed base.

    Raises:
        RequestError: ``options.feet`` cannot be used, or the robot names no feet and the request lists none.
    """
    feet = request.options.feet
    if program is not None:
        feet = program.planted
    elif not robot.is_floating and feet:
        raise RequestError("options.feet: this robot's base is fixed and plants no feet; leave it out")
    elif robot.is_floating:
        feet = _check_feet(robot, start, feet)
    return {foot: sole_corners(robot, start, foot) for foot in feet or ()}


def _check_feet(robot: RobotModel, start: Float[np.ndarray, "n"], requested: tuple[str, ...] | None) -> tuple[str, ...]:
    if requested == ():
        raise RequestError("options.feet: lists no link; name the planted links, or leave it out for the robot's own")
    feet = list_planted_feet(robot, requested)
    if not feet:
        lowest = ", ".join(find_lowest_links(robot, start))
        raise RequestError(
            f"options.feet: {robot.name} names no links in its group 'feet'; list the planted links"
            + (f" (lowest at the start: {lowest})" if lowest else "")
        )
    with_shape = {body.link for body in robot.bodies}
    problems = find_unknown_links(robot, feet, "options.feet") or [
        f"options.feet: link {foot!r} has no collision shape to stand on; {', '.join(sorted(with_shape))} have"
        for foot in feet
        if foot not in with_shape
    ]
    if problems:
        raise RequestError(problems)
    return feet


def check_start(
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    scene: Scene,
    soles: Mapping[str, np.ndarray],
    request: PlanRequest,
    program: Program | None,
    stance: ContactStance | None = None,
) -> StartCheck:
    """Check that the robot is balanced and collision-free at its start, or may escape from the collision.

    A robot that stands on given contacts may touch what is behind them; the planner finds out whether they hold it.

    Raises:
        RequestError: the start is out of balance, or in collision without permission or possibility to escape.
    """
    if stance is not None:
        return _check_stance_start(robot, start, scene, stance)
    is_balanced = (program is None or program.is_balanced) and robot.can_balance
    feet = {link: sole for link, sole in soles.items() if is_balanced or link in robot.link_groups.get(FEET_GROUP, ())}
    grounded = dict(find_ground_problems(scene.pieces, feet)) if robot.is_floating else {}
    carried = [item.name for item in request.attached] if program is None else []
    rests = find_rests(robot, start, scene.pieces, carried)
    # A sole inside the floor is reported only once, as a floor that is too high.
    inside, near = (
        [overlap for overlap in overlaps if overlap.kind != FLOOR_KIND or overlap.link not in grounded]
        for overlaps in find_overlaps_and_unresolved(robot, start, scene, tuple(soles), rests)
    )
    may_leave = program is None and request.options.escape
    dead_ends = [describe_dead_end(overlap, tuple(soles)) for overlap in inside]
    if may_leave:
        stuck = [(overlap, reason) for overlap, reason in zip(inside, dead_ends, strict=True) if reason]
        problems = [f"start is in collision: {overlap}; {reason}" for overlap, reason in stuck]
    else:
        problems = [f"start is in collision: {overlap}" for overlap in inside]
        if not robot.source.srdf and any(overlap.kind is None for overlap in inside):
            problems.append(
                f"{robot.name} has no SRDF; if its links overlap at rest, `scopt robots check URDF --write-srdf FILE` "
                "lists the pairs and writes an SRDF that leaves them out"
            )
        touching = (name for o in inside for name in ((o.link, o.other) if o.kind is None else (o.link,)))
        problems += suggest_split(robot, request.robot.decompose, touching)
        if inside and program is None and not any(dead_ends):
            problems.append("options.escape: false; true would plan a way out of the collision first")
    if problems and request.scene.file is not None:
        problems.append(OWN_POINTS)
    if soles and not is_balanced:
        problems += [f"start is not on the ground: {line}" for line in grounded.values()]
    elif soles:
        off_ground = list(grounded.values())
        if not robot.is_floating:  # a fixed base needs no ground, the feet that it plants do
            off_ground = [line for _, line in find_ground_problems(scene.pieces, soles)]
        lines = find_standing_problems(robot, start, soles, off_ground)
        problems += [f"start is out of balance: {line}" for line in lines]
    if program is None and request.options.timed:
        problems += find_overloaded_joints(robot, start, "start", tuple(soles))
        end = _read_whole_goal(robot, start, request)
        if end is not None and not robot.is_floating:
            problems += find_overloaded_joints(robot, end, "goal", tuple(soles))
    if problems:
        raise RequestError(problems)
    may_leave = may_leave and not any(describe_dead_end(overlap, tuple(soles)) for overlap in near)
    overlaps = tuple(find_hull_overlaps(robot, start, scene, tuple(soles), rests)) if may_leave else ()
    too_near = tuple(f"the start is too near to plan from: {overlap.nearness}" for overlap in near)
    if not overlaps:
        return StartCheck((), too_near, (), rests)
    left = (*(f"start is in collision: {overlap}" for overlap in inside), *too_near)
    return StartCheck(overlaps, (), tuple(f"{line}; the first phase leaves it" for line in left), rests)


def find_overloaded_joints(
    robot: RobotModel, q: Float[np.ndarray, "n"], where: str, planted: tuple[str, ...]
) -> list[str]:
    """Return a line about joints that cannot hold the robot at a configuration, if there are any.

    No time law makes such a motion possible, however slow. Joints between the base and planted links are left out: what
    they carry depends on the forces at these links.
    """
    weak, torque = _measure_overload(robot, q, planted)
    if not weak:
        return []
    listed = f"{', '.join(weak[:MOST_NAMED])}{', …' if len(weak) > MOST_NAMED else ''}"
    return [
        f"{where}: {_describe_worst(robot, weak, torque)}; if springs or a balance carry that, leave the torque out "
        f"with robot.torque: {{unchecked: [{listed}]}} or {{check: false}}"
    ]


def describe_overload(robot: RobotModel, q: Float[np.ndarray, "n"], planted: tuple[str, ...]) -> str | None:
    """Return what the joint that is overloaded most needs at a configuration at rest, as above; None where none is."""
    weak, torque = _measure_overload(robot, q, planted)
    return _describe_worst(robot, weak, torque) if weak else None


def _measure_overload(
    robot: RobotModel, q: Float[np.ndarray, "n"], planted: tuple[str, ...]
) -> tuple[list[str], Float[np.ndarray, "n"]]:
    """Return the joints that need more than their limit at rest, and the torques of all."""
    still = np.zeros(robot.n)
    torque = np.abs(pin.rnea(robot.model, borrow_data(robot.model), q, still, still))
    torque[_list_carrying(robot, planted)] = 0.0
    return [robot.joint_names[k] for k in np.flatnonzero((robot.effort > 0.0) & (torque > robot.effort))], torque


def _describe_worst(robot: RobotModel, weak: Sequence[str], torque: Float[np.ndarray, "n"]) -> str:
    """Return what the joint that exceeds its limit most needs."""
    columns = [robot.joint_names.index(name) for name in weak]
    worst = columns[int(np.argmax(torque[columns] / robot.effort[columns]))]
    unit = "N" if is_sliding(robot, robot.joint_names[worst]) else "N m"
    return (
        f"{robot.joint_names[worst]} needs {torque[worst]:.4g} {unit} at rest, its effort limit is "
        f"{robot.effort[worst]:.4g} {unit}"
    )


def _list_carrying(robot: RobotModel, planted: tuple[str, ...]) -> list[int]:
    """Return the coordinates of a floating base and of the joints between it and planted links."""
    model = robot.model
    carrying = set(range(len(BASE_NAMES))) if robot.is_floating else set[int]()
    for link in planted:
        joint = int(model.frames[model.getFrameId(link)].parentJoint)
        for above in model.supports[joint]:
            first = int(model.joints[above].idx_v)
            carrying |= set(range(first, first + int(model.joints[above].nv)))
    return sorted(k for k in carrying if 0 <= k < robot.n)


def _read_whole_goal(
    robot: RobotModel, start: Float[np.ndarray, "n"], request: PlanRequest
) -> Float[np.ndarray, "n"] | None:
    """Return the configuration of a goal that says where every joint is; None for any other."""
    if request.goal is None or request.goal.poses:
        return None
    joints = find_goal_joints(robot, request.goal, start)
    if len(joints) < robot.n:
        return None
    end = start.copy()
    end[list(joints)] = list(joints.values())
    return end


def _check_stance_start(
    robot: RobotModel, start: Float[np.ndarray, "n"], scene: Scene, stance: ContactStance
) -> StartCheck:
    """Check a start on given contacts for collisions.

    Raises:
        RequestError: one line per pair in collision.
    """
    touching = {(contact.planted.link, piece) for contact in stance.contacts for piece in contact.surface.pieces}
    planted = tuple(link for link, _ in touching)
    inside, near = (
        [o for o in overlaps if (o.link, o.other) not in touching or o.depth > STANDING_DEPTH_M]
        for overlaps in find_overlaps_and_unresolved(robot, start, scene, planted)
    )
    if inside:
        raise RequestError([f"start is in collision: {overlap}" for overlap in inside])
    return StartCheck((), tuple(f"the start is too near to plan from: {overlap.nearness}" for overlap in near), ())
