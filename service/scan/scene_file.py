"""Scene files (docs/scene-format.md): their schema, and reading of a scene for planning, from any program."""

from __future__ import annotations

import json
import stat
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from costs.scene import ConvexPiece, Scene
from perception import Cloud, Detection, LeverDetection, SeenPart, ValveDetection, count_seen_parts
from service.errors import RequestError, shown
from service.request.choices import Method, Unknown

FORMAT = "scopt-scene/1"
MOST_BYTES = 64 * 2**20
MOST_PIECES, MOST_VERTICES = 20_000, 1000
VALVE = "valve"
LEAST_THICKNESS_M = 1e-6
LEAST_AXIS = 1e-6
LEVER_RADIUS = 0.013  # where a scene file does not say it [m]
ROUND_WHEEL_M = 0.02  # pieces of the scan this near to a wheel belong to it

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Vertex = tuple[Number, Number, Number]
Placing = Literal["given", "found", "not found", "gone"]


@checked(frozen=True)
class SceneSettings:
    """Settings with which a scene was made from its clouds; an update uses the same."""

    reach_m: Annotated[Number, Field(gt=0.0)]
    top_m: Number
    bottom_m: Number
    seed: Annotated[int, Field(ge=0)]
    unknown: Unknown
    method: Method


@checked(frozen=True)
class EvidenceRecord:
    """Evidence for a piece from the rays of the scan."""

    free_cells: Annotated[int, Field(ge=0)]
    free_share: Number
    open_share: Number
    plane: tuple[Number, Number, Number, Number] | None = None


@checked(frozen=True)
class PieceRecord:
    """A convex piece; ``seen`` is missing for pieces that were not made from points of the scan."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    kind: Annotated[str, Field(max_length=200)]
    vertices: Annotated[list[Vertex], Field(min_length=4, max_length=MOST_VERTICES)]
    seen: EvidenceRecord | None = None

    @property
    def piece(self) -> ConvexPiece:
        """The piece in the world."""
        return ConvexPiece(self.name, np.array(self.vertices), self.kind)


@checked(frozen=True)
class SpokesRecord:
    """Spokes and hub of a wheel, with the names of ``perception.ValveDetection``."""

    spoke_angles: Annotated[list[Number], Field(max_length=100)]
    spoke_half_width: Number
    spoke_share: Number
    hub_radius: Number
    inner_depth: tuple[Number, Number]


@checked(frozen=True)
class PartRecord:
    """A part of an object that a hand may press, with the rays of the scan at each of its cells."""

    name: Annotated[str, Field(max_length=200)]
    places: Annotated[list[tuple[Number, Number]], Field(max_length=MOST_PIECES)]
    hits: list[Annotated[int, Field(ge=0)]]
    passes: list[Annotated[int, Field(ge=0)]]
    within_m: Number

    @property
    def part(self) -> SeenPart:
        """The part.

        Raises:
            ValueError: a cell lacks a count.
        """
        if not len(self.places) == len(self.hits) == len(self.passes):
            raise ValueError(f"{shown(self.name)} has {len(self.places)} places; expected as many hits and passes")
        return SeenPart(self.name, tuple(self.places), tuple(self.hits), tuple(self.passes), self.within_m)


@checked(frozen=True)
class HitRecord:
    """A detected object; ``spokes`` are a wheel's, ``parts`` are what a hand may press."""

    kind: str
    confidence: Annotated[float, Field(ge=0.0, le=1.0)]
    pose_world_object: Annotated[
        list[Annotated[list[Number], Field(min_length=4, max_length=4)]], Field(min_length=4, max_length=4)
    ]
    sizes: Mapping[str, Number]
    spokes: SpokesRecord | None = None
    parts: list[PartRecord] = Field(default_factory=list)


@checked(frozen=True)
class MeshRecord:
    """A known object and the names of its pieces."""

    name: Annotated[str, Field(min_length=1)]
    file: str
    placing: Placing
    pose_world_mesh: list[list[Number]] | None
    pieces: list[str]


@checked(frozen=True)
class SceneRecord:
    """Keys of a scene file that planning reads; other programs may write them too."""

    pieces: Annotated[list[PieceRecord], Field(max_length=MOST_PIECES)]
    detections: Annotated[list[HitRecord], Field(max_length=MOST_PIECES)] = Field(default_factory=list)


@checked(frozen=True, kw_only=True)
class UpdatableRecord(SceneRecord):
    """Keys that an update reads in addition."""

    settings: SceneSettings
    meshes: list[MeshRecord]


RecordT = TypeVar("RecordT", bound=SceneRecord)


def scene_document(settings: SceneSettings, pieces: Mapping[str, Any], **content: Any) -> dict[str, Any]:
    """Return the data of a scene file, JSON-ready, in the order in which it is written.

    Args:
        settings: how the scene was made.
        pieces: ``pieces`` and, after an update, ``update``.
        content: further keys (docs/scene-format.md).
    """
    return {"format": FORMAT, "settings": asdict(settings), **pieces, **content}


@dataclass(frozen=True)
class SceneFile:
    """Pieces and hits of a scene file.

    Attributes:
        pieces: all pieces.
        hits: the objects detected in the scan.
    """

    pieces: tuple[ConvexPiece, ...]
    hits: tuple[HitRecord, ...]

    def valves(self, hint: Sequence[float] | None) -> tuple[ValveDetection | LeverDetection, ...]:
        """Return the wheels and levers of valves, nearest to the hint first; without one, highest confidence first."""
        return tuple(_valve(hit) for hit in self._sort_valves(hint))

    def list_seen_parts(self, hint: Sequence[float] | None) -> tuple[SeenPart, ...]:
        """Return the parts of the first valve that a hand may press, as the scan showed them.

        Raises:
            RequestError: a part contradicts itself.
        """
        try:
            return tuple(entry.part for hit in self._sort_valves(hint)[:1] for entry in hit.parts)
        except ValueError as error:
            raise RequestError(f"scene.file: detections: parts: {error}") from None

    def _sort_valves(self, hint: Sequence[float] | None) -> list[HitRecord]:
        valves = [hit for hit in self.hits if _is_valve(hit)]
        if hint is None:
            return sorted(valves, key=lambda hit: -hit.confidence)
        return sorted(valves, key=lambda hit: float(np.linalg.norm(np.array(hit.pose_world_object)[:3, 3] - hint)))

    def pieces_without(self, valves: Sequence[ValveDetection | LeverDetection]) -> tuple[ConvexPiece, ...]:
        """Return the pieces outside wheels and levers, which are contacts, not obstacles."""
        return tuple(piece for piece in self.pieces if not any(_is_within(valve, piece.vertices) for valve in valves))


def read_scene(path: Path, field: str) -> SceneFile:
    """Read a scene file for planning.

    Args:
        path: path of the file.
        field: field of the request that names it.

    Raises:
        RequestError: the file cannot be read or is no scene.
    """
    record = read_record(path, field, SceneRecord, if_scan=", a scan goes into scene.cloud")
    try:
        pieces = tuple(entry.piece for entry in record.pieces)
        Scene(pieces)
        _check_solid(pieces)
    except ValueError as error:
        raise RequestError(f"{field}: {path}: pieces: {error}") from None
    return SceneFile(pieces, tuple(record.detections))


def read_record(path: Path, field: str, kind: type[RecordT], *, if_scan: str = "", advice: str = "") -> RecordT:
    """Read a scene file and check it against its schema.

    Args:
        path: path of the file.
        field: field of the request, or option, that names it.
        kind: schema with the required keys.
        if_scan: added to the error where the file may be a scan.
        advice: added to the error where a key is wrong.

    Raises:
        RequestError: the file cannot be read or is no scene.
    """
    data = _read_json(path, field, if_scan)
    if kind is UpdatableRecord and "settings" not in data:
        raise RequestError(f"{field}: {path} does not say what it was made with{advice}")
    try:
        return TypeAdapter(kind).validate_python(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise RequestError(f"{field}: {path}: {where}: {first['msg']}{advice}") from None


def _read_json(path: Path, field: str, if_scan: str) -> Mapping[str, Any]:
    try:
        if not path.is_dir() and not stat.S_ISREG(path.stat().st_mode):  # reading a pipe or a device might never end
            raise RequestError(f"{field}: {path} is no regular file; expected the file that 'scopt scene' writes")
        if path.stat().st_size > MOST_BYTES:
            raise RequestError(f"{field}: {path} has more than {MOST_BYTES // 2**20} MB; a scene has less")
        data = json.loads(path.read_bytes())
    except OSError as error:
        raise RequestError(f"{field}: {path} cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError):
        raise RequestError(
            f"{field}: {path} is no JSON; expected the file that 'scopt scene' writes{if_scan}"
        ) from None
    file_format = data.get("format") if isinstance(data, Mapping) else None
    if file_format != FORMAT:
        scan = if_scan if file_format is None else ""
        raise RequestError(f"{field}: {path} is no scene, its format is {shown(file_format)}; expected {FORMAT}{scan}")
    return dict(data)


def _check_solid(pieces: Sequence[ConvexPiece]) -> None:
    flat = next((piece.name for piece in pieces if _thickness(piece.vertices) < LEAST_THICKNESS_M), None)
    if flat is not None:
        raise ValueError(f"the vertices of {shown(flat)} lie in a plane; expected four that span a volume")


def _thickness(vertices: Float[np.ndarray, "V 3"]) -> float:
    """Return the approximate smallest thickness of a body [m]."""
    return float(np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)[-1])


def _is_valve(hit: HitRecord) -> bool:
    """Return whether a hit is a valve with a radius, or a lever of some length, and an axis."""
    pose = np.array(hit.pose_world_object)
    has_axis = np.linalg.norm(pose[:3, 2]) > LEAST_AXIS
    has_bar = hit.sizes.get("lever_length", 0.0) > 0.0 and np.linalg.norm(pose[:3, 0]) > LEAST_AXIS
    return hit.kind == VALVE and (hit.sizes.get("rim_radius", 0.0) > 0.0 or bool(has_bar)) and bool(has_axis)


def _valve(hit: HitRecord) -> ValveDetection | LeverDetection:
    pose = np.array(hit.pose_world_object)
    if "lever_length" in hit.sizes:
        sizes = hit.sizes
        lever = lever_from_sizes(
            pose[:3, 3], pose[:3, 2], pose[:3, 0], sizes["lever_length"], sizes.get("lever_radius", LEVER_RADIUS),
            sizes.get("grip_length", 0.0),
        )  # fmt: skip
        return replace(lever, confidence=hit.confidence)
    rim = hit.sizes["rim_radius"]
    tube = hit.sizes.get("tube_radius", 0.1 * rim)
    wheel = wheel_from_circle(pose[:3, 3], pose[:3, 2], rim, tube)
    wheel = replace(wheel, outer_radius=hit.sizes.get("outer_radius", rim + tube), confidence=hit.confidence)
    if hit.spokes is None:
        return wheel
    spokes = {**asdict(hit.spokes), "spoke_angles": tuple(hit.spokes.spoke_angles)}
    return replace(wheel, **spokes)


def encode_parts(hit: Detection, cloud: Cloud) -> dict[str, Any]:
    """Return the keys of a hit that only scene files have: a wheel's spokes, and what a hand may press.

    Args:
        hit: the detection.
        cloud: the scan, whose rays are counted.
    """
    data: dict[str, Any] = {"parts": [asdict(part) for part in count_seen_parts(cloud, hit)]}
    if isinstance(hit.model, ValveDetection):
        data["spokes"] = {name: getattr(hit.model, name) for name in SpokesRecord.__dataclass_fields__}
    return data


def wheel_from_circle(
    centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"], rim_radius: float, tube_radius: float
) -> ValveDetection:
    """Make a valve from its rim circle only, without spokes.

    Args:
        centre: centre of the rim [m].
        axis: direction towards the robot, of any length but zero.
        rim_radius: radius of the rim's centre line [m].
        tube_radius: half the rim's thickness [m].
    """
    return ValveDetection(
        centre=centre,
        axis=axis / np.linalg.norm(axis),
        rim_radius=rim_radius,
        outer_radius=rim_radius + tube_radius,
        tube_radius=tube_radius,
        half_depth=tube_radius,
        spoke_angles=(),
        hub_radius=0.25 * rim_radius,
        inner_depth=(-tube_radius, tube_radius),
        confidence=1.0,
        rms=0.0,
        n_inliers=0,
    )


def lever_from_sizes(
    centre: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    length: float,
    radius: float,
    grip_length: float,
) -> LeverDetection:
    """Make a lever or a crank from its sizes.

    Args:
        centre: where the spindle's axis meets the bar's centre line [m].
        axis: direction of the spindle towards the robot, of any length but zero.
        direction: along the bar from the spindle; made perpendicular to the axis.
        length, radius: of the bar, to a crank's grip; half its thickness [m].
        grip_length: of a crank's grip; 0 for a lever [m].
    """
    up = axis / np.linalg.norm(axis)
    along = direction - (direction @ up) * up
    return LeverDetection(
        centre, up, along / np.linalg.norm(along), length, radius, confidence=1.0, rms=0.0, n_inliers=0,
        grip_length=grip_length,
    )  # fmt: skip


def _is_within(valve: ValveDetection | LeverDetection, vertices: Float[np.ndarray, "V 3"]) -> bool:
    """Return whether a piece lies within a lever, or within the disc of a wheel and ``ROUND_WHEEL_M`` around it."""
    if isinstance(valve, LeverDetection):
        return bool(valve.split_off(vertices)[0].all())
    offset = vertices - valve.centre
    height = offset @ valve.axis
    radius = np.linalg.norm(offset - height[:, None] * valve.axis, axis=1)
    is_within = (radius <= valve.outer_radius + ROUND_WHEEL_M) & (np.abs(height) <= valve.half_depth + ROUND_WHEEL_M)
    return bool(is_within.all())
