"""A request made real: the robot at its start, the scene around it, and the proof that it can stand there."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jaxtyping import Float

from costs.robot import RobotError, RobotModel, load_robot
from costs.scene import Scene
from costs.stopping import Stopped, poll, stops_when
from service.body.holds import KeptPose, make_kept_poses
from service.demands import compose_scene
from service.errors import RequestError, would_do
from service.request.names import TakenNames, check_names
from service.request.schema import PlanRequest
from service.setup.units import find_unit_problems, note_far_obstacles
from service.setup.world import NOTHING, Surroundings, build_obstacles, read_surroundings
from service.start.attached import attach_bodies
from service.start.configuration import find_limit_violations, find_unknown_joints, make_start
from service.start.overlaps import Overlap, describe_dead_end, find_hull_overlaps, find_overlaps_and_unresolved
from service.start.standing import (
    FEET_GROUP,
    FLOOR_KIND,
    check_masses,
    find_ground_problems,
    find_standing_problems,
    move_floor_to_soles,
    sole_corners,
)

if TYPE_CHECKING:
    from perception import Perceived
    from service.trajopt import Program

T = TypeVar("T")
OWN_POINTS = "scene.file: where the robot stood in the scan, `scopt scene --robot NAME` leaves its own points out"


@dataclass(frozen=True)
class PlanSetup:
    """What every task starts from.

    Attributes:
        request: the request it was made from.
        robot: the robot.
        start: (n,) start configuration, within the limits.
        scene: all pieces, the floor's included.
        surroundings: what the scan, or the scene's file, showed.
        soles: for each planted link, the corners of its sole in the world at the start [m].
        kept: relative poses that hold along the whole motion.
        program: the problem file that is to be solved, or None.
        overlaps: what the hulls of the robot are in at its start, to be left first.
        unresolved: sentences about what the robot is clear of at its start while the hulls that stand for them
            overlap, so that nothing can be certified there.
        notes: what was assumed, snapped or noticed.
        timings: seconds by step.
        is_stopped: whether it was to stop before all of the scene was there; the scene is then empty.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene
    surroundings: Surroundings
    soles: Mapping[str, Float[np.ndarray, "C 3"]]
    kept: tuple[KeptPose, ...]
    program: Program | None
    overlaps: tuple[Overlap, ...]
    notes: tuple[str, ...]
    timings: Mapping[str, float]
    is_stopped: bool = False
    unresolved: tuple[str, ...] = ()

    @property
    def contacts(self) -> tuple[str, ...]:
        """The links planted at the start."""
        return tuple(self.soles)


def prepare(
    request: PlanRequest,
    on_step: Callable[[str], None] | None = None,
    robot: RobotModel | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    see: Callable[..., Perceived] | None = None,
) -> PlanSetup:
    """Load the robot, read the scan, and check the request against both.

    Args:
        request: the request.
        on_step: told the name of each step before it begins.
        robot: the request's robot where it is at hand already; else it is loaded.
        should_stop: asked while the scene is made; once it says so, what comes back ``is_stopped``.
        see: ``perceive``, or what remembers its results.

    Raises:
        RequestError: one line per problem: files, names, limits, a start in collision or out of balance.
    """
    say = on_step or (lambda step: None)
    timings: dict[str, float] = {}
    say("load robot")
    if robot is None:
        robot = _timed(timings, "load_robot", lambda: load_requested_robot(request))
    robot = attach_bodies(robot, request)
    check_masses(robot)
    return _prepare(request, robot, say, timings, should_stop, see)


def _prepare(
    request: PlanRequest,
    robot: RobotModel,
    say: Callable[[str], None],
    timings: dict[str, float],
    should_stop: Callable[[], bool],
    see: Callable[..., Perceived] | None,
) -> PlanSetup:
    check_names(request, robot, TakenNames.of(robot, request))
    start, notes, program = resolve_start(robot, request)
    _check_goal(robot, request)
    problems = find_unit_problems(request, robot, start)
    if problems:
        raise RequestError(problems)
    notes += note_far_obstacles(request, robot, start)
    kept = _kept(robot, start, request)
    soles = _soles(robot, start, request, program)
    say("perceive scene")
    try:
        with stops_when(should_stop):
            poll()
            about = _timed(timings, "perceive", lambda: read_surroundings(request, robot, start, soles, see))
            obstacles = _timed(timings, "build_scene", lambda: build_obstacles(request, about.matches))
    except Stopped:
        empty = Scene(())
        return PlanSetup(
            request, robot, start, empty, NOTHING, soles, kept, program, (), notes, timings, is_stopped=True
        )
    pieces, shifted = move_floor_to_soles(about.pieces, soles)
    scene, renamed = compose_scene(request, robot, start, pieces, obstacles.pieces)
    say("check start")
    check = partial(_check_start, robot, start, scene, soles, request, program)
    leaving, inside, near = _timed(timings, "check_start", check)
    notes += tuple(f"{line}; the first phase leaves it" for line in (*inside, *near) if leaving)
    notes += obstacles.notes + about.notes + shifted + renamed
    unresolved_now = () if leaving else near
    return PlanSetup(
        request, robot, start, scene, about, soles, kept, program, leaving, notes, timings, unresolved=unresolved_now
    )


def resolve_start(
    robot: RobotModel, request: PlanRequest
) -> tuple[Float[np.ndarray, "n"], tuple[str, ...], Program | None]:
    """Start configuration, notes about it, and the problem file that may say more of it."""
    if request.task is None or request.task.trajopt is None:
        return *make_start(robot, request.start), None
    from service.trajopt import requested_program, requested_start  # takes a while, and few requests need it

    start, notes = make_start(robot, requested_start(request, robot))
    program = requested_program(request, robot, start)
    return (start if program is None else program.start), notes, program


def _timed(timings: dict[str, float], step: str, run: Callable[[], T]) -> T:
    started = time.perf_counter()
    try:
        return run()
    finally:
        timings[step] = time.perf_counter() - started


def load_requested_robot(request: PlanRequest) -> RobotModel:
    """The robot that a request names or points to.

    Raises:
        RequestError: its files are missing or cannot be used.
    """
    robot = request.robot
    try:
        if robot.urdf is None:
            return load_robot(robot.name, root=robot.root, tool_distance_m=robot.tool_distance_m)
        return load_robot(
            urdf=_existing(request, robot.urdf, "robot.urdf"),
            srdf=None if robot.srdf is None else _existing(request, robot.srdf, "robot.srdf"),
            package_dirs=[request.resolve(folder) for folder in robot.package_dirs],
            root=robot.root,
        )
    except RobotError as error:
        raise RequestError(f"robot: {error}") from None


def _existing(request: PlanRequest, path: str, field: str) -> Path:
    resolved = request.resolve(path)
    if not resolved.is_file():
        raise RequestError(f"{field}: {resolved} is not there; paths start at the request's folder")
    return resolved


def _check_goal(robot: RobotModel, request: PlanRequest) -> None:
    goal = request.goal
    if goal is None:
        return
    problems = find_unknown_joints(robot, goal.joints, "goal.joints")
    if not problems:
        problems = find_limit_violations(robot, goal.joints, "goal.joints")
    if goal.posture is not None and goal.posture not in robot.postures:
        known = would_do(goal.posture, robot.postures) or "no postures; give goal.joints"
        problems.append(f"unknown posture {goal.posture!r} in goal.posture; {robot.name} has {known}")
    for index, pose in enumerate(goal.poses):
        problems += _unknown_links(robot, (pose.link,), f"goal.poses[{index}].link")
    if problems:
        raise RequestError(problems)


def _kept(robot: RobotModel, start: Float[np.ndarray, "n"], request: PlanRequest) -> tuple[KeptPose, ...]:
    problems: list[str] = []
    for index, keep in enumerate(request.keep):
        problems += _unknown_links(robot, (keep.link,), f"keep[{index}].link")
        if keep.relative_to is not None:
            problems += _unknown_links(robot, (keep.relative_to,), f"keep[{index}].relative_to")
    if problems:
        raise RequestError(problems)
    return make_kept_poses(robot, start, request.keep)


def _unknown_links(robot: RobotModel, links: tuple[str, ...], field: str) -> list[str]:
    frames = [frame.name for frame in robot.model.frames if frame.name != "universe"]
    return [
        f"unknown link {link!r} in {field}; {robot.name} has {would_do(link, frames)}"
        for link in links
        if link not in frames
    ]


def _soles(
    robot: RobotModel, start: Float[np.ndarray, "n"], request: PlanRequest, program: Program | None
) -> dict[str, np.ndarray]:
    if program is not None:
        return {foot: sole_corners(robot, start, foot) for foot in program.planted}
    feet = request.options.feet
    if not robot.is_floating:
        if feet:
            raise RequestError("options.feet: this robot's base is fixed and plants no feet; leave it out")
        return {}
    if feet == ():
        raise RequestError("options.feet: lists no link; name the planted links, or leave it out for the robot's own")
    if feet is None:
        feet = robot.link_groups.get(FEET_GROUP, ())
    if not feet:
        raise RequestError(f"options.feet: {robot.name} names no links in its group 'feet'; list the planted links")
    bodied = {body.link for body in robot.bodies}
    problems = _unknown_links(robot, feet, "options.feet") or [
        f"options.feet: link {foot!r} has no collision shape to stand on; {', '.join(sorted(bodied))} have"
        for foot in feet
        if foot not in bodied
    ]
    if problems:
        raise RequestError(problems)
    return {foot: sole_corners(robot, start, foot) for foot in feet}


def _check_start(
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    scene: Scene,
    soles: Mapping[str, np.ndarray],
    request: PlanRequest,
    program: Program | None,
) -> tuple[tuple[Overlap, ...], tuple[str, ...], tuple[str, ...]]:
    """Overlaps of hulls at the start that are to be left first; what it is in, and what it is too near to, in words.

    Raises:
        RequestError: the start is in collision and may not escape, or cannot; or it is out of balance.
    """
    problems = []
    is_balanced = program is None or program.is_balanced
    feet = {link: sole for link, sole in soles.items() if is_balanced or link in robot.link_groups.get(FEET_GROUP, ())}
    grounded = dict(find_ground_problems(scene.pieces, feet)) if robot.is_floating else {}
    # A sole in the floor is told once, as a floor too high.
    inside, near = (
        [one for one in pairs if one.kind != FLOOR_KIND or one.link not in grounded]
        for pairs in find_overlaps_and_unresolved(robot, start, scene, tuple(soles))
    )
    may_leave = program is None and request.options.escape
    obstacles = [describe_dead_end(one, tuple(soles)) for one in inside]
    if not may_leave:
        problems = [f"start is in collision: {one}" for one in inside]
        if inside and program is None and not any(obstacles):
            problems.append("options.escape: false; true would plan a way out of the collision first")
    else:
        stuck = [(one, obstacle) for one, obstacle in zip(inside, obstacles, strict=True) if obstacle]
        problems = [f"start is in collision: {one}; {obstacle}" for one, obstacle in stuck]
    if problems and request.scene.file is not None:
        problems.append(OWN_POINTS)
    if soles and not is_balanced:
        problems += [f"start is not on the ground: {line}" for line in grounded.values()]
    elif soles:
        problems += [f"start is out of balance: {line}" for line in find_standing_problems(robot, start, scene, soles)]
    if problems:
        raise RequestError(problems)
    if any(describe_dead_end(one, tuple(soles)) for one in near):
        may_leave = False
    return (
        tuple(find_hull_overlaps(robot, start, scene, tuple(soles))) if may_leave else (),
        tuple(f"start is in collision: {one}" for one in inside),
        tuple(f"the start is too near to plan from: {one.nearness}" for one in near),
    )
