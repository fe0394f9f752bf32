"""Preparation of a request: the checked robot, start and scene from which every task plans."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.progress import tells_progress
from costs.robot import RobotModel
from costs.scene import Scene
from costs.stopping import Stopped, poll, stops_when
from service.body.kept import Kept, make_kept_poses
from service.body.sampling import can_sample
from service.demands import World, check_padding, compose_scene
from service.demands.contacts.stances import ContactStance
from service.demands.kind import ResolvedStart, find_demand_part
from service.errors import RequestError
from service.request.names import TakenNames, check_names
from service.request.schema import PlanRequest
from service.setup.carried_meshes import inline_carried
from service.setup.checks import StartCheck, check_names_and_values, check_start, find_soles
from service.setup.given_objects import check_given_objects
from service.setup.rates import check_rates
from service.setup.units import check_units
from service.setup.world import NOTHING, Surroundings, build_obstacles, read_surroundings
from service.start.configuration import note_snapped, note_turns
from service.start.mechanism_file import inline_mechanisms
from service.start.overlaps import Overlap
from service.start.robot import attach_bodies, load_requested_robot
from service.start.standing import check_masses, move_floor_to_soles

if TYPE_CHECKING:
    from perception import Perceived
    from service.trajopt import Program


@dataclass(frozen=True)
class PlanSetup:
    """Prepared request, the input of every task's planner.

    Attributes:
        request: the request.
        robot: the robot, with the bodies it carries.
        start: (n,) start configuration, within the limits.
        scene: all pieces, including the floor.
        surroundings: pieces and objects of the scan or scene file.
        soles: (C, 3) sole corners of each planted link in the world at the start [m].
        kept: relative poses that are kept along the whole motion.
        program: the TrajOpt problem to solve, or None.
        overlaps: hulls that overlap at the start and must be separated first.
        known: (T, n) waypoints of an earlier motion to begin the search with, or None.
        rests: carried bodies and the pieces on which they rest, from which they must be raised first.
        unresolved: sentences about pairs that are apart at the start but whose hulls overlap, so that they cannot be
            certified there.
        notes: assumptions and warnings for the user.
        timings: seconds by step.
        is_stopped: whether preparation was stopped before the scene was complete; the scene is then empty.
        stances: of a task that changes contacts, that of the start first.
    """

    request: PlanRequest
    robot: RobotModel
    start: Float[np.ndarray, "n"]
    scene: Scene
    surroundings: Surroundings
    soles: Mapping[str, Float[np.ndarray, "C 3"]]
    kept: tuple[Kept, ...]
    program: Program | None
    overlaps: tuple[Overlap, ...]
    notes: tuple[str, ...]
    timings: Mapping[str, float]
    is_stopped: bool = False
    unresolved: tuple[str, ...] = ()
    stances: tuple[ContactStance, ...] = ()
    rests: tuple[tuple[str, str], ...] = ()
    known: Float[np.ndarray, "T n"] | None = None

    @property
    def contacts(self) -> tuple[str, ...]:
        """Links planted at the start."""
        return tuple(self.soles)


def prepare(
    request: PlanRequest,
    on_step: Callable[[str], None] | None = None,
    robot: RobotModel | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    see: Callable[..., Perceived] | None = None,
    *,
    around: Surroundings | None = None,
    checks_start: bool = True,
    finds_package: bool = False,
) -> PlanSetup:
    """Load the robot, read the scan, and check the request against robot and scan.

    Args:
        request: the request.
        on_step: called with the name of each step before it begins.
        robot: the request's robot if it is already loaded.
        should_stop: polled while the scene is made; once it returns True, the result ``is_stopped``.
        see: ``perception.perceive``, or a function that caches its results.
        around: what the request's scan shows, if it is known already.
        checks_start: whether to refuse a start in collision or out of balance.
        finds_package: see ``load_requested_robot``.

    Raises:
        RequestError: one line per problem: files, names, limits, a start in collision or out of balance.
    """
    request = inline_carried(inline_mechanisms(request))
    announce = on_step or (lambda step: None)
    timings: dict[str, float] = {}
    announce("load robot")
    if robot is None:
        with _timed(timings, "load_robot"):
            robot = load_requested_robot(request, finds_package=finds_package)
    robot = attach_bodies(robot, request)
    weightless = check_masses(robot, holds_something=request.task is not None)
    check_names(request, robot, TakenNames.of(robot, request))
    resolved = _resolve_and_check(robot, request)
    start, notes, program = resolved.q, resolved.notes, resolved.program
    if request.goal is not None:
        joints = request.goal.joints
        notes += (*note_turns(robot, joints, "goal.joints"), *note_snapped(robot, joints, "goal"))
    notes += (*weightless, *robot.notes, *_note_carried(request), *check_units(request, robot, start))
    notes += tuple(_note_sampling())
    kept = make_kept_poses(robot, start, request.keep)
    soles = find_soles(robot, start, request, program)
    check_rates(robot, start, request, soles)
    announce("perceive scene")
    try:
        with stops_when(should_stop):
            poll()
            with _timed(timings, "perceive"):
                if around is None:
                    with tells_progress(lambda step: announce(f"perceive scene: {step}")):
                        around = read_surroundings(request, robot, start, soles, see)
            with _timed(timings, "build_scene"):
                obstacles, obstacle_notes = build_obstacles(request, around.matches)
    except Stopped:
        nothing = Scene(())
        return PlanSetup(
            request, robot, start, nothing, NOTHING, soles, kept, program, (), notes, timings, is_stopped=True
        )
    check_given_objects(request, robot, start, obstacles)
    pieces, moved = move_floor_to_soles(around.pieces, soles)
    scene, renamed = compose_scene(request, robot, start, pieces, obstacles)
    check_padding(request.options.padding, robot, scene)
    stances = find_demand_part(request).list_stances(request.section, World(request, robot, start, scene))
    announce("check start")
    with _timed(timings, "check_start"):
        nothing_checked = StartCheck((), (), ())
        first = stances[0] if stances else None
        check = check_start(robot, start, scene, soles, request, program, first) if checks_start else nothing_checked
    return PlanSetup(
        request,
        robot,
        start,
        scene,
        around,
        soles,
        kept,
        program,
        check.overlaps,
        (*notes, *check.notes, *obstacle_notes, *around.notes, *moved, *renamed),
        timings,
        unresolved=check.unresolved,
        stances=stances,
        rests=check.rests,
    )


def _note_sampling() -> Iterator[str]:
    """Yield a sentence where the search lacks what samples its paths."""
    if not can_sample():
        yield "OMPL is not installed: no path is sampled around obstacles (pip install ompl)"


def _note_carried(request: PlanRequest) -> Iterator[str]:
    """Yield a sentence per carried body: nothing proves the grip that holds it."""
    for item in request.attached:
        holds, them = ("hold", "their grip is") if item.touches else ("holds", "its grip is")
        links = " and ".join((item.link, *item.touches))
        yield f"attached '{item.name}': that {links} {holds} it is assumed; {them} not proven"


def _resolve_and_check(robot: RobotModel, request: PlanRequest) -> ResolvedStart:
    """Return the start, as the kind of the request resolves it.

    Raises:
        RequestError: the problems of the start, the goal and ``keep`` together.
    """
    problems: list[str] = []
    resolved = None
    try:
        resolved = find_demand_part(request).resolve_start(request.section, request, robot)
    except RequestError as error:
        problems += error.problems
    try:
        check_names_and_values(robot, request)
    except RequestError as error:
        problems += error.problems
    if resolved is None or problems:
        raise RequestError(problems)
    return resolved


@contextmanager
def _timed(timings: dict[str, float], step: str) -> Iterator[None]:
    started = time.perf_counter()
    try:
        yield
    finally:
        timings[step] = time.perf_counter() - started
