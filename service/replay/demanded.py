"""The request of a result made real once more, for the verifier: its robot, start and scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, bundled_robots
from costs.scene import ConvexPiece, Scene
from service.demands import Demands, ProgramDemand, compose_scene, find_recorded_obstacles, has_scan, list_planted_feet
from service.demands.wheel import Wheel, make_wheel
from service.errors import RequestError
from service.request.file import replace_clouds
from service.request.scene import MeshRequest
from service.request.schema import PlanRequest
from service.setup.prepare import resolve_start
from service.setup.world import Surroundings, build_obstacles, read_surroundings
from service.start.robot import attach_bodies, load_requested_robot
from service.start.standing import move_floor_to_soles, sole_corners

if TYPE_CHECKING:
    from perception import ValveDetection
    from service.trajopt import Program


@dataclass(frozen=True)
class Grounds:
    """What a verification rests on, in words that follow "for".

    Attributes:
        request: whose demands the motion was held to.
        scene: where the pieces came from.
        robot: where the robot came from.
        without: constraints of the request that the verifier cannot hold a motion to.
    """

    request: str
    scene: str
    robot: str
    without: tuple[str, ...] = ()

    def sentence(self) -> str:
        """As the verdict's line says it; what the request itself holds is not named again."""
        named = dict.fromkeys((self.request, self.robot, self.scene))
        without = f", without {', '.join(self.without)}" if self.without else ""
        return f"for {' and '.join(named)}{without}"


@dataclass(frozen=True)
class Record:
    """What a result's folder says of the world.

    Attributes:
        robot: read from the folder, without what the task moves.
        scene: its pieces.
        valves: the valves that were found in the scan, the one that is turned first.
    """

    robot: RobotModel
    scene: Scene
    valves: tuple[ValveDetection, ...] = ()


def rebuild_demands(
    request: PlanRequest, record: Record, given: Path | None, clouds: Sequence[Path]
) -> tuple[Demands, Grounds]:
    """What a request demands, and what that rests on.

    Args:
        request: as the user gives it, or as the folder holds it.
        record: for what the request alone does not tell: robots by path and scans.
        given: the request's file where the user gives it; its files are then read again.
        clouds: the cloud files (or the scene's file) of the request, to be looked at again.

    Raises:
        RequestError: the request, or a file that it names, cannot be used.
    """
    whose = "the request in this folder" if given is None else given.name
    robot, robot_from = _robot(request, record, given is not None, whose)
    start, _, program = resolve_start(robot, request)
    feet = list_planted_feet(robot, request.options.feet) if program is None else program.planted
    is_read = bool(clouds) or (given is not None and request.scene.file is not None)
    about, scene_from = Surroundings(_seen(request, record.scene), record.valves), whose
    if is_read:
        about = _look_again(request, robot, start, feet, clouds)
        scene_from = ", ".join(path.name for path in clouds) or str(request.scene.file)
    elif has_scan(request):
        scene_from = "the recorded scene"
    obstacles, are_recorded = _obstacles(request, record.scene, about, given is not None)
    scene, _ = compose_scene(request, robot, start, about.pieces, obstacles)
    scene_from = "the recorded scene" if are_recorded else scene_from
    demands = Demands(request, robot, start, scene, _program(program, robot), _wheel(request, about.valves))
    without = () if demands.program is None else demands.program.unproven
    return demands, Grounds(whose, scene_from, robot_from, without)


def _program(program: Program | None, robot: RobotModel) -> ProgramDemand | None:
    if program is None:
        return None
    from service.trajopt.verifier_targets import make_program_demand  # takes a while, and few requests need it

    return make_program_demand(program, robot)


def _wheel(request: PlanRequest, seen: Sequence[ValveDetection]) -> Wheel | None:
    """The wheel that the request has turned."""
    task = None if request.task is None else request.task.valve
    if task is None:
        return None
    from service.tasks.valve_task import read_given_valve

    valve = read_given_valve(task) or next(iter(seen), None)
    if valve is None:
        raise RequestError("task.valve: the scene shows no valve")
    return make_wheel(valve)


def _robot(request: PlanRequest, record: Record, is_given: bool, whose: str) -> tuple[RobotModel, str]:
    """The robot made anew, and where it came from; its files are read again only with a request that the user gives."""
    wanted = request.robot
    if is_given or (wanted.urdf is None and wanted.name in bundled_robots()):
        return attach_bodies(load_requested_robot(request), request), whose
    missing = [one.name for one in request.attached if one.name not in {body.link for body in record.robot.bodies}]
    if missing:
        raise RequestError(f"attached: the robot in this folder does not carry {', '.join(missing)}")
    return record.robot, "the robot in this folder"


def _seen(request: PlanRequest, recorded: Scene) -> tuple[ConvexPiece, ...]:
    """Pieces of a recorded scene that a scan showed."""
    if not has_scan(request):
        return ()
    own = {one.name for one in request.scene.obstacles}
    parts = {piece.name for piece in find_recorded_obstacles(request, recorded)}
    return tuple(piece for piece in recorded.pieces if piece.name not in own | parts)


def _look_again(
    request: PlanRequest,
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    feet: Sequence[str],
    clouds: Sequence[Path],
) -> Surroundings:
    soles = {foot: sole_corners(robot, start, foot) for foot in feet}
    if clouds:
        request = replace_clouds(request, clouds)
    about = read_surroundings(request, robot, start, soles, None)
    return replace(about, pieces=move_floor_to_soles(about.pieces, soles)[0])


def _obstacles(
    request: PlanRequest, recorded: Scene, about: Surroundings, is_given: bool
) -> tuple[tuple[ConvexPiece, ...], bool]:
    """The request's obstacles in its order, and whether some had to be taken from the record."""
    is_mesh = [isinstance(one, MeshRequest) for one in request.scene.obstacles]
    is_whole = is_given and all(one.name in about.matches for one in request.scene.obstacles if _needs_match(one))
    if is_whole or not any(is_mesh):
        return build_obstacles(request, about.matches).pieces, False
    plain = tuple(one for one, mesh in zip(request.scene.obstacles, is_mesh, strict=True) if not mesh)
    shapes = build_obstacles(replace(request, scene=replace(request.scene, obstacles=plain))).pieces
    return (*shapes, *find_recorded_obstacles(request, recorded)), True


def _needs_match(obstacle: object) -> bool:
    return isinstance(obstacle, MeshRequest) and obstacle.match
