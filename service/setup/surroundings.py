"""What surrounds the robot besides the obstacles that a request lists: what a scan shows, or a scene made of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.errors import RequestError
from service.request.schema import PlanRequest
from service.setup.obstacles import known_meshes
from service.start.standing import place_bodies

if TYPE_CHECKING:
    from perception import Perceived, ValveDetection
    from perception.solids.match import MeshMatch


@dataclass(frozen=True)
class Surroundings:
    """A scan or a scene's file as a plan needs it.

    Attributes:
        pieces: that must not be touched, the floor's included; the wheel of ``valves[0]`` is not among them.
        valves: wheel valves, the one to turn first; none unless the task asks for one.
        points: (M, 3) of the scan, to be shown [m].
        notes: sentences a user should read.
        matches: by name where the scan shows each mesh that was to be found.
    """

    pieces: tuple[ConvexPiece, ...]
    valves: tuple[ValveDetection, ...] = ()
    points: Float[np.ndarray, "M 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    notes: tuple[str, ...] = ()
    matches: Mapping[str, MeshMatch] = field(default_factory=dict)


NOTHING = Surroundings(())


def surroundings(
    request: PlanRequest,
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    soles: Mapping[str, np.ndarray],
    see: Callable[..., Perceived] | None,
) -> Surroundings:
    """What the request's scan or scene file shows; nothing where it names none.

    Args:
        request: the request.
        robot: the robot, which is left out of the scan where it stands.
        start: (n,) configuration.
        soles: for each planted link, the corners of its sole in the world [m].
        see: ``perceive``, or what remembers its results.

    Raises:
        RequestError: a file that cannot be used.
        Stopped: it was asked to stop.
    """
    scene, task = request.scene, None if request.task is None else request.task.valve
    hint = scene.hint if task is None or task.hint is None else task.hint
    if scene.file is not None:
        from service.scan.scene_file import read_scene  # takes a while, and few requests need it

        given = read_scene(request.resolve(scene.file), "scene.file")
        if task is None:
            return Surroundings(given.pieces)
        valves = given.valves(hint)
        return Surroundings(given.pieces_without(valves[:1]), valves)
    if scene.cloud is None:
        return NOTHING
    return _scanned(request, robot, start, list(soles.values()), hint, see)


def _scanned(
    request: PlanRequest,
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    soles: Sequence[np.ndarray],
    hint: tuple[float, float, float] | None,
    see: Callable[..., Perceived] | None,
) -> Surroundings:
    from perception import PerceptionError, Reach, perceive, read_clouds  # takes a while, and most scenes need none

    scene = request.scene
    x, y = (float(start[0]), float(start[1])) if robot.is_floating else (0.0, 0.0)
    known = known_meshes(request)
    try:
        cloud = read_clouds(
            [(request.resolve(one.file), one.transform) for one in scene.cloud_files],
            unit=scene.unit,
            apply_viewpoint=scene.apply_viewpoint,
            sensor=scene.sensor,
            topic=scene.topic,
            message=scene.message,
        )
        seen = (see or perceive)(
            cloud,
            reach=Reach(x=x, y=y),
            robot_hulls=[vertices for _, vertices in place_bodies(robot, start)],
            soles=soles,
            kinds=("wheel",) if request.task is not None and request.task.valve is not None else (),
            hint=None if hint is None else np.array(hint),
            unknown=scene.unknown,
            seed=request.options.seed,
            method=scene.method,
            known=known,
        )
    except PerceptionError as error:
        raise RequestError(f"scene.cloud: {error}") from None
    return Surroundings(seen.scene.pieces, seen.valves, seen.shown, seen.notes, seen.matches)
