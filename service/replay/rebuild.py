"""Demands of a result's request, rebuilt for the verifier: robot, start and scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, bundled_robots
from costs.scene import ConvexPiece, Scene
from service.demands import (
    Demands,
    compose_scene,
    find_recorded_obstacles,
    has_scan,
    list_planted_feet,
)
from service.demands.door.demand import SeenDoor
from service.demands.kind import find_demand_part
from service.demands.task_demand import World
from service.errors import RequestError
from service.request.file import replace_clouds
from service.request.scene import MeshRequest
from service.request.schema import PlanRequest
from service.request.tasks.registry import ADDED
from service.setup.carried_meshes import inline_carried
from service.setup.given_objects import check_given_objects
from service.setup.prepare import PlanSetup
from service.setup.world import Surroundings, build_obstacles, read_surroundings
from service.start.mechanism_file import inline_mechanisms
from service.start.robot import add_request_parts, attach_bodies, load_requested_robot
from service.start.robot_report import name_base
from service.start.standing import move_floor_to_soles, sole_corners

if TYPE_CHECKING:
    from perception import LeverDetection, SeenPart, ValveDetection
    from service.trajopt import Program

_BASES = {  # bases of a robot that a request for each may find; joints of a fixed one's files may be those of a base
    "floating": ("floating",),
    "planar": ("planar", "differential"),
    "differential": ("differential",),
    "fixed": ("fixed", "planar", "differential"),
}


@dataclass(frozen=True)
class Grounds:
    """Sources of a verification, as phrases that follow "for".

    Attributes:
        request: source of the demands.
        scene: source of the pieces.
        robot: source of the robot.
        without: constraints of the request that the verifier cannot check.
        reader: package outside this project that says what the task demands, or None.
        hits: objects that a scan shows which was read again; None where none was.
    """

    request: str
    scene: str
    robot: str
    without: tuple[str, ...] = ()
    reader: str | None = None
    hits: tuple[Mapping[str, Any], ...] | None = None

    def sentence(self) -> str:
        """Return the phrase for the verdict's line; equal sources are named once."""
        sources = dict.fromkeys((self.request, self.robot, self.scene))
        without = f", without {', '.join(self.without)}" if self.without else ""
        reader = "" if self.reader is None else f", with the demands of {self.reader}"
        return f"for {' and '.join(sources)}{without}{reader}"


@dataclass(frozen=True)
class RecordedWorld:
    """Robot and scene of a result's folder.

    Attributes:
        robot: the robot, without the joints that the task moves.
        scene: its pieces.
        valves: valves detected in the scan; the first is the task's.
        doors: doors detected in the scan; the first is the task's.
        seen: parts of the task's valve or door that the scan shows.
    """

    robot: RobotModel
    scene: Scene
    valves: tuple[ValveDetection | LeverDetection, ...] = ()
    doors: tuple[SeenDoor, ...] = ()
    seen: tuple[SeenPart, ...] = ()


def rebuild_demands(
    request: PlanRequest, record: RecordedWorld, given: Path | None, clouds: Sequence[Path]
) -> tuple[Demands, Grounds]:
    """Return a request's demands and their sources.

    Args:
        request: the user's or the folder's request.
        record: robots given by path and scans, unless they are read again.
        given: file of the user's request, whose files are then read again; None for the folder's request.
        clouds: cloud files (or the scene's file) of the request, to be read again.

    Raises:
        RequestError: the request, or a file that it names, cannot be used.
    """
    request = inline_carried(inline_mechanisms(request))
    request_from = "the request in this folder" if given is None else given.name
    robot, robot_from = _rebuild_robot(request, record, given is not None, request_from)
    resolved = find_demand_part(request).resolve_start(request.section, request, robot)
    start, program = resolved.q, resolved.program
    feet = list_planted_feet(robot, request.options.feet) if program is None else program.planted
    is_read = bool(clouds) or (given is not None and request.scene.file is not None)
    surroundings = Surroundings(
        select_scanned(request, record.scene), record.valves, doors=record.doors, seen=record.seen
    )
    scene_from = request_from
    if is_read:
        surroundings = _read_scan(request, robot, start, feet, clouds)
        scene_from = ", ".join(path.name for path in clouds) or str(request.scene.file)
    elif has_scan(request):
        scene_from = "the recorded scene"
    obstacles, are_recorded = _rebuild_obstacles(request, record.scene, surroundings, given is not None)
    check_given_objects(request, robot, start, obstacles)
    scene, _ = compose_scene(request, robot, start, surroundings.pieces, obstacles)
    scene_from = "the recorded scene" if are_recorded else scene_from
    demands = _make_demands(World(request, robot, start, scene), surroundings, program)
    reader = None if request.kind not in ADDED else request.kind.demand.partition(":")[0]
    hits = surroundings.list_hits() if is_read else None
    return demands, Grounds(request_from, scene_from, robot_from, demands.task.unproven, reader, hits)


def make_setup_demands(setup: PlanSetup) -> Demands:
    """Return the demands of a prepared request.

    Raises:
        RequestError: the scan does not show what the task moves.
    """
    world = World(setup.request, setup.robot, setup.start, setup.scene)
    return _make_demands(world, setup.surroundings, setup.program)


def _make_demands(world: World, surroundings: Surroundings, program: Program | None) -> Demands:
    part, section = find_demand_part(world.request), world.request.section
    return Demands(world, part.make_demand(section, world, surroundings, program))


def _rebuild_robot(
    request: PlanRequest, record: RecordedWorld, is_given: bool, request_from: str
) -> tuple[RobotModel, str]:
    """Return the robot and its source; only a user's request has robot files read again."""
    if is_given or (request.robot.urdf is None and request.robot.name in bundled_robots()):
        return attach_bodies(load_requested_robot(request, finds_package=is_given), request), request_from
    asked, found = request.robot.root or "fixed", name_base(record.robot)
    if found not in _BASES[asked]:
        raise RequestError(f"robot.root: {asked}; the robot in this folder has a {found} base, expected {asked}")
    links = {body.link for body in record.robot.bodies}
    missing = [attached.name for attached in request.attached if attached.name not in links]
    if missing:
        raise RequestError(f"attached: the robot in this folder does not carry {', '.join(missing)}")
    return add_request_parts(record.robot, request), "the robot in this folder"


def select_scanned(request: PlanRequest, recorded: Scene) -> tuple[ConvexPiece, ...]:
    """Return the pieces of a recorded scene that come from its scan."""
    if not has_scan(request):
        return ()
    own = {obstacle.name for obstacle in request.scene.obstacles}
    mechanisms = find_demand_part(request).read_mechanisms(request.section)
    own |= {piece.name for given in mechanisms for piece in given.pieces}
    parts = {piece.name for piece in find_recorded_obstacles(request, recorded)}
    return tuple(piece for piece in recorded.pieces if piece.name not in own | parts)


def _read_scan(
    request: PlanRequest,
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    feet: Sequence[str],
    clouds: Sequence[Path],
) -> Surroundings:
    soles = {foot: sole_corners(robot, start, foot) for foot in feet}
    if clouds:
        request = replace_clouds(request, clouds)
    surroundings = read_surroundings(request, robot, start, soles, None)
    return replace(surroundings, pieces=move_floor_to_soles(surroundings.pieces, soles)[0])


def _rebuild_obstacles(
    request: PlanRequest, recorded: Scene, surroundings: Surroundings, is_given: bool
) -> tuple[tuple[ConvexPiece, ...], bool]:
    """Return the request's obstacles in its order, and whether meshes had to be taken from the record."""
    obstacles, matches = request.scene.obstacles, surroundings.matches
    meshes = [obstacle for obstacle in obstacles if isinstance(obstacle, MeshRequest)]
    if not meshes or (is_given and all(mesh.name in matches for mesh in meshes if mesh.match)):
        return build_obstacles(request, matches)[0], False
    shapes = tuple(obstacle for obstacle in obstacles if not isinstance(obstacle, MeshRequest))
    pieces = build_obstacles(replace(request, scene=replace(request.scene, obstacles=shapes)))[0]
    return (*pieces, *find_recorded_obstacles(request, recorded)), True
