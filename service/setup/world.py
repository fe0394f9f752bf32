"""Surroundings of the robot: obstacles of the request, and pieces of its scan or scene file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from costs.primitive import make_round_shape
from costs.robot import RobotModel, shapes
from costs.rotation import pose_matrix
from costs.scene import ConvexPiece
from service.demands.kind import find_demand_part
from service.demands.rest.earlier_motion import find_beginning
from service.errors import RequestError
from service.request.resume import ResumeRequest
from service.request.scene import (
    ConvexRequest,
    CutRequest,
    MeshRequest,
    MovableMesh,
    ObjectRequest,
    ObstacleRequest,
    SceneRequest,
)
from service.request.schema import PlanRequest
from service.start.standing import place_bodies

if TYPE_CHECKING:
    from perception import LeverDetection, Perceived, SeenPart, ValveDetection
    from perception.solids.match import KnownMesh
    from perception.solids.mesh import Solid
    from perception.solids.rating import MeshMatch
    from service.demands.door.demand import SeenDoor
    from service.demands.mechanism.given import GivenMechanism


@dataclass(frozen=True)
class Surroundings:
    """Pieces and objects of a scan or scene file.

    Attributes:
        pieces: pieces to avoid, including the floor, without what turns of ``valves[0]``.
        valves: wheels and levers of valves, the first is the one to turn; empty unless the task turns a valve.
        doors: doors that the scan shows, the best first; empty unless the task opens a door.
        points: (M, 3) points of the scan for display [m].
        notes: sentences for the user.
        matches: matches of meshes with the scan, by name.
        seen: parts of ``valves[0]`` or ``doors[0]`` that a hand may press, with the rays of the scan at each.
    """

    pieces: tuple[ConvexPiece, ...]
    valves: tuple[ValveDetection | LeverDetection, ...] = ()
    points: Float[np.ndarray, "M 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    notes: tuple[str, ...] = ()
    matches: Mapping[str, MeshMatch] = field(default_factory=dict)
    doors: tuple[SeenDoor, ...] = ()
    seen: tuple[SeenPart, ...] = ()

    def list_hits(self) -> tuple[dict[str, Any], ...]:
        """Return valves and doors as data, the task's with the parts of it that the scan shows."""
        hits = [
            *({"kind": "valve", **asdict(valve)} for valve in self.valves),
            *({"kind": "door", **asdict(door)} for door in self.doors),
        ]
        if hits:
            hits[0]["parts"] = [asdict(part) for part in self.seen]
        return tuple(hits)

    def move_valve(self, offset: Float[np.ndarray, "3"]) -> Surroundings:
        """Return the surroundings with the valve to turn, and the piece behind it, displaced [m]."""
        first = replace(self.valves[0], centre=self.valves[0].centre + offset)
        pieces = tuple(
            replace(piece, vertices=piece.vertices + offset) if piece.kind == STEM else piece for piece in self.pieces
        )
        return replace(self, pieces=pieces, valves=(first, *self.valves[1:]))

    def move_door(self, offset: Float[np.ndarray, "3"]) -> Surroundings:
        """Return the surroundings with leaf and handle of the best door displaced [m]."""
        seen = self.doors[0].geometry
        grip = None if seen.handle is None else replace(seen.handle, centre=seen.handle.centre + offset)
        first = replace(self.doors[0], geometry=replace(seen, hinge=seen.hinge + offset, handle=grip))
        return replace(self, doors=(first, *self.doors[1:]))


NOTHING = Surroundings(())
STEM = "stem"  # kind of the piece behind a wheel, which goes with it
TURNABLE = "turnable"  # detected kind of valves, the only objects that a scene file has


def read_surroundings(
    request: PlanRequest,
    robot: RobotModel,
    start: Float[np.ndarray, "n"],
    soles: Mapping[str, np.ndarray],
    see: Callable[..., Perceived] | None,
) -> Surroundings:
    """Read the request's scan or scene file; ``NOTHING`` without one.

    Args:
        request: the request.
        robot: the robot; its own points are removed from the scan.
        start: (n,) configuration of the robot.
        soles: corners of each planted link's sole in the world [m].
        see: ``perception.perceive``, or a function that caches its results.

    Raises:
        RequestError: a file that cannot be used.
    """
    scene, section = request.scene, request.section
    hint = section.near or scene.hint
    if scene.file is not None:
        shown = _read_scene_file(request, request.resolve(scene.file), hint)
    elif scene.cloud is not None:
        shown = _perceive_scan(request, robot, start, list(soles.values()), hint, see)
    else:
        return NOTHING
    return shown if section.moved_by is None else _move_by_hand(shown, np.array(section.moved_by))


def _move_by_hand(shown: Surroundings, offset: Float[np.ndarray, "3"]) -> Surroundings:
    """Return the surroundings with what the task moves where a person corrected it to."""
    if not (shown.valves or shown.doors):
        return shown
    moved = shown.move_valve(offset) if shown.valves else shown.move_door(offset)
    what = "valve" if shown.valves else "door"
    note = f"the {what} was moved by hand by {np.linalg.norm(offset):.3f} m from where the scan shows it"
    return replace(moved, notes=(*moved.notes, note))


def _read_scene_file(request: PlanRequest, path: Path, hint: tuple[float, float, float] | None) -> Surroundings:
    """Read the request's scene file, with the valve nearest to the hint first."""
    from service.scan.scene_file import read_scene  # takes a while, and few requests need it

    record = read_scene(path, "scene.file")
    if TURNABLE not in request.section.detected:
        return Surroundings(record.pieces)
    valves = record.valves(hint)
    return Surroundings(record.pieces_without(valves[:1]), valves, seen=record.list_seen_parts(hint))


def _perceive_scan(
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
        count_seen_parts,
        perceive,
        read_clouds,
        read_door,
        select_turnable,
    )
    from service.demands.door.demand import SeenDoor

    scene = request.scene
    start = _recall_start(request.resume, robot, start)
    x, y = (float(start[0]), float(start[1])) if robot.is_floating else (0.0, 0.0)
    known = load_match_meshes(request)
    moved = [body for given in _read_mechanisms(request) for body in given.place_bodies()]  # shown, and known already
    own = [vertices for _, vertices in place_bodies(robot, start)]
    taken_out = [_place_shape(shape) for shape in scene.taken_out]
    try:
        cloud = read_clouds(
            [(request.resolve(file.file), file.transform) for file in scene.cloud_files],
            unit=scene.unit,
            apply_viewpoint=scene.apply_viewpoint,
            sensor=scene.sensor,
            level=scene.level,
            sensor_model=scene.sensor_model,
            sensor_sigma=scene.sensor_sigma,
            topic=scene.topic,
            message=scene.message,
        )
        seen = (see or perceive)(
            cloud,
            reach=Reach(x=x, y=y),
            robot_hulls=[*own, *moved],
            soles=soles,
            kinds=request.section.detected,
            hint=None if hint is None else np.array(hint),
            unknown=scene.unknown,
            seed=request.options.seed,
            method=scene.method,
            known=known,
            given_hulls=taken_out,
        )
    except PerceptionError as error:
        raise RequestError(f"scene.cloud: {error}") from None
    valves = select_turnable(seen.detections)
    doors = tuple(
        SeenDoor(read_door(hit), hit.confidence, hit.residuals["hinge_share"] > 0.0)
        for hit in seen.detections
        if hit.kind == "door"
    )
    notes = (*seen.notes, *_note_taken_out(scene, cloud.points, taken_out))
    parts = count_seen_parts(seen.view.cloud, seen.detections[0]) if valves or doors else ()
    return Surroundings(seen.scene.pieces, valves, seen.shown, notes, seen.matches, doors, parts)


def _recall_start(
    resume: ResumeRequest | None, robot: RobotModel, start: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Return where the robot is in the scan: of an earlier plan's scan, where that plan began."""
    if resume is None or resume.is_rescanned or resume.nominal is None:
        return start
    began = find_beginning(robot, resume.nominal)
    return start if began is None else began


def _note_taken_out(
    scene: SceneRequest, points: Float[np.ndarray, "N 3"], hulls: Sequence[Float[np.ndarray, "V 3"]]
) -> Iterator[str]:
    """Yield a note on the points that belong to shapes of the request."""
    from perception import inside_hulls

    counts = [
        (shape.name, int(inside_hulls(points, [hull]).sum()))
        for shape, hull in zip(scene.taken_out, hulls, strict=True)
    ]
    if counts:
        yield "took out of the scan: " + ", ".join(f"{count} points on {name}" for name, count in counts)


def load_match_meshes(request: PlanRequest) -> tuple[KnownMesh, ...]:
    """Load the meshes to find in the request's scan.

    Raises:
        RequestError: a mesh file cannot be used.
    """
    from perception.solids.match import KnownMesh  # takes a while, and only requests with a scan need it

    return tuple(
        KnownMesh(mesh.name, _solid(request, mesh, f"scene.obstacles[{index}].file"), _pose(mesh))
        for index, mesh in enumerate(request.scene.obstacles)
        if isinstance(mesh, MeshRequest) and mesh.match
    )


def build_obstacles(
    request: PlanRequest, matches: Mapping[str, MeshMatch] = MappingProxyType({})
) -> tuple[tuple[ConvexPiece, ...], tuple[str, ...]]:
    """Return the convex pieces of all obstacles, and notes; round shapes become polytopes, meshes several pieces.

    The bodies of the task's mechanism that no joint moves are obstacles too.

    Args:
        matches: matches of meshes with the scan, by name; these meshes are placed at the matched poses.

    Raises:
        RequestError: a mesh file cannot be used, a mesh is not found in the scan, or points have no volume.
    """
    pieces: list[ConvexPiece] = []
    notes: list[str] = []
    given: list[tuple[str, ObstacleRequest | ObjectRequest]] = []
    given += [(f"scene.obstacles[{index}]", obstacle) for index, obstacle in enumerate(request.scene.obstacles)]
    # What the task does not carry stays where it is.
    given += [
        (f"scene.objects[{index}]", item)
        for index, item in enumerate(request.scene.objects)
        if item.name not in request.section.carried
    ]
    for where, obstacle in given:
        pose = _pose(obstacle)
        if isinstance(obstacle, MeshRequest):
            match = matches[obstacle.name] if obstacle.match else None
            solid = _solid(request, obstacle, f"{where}.file") if match is None else match.solid
            notes += solid.notes
            if match is not None:
                pose = _read_match(obstacle, match, f"{where}.match")
                x, y, z = pose[:3, 3]
                notes.append(f"{obstacle.name} found at ({x:.3f}, {y:.3f}, {z:.3f}), confidence {match.confidence:.2f}")
            from service.scan.meshes import split_convex

            name = Path(obstacle.file).name
            parts: Sequence[np.ndarray] = split_convex(solid, name, f"{where}.file", decompose=obstacle.decompose)
        else:
            parts = [_make_shape(obstacle, where)]
        round_shape = make_round_shape(obstacle.type, obstacle.lengths)
        exact = None if round_shape is None else round_shape.move(pose)
        for number, vertices in enumerate(parts, start=1):
            name = obstacle.name if len(parts) == 1 else f"{obstacle.name}/{number}"
            pieces.append(ConvexPiece(name, vertices @ pose[:3, :3].T + pose[:3, 3], exact=exact))
    for mechanism in _read_mechanisms(request):
        from service.demands.moved_object.overlaps import list_overlap_notes

        notes += (f"task.mechanism.urdf: {note}" for note in (*mechanism.read.notes, *list_overlap_notes(mechanism)))
        notes += () if request.options.timed else mechanism.list_pace_notes()
        pieces += mechanism.pieces
    return tuple(pieces), tuple(notes)


def _place_shape(shape: CutRequest) -> Float[np.ndarray, "V 3"]:
    """Return the corners of a shape in the world."""
    pose = _pose(shape)
    return np.asarray(_make_shape(shape, f"scene: {shape.name}") @ pose[:3, :3].T + pose[:3, 3])


def _make_shape(shape: CutRequest | ObjectRequest, field: str) -> Float[np.ndarray, "V 3"]:
    """Return the corners of a shape in its own frame; round shapes become polytopes."""
    if isinstance(shape, ConvexRequest | MovableMesh):
        return _hull(np.array(shape.points), f"{field}.points")
    return shapes.make_points(shape.type, shape.lengths)


def _read_mechanisms(request: PlanRequest) -> tuple[GivenMechanism, ...]:
    """Return the mechanisms that the request's task gives by a URDF."""
    return find_demand_part(request).read_mechanisms(request.section)


def _solid(request: PlanRequest, obstacle: MeshRequest, field: str) -> Solid:
    from service.scan.meshes import read_solid

    return read_solid(request.resolve(obstacle.file), field, obstacle.scale, obstacle.scale_xyz)


def _read_match(obstacle: MeshRequest, match: MeshMatch, field: str) -> Float[np.ndarray, "4 4"]:
    from perception import CONFIDENT

    if match.confidence < CONFIDENT:
        place = ", ".join(f"{value:.2f}" for value in obstacle.position)
        raise RequestError(
            f"{field}: the scan does not show {Path(obstacle.file).name} near ({place}): confidence "
            f"{match.confidence:.2f}, {CONFIDENT} is needed; place it within 15 cm and 20 degrees, or leave match out"
        )
    return match.pose_world_mesh


def _pose(obstacle: ObstacleRequest | ObjectRequest | CutRequest) -> Float[np.ndarray, "4 4"]:
    return pose_matrix(obstacle.position, obstacle.quaternion_wxyz)


def _hull(points: Float[np.ndarray, "V 3"], field: str) -> Float[np.ndarray, "W 3"]:
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        raise RequestError(
            f"{field}: the {len(points)} points lie in a plane; expected four that span a volume"
        ) from None
