"""The world around the robot at its start: obstacles of the request, and pieces of its scan or scene file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from costs.primitive import Primitive, make_round_shape
from costs.robot import RobotModel, shapes
from costs.scene import ConvexPiece
from service.errors import RequestError
from service.request.scene import (
    BoxRequest,
    CapsuleRequest,
    ConvexRequest,
    CylinderRequest,
    MeshRequest,
    ObstacleRequest,
    SphereRequest,
)
from service.request.schema import PlanRequest
from service.scan.meshes import read_solid, split_convex
from service.start.standing import place_bodies

if TYPE_CHECKING:
    from perception.solids.match import KnownMesh, MeshMatch
    from perception.solids.mesh import Solid

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


def read_surroundings(
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
    from perception import (  # takes a while, and most scenes need none
        PerceptionError,
        Reach,
        perceive,
        read_clouds,
        select_wheels,
    )

    scene = request.scene
    x, y = (float(start[0]), float(start[1])) if robot.is_floating else (0.0, 0.0)
    known = load_match_meshes(request)
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
    wheels = select_wheels(seen.detections)
    return Surroundings(seen.scene.pieces, wheels, seen.shown, seen.notes, seen.matches)


@dataclass(frozen=True)
class Obstacles:
    """The obstacles of a request: convex pieces in the world, and what a user should know of them."""

    pieces: tuple[ConvexPiece, ...]
    notes: tuple[str, ...]


def load_match_meshes(request: PlanRequest) -> tuple[KnownMesh, ...]:
    """The meshes that the request's scan is to show.

    Raises:
        RequestError: a mesh file that cannot be used.
    """
    from perception.solids.match import KnownMesh  # takes a while, and only requests with a scan need it

    return tuple(
        KnownMesh(one.name, _solid(request, one, f"scene.obstacles[{index}].file"), _pose(one))
        for index, one in enumerate(request.scene.obstacles)
        if isinstance(one, MeshRequest) and one.match
    )


def build_obstacles(
    request: PlanRequest,
    matches: Mapping[str, MeshMatch] = MappingProxyType({}),
) -> Obstacles:
    """All obstacles of a request; round shapes as polytopes around them, meshes as several pieces.

    Args:
        request: the request.
        matches: by name what the scan showed of meshes that were to be found in it; they stand where it shows them.

    Raises:
        RequestError: a mesh file that cannot be used or is not found in the scan, or points without a volume.
        Stopped: it was asked to stop.
    """
    pieces: list[ConvexPiece] = []
    notes: list[str] = []
    for index, obstacle in enumerate(request.scene.obstacles):
        field, pose = f"scene.obstacles[{index}]", _pose(obstacle)
        if isinstance(obstacle, MeshRequest):
            match = matches[obstacle.name] if obstacle.match else None
            solid = _solid(request, obstacle, f"{field}.file") if match is None else match.solid
            notes += solid.notes
            if match is not None:
                pose = _pose_found(obstacle, match, f"{field}.match")
                x, y, z = pose[:3, 3]
                notes.append(f"{obstacle.name} found at ({x:.3f}, {y:.3f}, {z:.3f}), confidence {match.confidence:.2f}")
            parts: Sequence[np.ndarray] = split_convex(
                solid,
                Path(obstacle.file).name,
                f"{field}.file",
                decompose=obstacle.decompose,
            )
        else:
            parts = [_shape(obstacle, field)]
        for number, vertices in enumerate(parts, start=1):
            name = obstacle.name if len(parts) == 1 else f"{obstacle.name}/{number}"
            exact = _round(obstacle, pose)
            pieces.append(ConvexPiece(name, vertices @ pose[:3, :3].T + pose[:3, 3], exact=exact))
    return Obstacles(tuple(pieces), tuple(notes))


def _solid(request: PlanRequest, obstacle: MeshRequest, field: str) -> Solid:
    return read_solid(request.resolve(obstacle.file), field, obstacle.scale)


def _pose_found(obstacle: MeshRequest, match: MeshMatch, field: str) -> Float[np.ndarray, "4 4"]:
    from perception import CONFIDENT

    if match.confidence < CONFIDENT:
        place = ", ".join(f"{value:.2f}" for value in obstacle.position)
        raise RequestError(
            f"{field}: the scan does not show {Path(obstacle.file).name} near ({place}): confidence "
            f"{match.confidence:.2f}, {CONFIDENT} is needed; place it within 15 cm and 20 degrees, or leave match out"
        )
    return match.pose_world_mesh


def _pose(obstacle: ObstacleRequest) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(obstacle.quaternion_wxyz, scalar_first=True).as_matrix()
    pose[:3, 3] = obstacle.position
    return pose


def _shape(
    obstacle: BoxRequest | SphereRequest | CylinderRequest | CapsuleRequest | ConvexRequest, field: str
) -> Float[np.ndarray, "V 3"]:
    """Vertices of a convex obstacle in its own frame."""
    match obstacle:
        case BoxRequest():
            return shapes.box(np.array(obstacle.size))
        case SphereRequest():
            return shapes.sphere(obstacle.radius)
        case CylinderRequest():
            return shapes.cylinder(obstacle.radius, obstacle.height)
        case CapsuleRequest():
            return shapes.capsule(obstacle.radius, obstacle.height)
        case ConvexRequest():
            return _hull(np.array(obstacle.points), f"{field}.points")


def _round(obstacle: ObstacleRequest, pose: Float[np.ndarray, "4 4"]) -> Primitive | None:
    """The round shape in the world that an obstacle is; None for the others, whose vertices are exact."""
    match obstacle:
        case SphereRequest():
            given = make_round_shape("sphere", (obstacle.radius,))
        case CylinderRequest():
            given = make_round_shape("cylinder", (obstacle.radius, obstacle.height))
        case CapsuleRequest():
            given = make_round_shape("capsule", (obstacle.radius, obstacle.height))
        case _:
            return None
    return None if given is None else given.move(pose)


def _hull(points: Float[np.ndarray, "V 3"], field: str) -> Float[np.ndarray, "W 3"]:
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        raise RequestError(
            f"{field}: the {len(points)} points lie in a plane; expected four that span a volume"
        ) from None
