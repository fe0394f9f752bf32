"""``scopt scene``: a scene made from cloud files, or an earlier scene updated by them, JSON-ready."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from costs.progress import tells_progress
from costs.scene import ConvexPiece, Scene
from perception import (
    Detection,
    Earlier,
    Evidence,
    FloorPlane,
    Perceived,
    PerceptionError,
    Piece,
    Reach,
    perceive,
    settle_overlaps,
    update,
)
from perception.convex.hulls import make_hull
from perception.solids.match import KnownMesh
from perception.solids.mesh import Solid, hull_mesh
from service.errors import RequestError, shown
from service.request.choices import Method, Unknown
from service.scan.cloud import CloudInput, CloudRead, OnStep, count_points, read_input
from service.scan.detect import (
    OutOfTimeError,
    Search,
    TimeOver,
    check_hint,
    check_kinds,
    encode_hit,
    hint_notes,
    limit_time,
    search_objects,
)
from service.scan.json_data import encode_piece, to_json_data
from service.scan.known_meshes import (
    KIND,
    MeshInput,
    PlacedMesh,
    explain_low_confidence,
    load_known_meshes,
    place_meshes,
)
from service.scan.scene_file import (
    EvidenceRecord,
    MeshRecord,
    SceneSettings,
    UpdatableRecord,
    encode_parts,
    read_record,
    scene_document,
)

_OPTION = "--update"
_GONE = 0.5  # share of rays passing through a mesh above which it counts as gone
_AGAIN = "; make it anew with 'scopt scene'"


@dataclass(frozen=True)
class EarlierScene:
    """An earlier scene, read from its file, to be updated by a new scan.

    Attributes:
        path: path of the file.
        settings: settings of the scene.
        scene: all its pieces.
        pieces: the pieces made from points.
        meshes: the known meshes in the scene.
    """

    path: Path
    settings: SceneSettings
    scene: Scene
    pieces: tuple[Piece, ...]
    meshes: tuple[MeshRecord, ...]

    def meshes_without(self, names: Collection[str]) -> tuple[MeshRecord, ...]:
        """Return the meshes whose names are not among ``names``."""
        return tuple(mesh for mesh in self.meshes if mesh.name not in names)

    @property
    def earlier(self) -> Earlier:
        """The input of an update, without the known meshes."""
        reach = Reach(radius=self.settings.reach_m, top=self.settings.top_m, bottom=self.settings.bottom_m)
        return Earlier(self.scene, self.pieces, reach, self.settings.seed)

    def rebuild_mesh(self, mesh: MeshRecord) -> KnownMesh:
        """Make a known mesh from its pieces, which are already in the world frame."""
        parts = [piece.vertices for piece in self._parts(mesh)]
        return KnownMesh(mesh.name, Solid(tuple(hull_mesh(part) for part in parts), (), ()), np.eye(4), None, True)

    def place_mesh(self, mesh: MeshRecord, seen: Perceived) -> PlacedMesh:
        """Return a mesh at its pose; it is gone if an earlier scan found it and most rays now pass through it."""
        known, match = self.rebuild_mesh(mesh), seen.matches[mesh.name]
        pose = None if mesh.pose_world_mesh is None else np.array(mesh.pose_world_mesh)
        if mesh.placing == "found" and match.residuals["seen_through"] > _GONE:
            reason = explain_low_confidence(match)
            note = f"{mesh.name} is gone: {reason}; {_OPTION} with --mesh '{mesh.file}' looks for it again"
            return PlacedMesh(known, mesh.file, "gone", match, pose, (), (note,))
        return PlacedMesh(known, mesh.file, mesh.placing, match, pose, self._parts(mesh), ())

    def _parts(self, mesh: MeshRecord) -> tuple[ConvexPiece, ...]:
        return tuple(piece for piece in self.scene.pieces if piece.name in mesh.pieces)

    def list_changes(self, pieces: Sequence[ConvexPiece]) -> dict[str, list[str]]:
        """Return the names of unchanged, changed, new and gone pieces."""
        earlier = {piece.name: piece.vertices for piece in self.scene.pieces}
        names = {piece.name for piece in pieces}
        known = [piece for piece in pieces if piece.name in earlier]
        is_same = {piece.name: np.array_equal(earlier[piece.name], piece.vertices) for piece in known}
        return {
            "stayed": [name for name, same in is_same.items() if same],
            "changed": [name for name, same in is_same.items() if not same],
            "new": [piece.name for piece in pieces if piece.name not in earlier],
            "gone": [name for name in earlier if name not in names],
        }


def read_earlier_scene(path: Path) -> EarlierScene:
    """Read a scene that ``scopt scene`` wrote.

    Raises:
        RequestError: the file is missing, not a scene, or of an older release without the required keys.
    """
    record = read_record(path, _OPTION, UpdatableRecord, advice=_AGAIN)
    try:
        return _to_scene(path, record)
    except ValueError as error:
        raise RequestError(f"{_OPTION}: {path}: {error}{_AGAIN}") from None


def _to_scene(path: Path, record: UpdatableRecord) -> EarlierScene:
    scene = Scene(tuple(entry.piece for entry in record.pieces))
    pieces = tuple(_to_piece(entry.piece, entry.seen) for entry in record.pieces if entry.seen is not None)
    standing = {piece.name for piece in scene.pieces if piece.kind == KIND}
    meshes = tuple(mesh for mesh in record.meshes if mesh.pieces)
    for mesh in meshes:
        if not standing.issuperset(mesh.pieces):
            raise ValueError(f"meshes: {shown(mesh.name)} names pieces that are not there")
    return EarlierScene(path, record.settings, scene, pieces, meshes)


def _to_piece(shape: ConvexPiece, seen: EvidenceRecord) -> Piece:
    if not shape.name.rpartition("/")[2].isdecimal():
        raise ValueError(f"pieces: {shown(shape.name)} is no name of a piece made of points")
    evidence = Evidence(seen.free_cells, seen.free_share, seen.open_share)
    plane: Float[np.ndarray, "4"] | None = None if seen.plane is None else np.array(seen.plane)
    hull = make_hull(shape.vertices)
    return Piece(shape, np.arange(0), evidence, hull.simplified, plane)


@dataclass(frozen=True)
class SceneInput:
    """Clouds, and the settings and objects of their scene.

    Attributes:
        clouds: the files.
        kinds: kinds of objects to look for; ``all`` for every kind.
        hint: a point near the object [m].
        unknown: how space that no ray has seen is treated.
        method: how pieces are made.
        meshes: known objects, placed or to be found.
        before: the scene to update, made with the same reach, seed, ``unknown`` and ``method``.
    """

    clouds: CloudInput
    kinds: tuple[str, ...] = ()
    hint: tuple[float, float, float] | None = None
    unknown: Unknown = "free"
    method: Method = "planes"
    meshes: tuple[MeshInput, ...] = ()
    before: EarlierScene | None = None

    @property
    def settings(self) -> SceneSettings:
        """The settings of the scene, without its clouds."""
        clouds = self.clouds
        return SceneSettings(clouds.reach_m, clouds.top_m, clouds.bottom_m, clouds.seed, self.unknown, self.method)


@dataclass(frozen=True)
class BuiltScene:
    """A built scene: ``data`` is the content of its file, the rest is for the HTML page.

    ``mesh_points`` are the indices of obstacle points on known meshes, by the name of one of the mesh's pieces.
    """

    data: dict[str, Any]
    perceived: Perceived
    hits: tuple[Detection, ...]
    mesh_points: Mapping[str, Int[np.ndarray, "K"]]


def apply_earlier_settings(
    before: EarlierScene, request: SceneInput, explicit: Mapping[str, str], option: str
) -> SceneInput:
    """Return the input with the settings of the earlier scene.

    Args:
        explicit: settings given by the user, with their options; their values must equal the earlier scene's.
        option: name of the option for updates.

    Raises:
        RequestError: a given setting differs from the earlier scene's.
    """
    settings = before.settings
    for name, flag in sorted(explicit.items()):
        was, wanted = getattr(settings, name), getattr(request.settings, name)
        if was != wanted:
            raise RequestError(
                f"{flag}: {before.path} was made with {was}, and an update keeps to that; leave it out, "
                f"or leave out {option}"
            )
    clouds = replace(
        request.clouds, reach_m=settings.reach_m, top_m=settings.top_m, bottom_m=settings.bottom_m, seed=settings.seed
    )
    return replace(request, clouds=clouds, unknown=settings.unknown, method=settings.method, before=before)


def build_scene(request: SceneInput, on_step: OnStep, time_limit_s: float | None = None) -> BuiltScene:
    """Build a scene from cloud files, or update an earlier one.

    Args:
        request: clouds and settings.
        on_step: called with the name of each step before it begins.
        time_limit_s: limit for all together; hits until then are returned, and kinds not searched are listed.

    Raises:
        RequestError: a file, name or value cannot be used.
        OutOfTimeError: the time limit was reached before the pieces were made.
    """
    started = time.perf_counter()
    kinds = check_kinds(request.kinds, "--detect")
    check_hint(request.hint)
    search = None
    try:
        with limit_time(time_limit_s):
            known = load_known_meshes(request.meshes)
            read = read_input(request.clouds, on_step)
            on_step("find pieces" if request.before is None else "update pieces")
            with tells_progress(on_step):
                seen = _perceive(request, read, known)
            if known:
                on_step("split meshes")
            meshes = place_meshes(known, request.meshes, seen.matches)
            search = Search()
            search_objects(kinds, seen.view, request.hint, on_step, search)
    except PerceptionError as error:
        raise RequestError(f"{request.clouds.files_text}: {error}") from None
    except TimeOver:
        if search is None:
            raise OutOfTimeError(
                f"--time-limit: {time_limit_s:g} s were over before the pieces were made; expected more"
            ) from None
    if request.before is not None:
        meshes += [
            request.before.place_mesh(mesh, seen)
            for mesh in request.before.meshes_without([mesh.name for mesh in known])
        ]
    hits = settle_overlaps(search.hits)
    mesh_points = {mesh.pieces[0].name: mesh.explains(seen.view.obstacles) for mesh in meshes if mesh.pieces}
    data = scene_document(
        request.settings,
        _encode_pieces(request, seen, meshes),
        floor=[_encode_level(level) for level in seen.view.floors],
        searched=list(search.kinds),
        unfinished=search.unfinished(kinds),
        detections=[encode_hit(hit) | encode_parts(hit, seen.view.cloud) for hit in hits],
        meshes=[mesh.to_json() for mesh in meshes],
        timings=to_json_data(dict(seen.timings)),
        notes=[
            *seen.notes,
            *hint_notes(seen.view, request.hint),
            *(note for mesh in meshes for note in mesh.notes),
            *search.notes,
        ],
    )
    data["figures"] = {
        **count_points(read, seen.view),
        **_count_parts(data),
        "covered_points": _covered_share(seen, mesh_points),
        "reach_m": request.clouds.reach_m,
        "top_m": request.clouds.top_m,
        "bottom_m": request.clouds.bottom_m,
        "time_s": round(time.perf_counter() - started, 3),
    }
    return BuiltScene(data, seen, tuple(hits), mesh_points)


def _perceive(request: SceneInput, read: CloudRead, known: tuple[KnownMesh, ...]) -> Perceived:
    """Perceive the scan, alone or as an update of the earlier scene."""
    before = request.before
    if before is not None:
        still = tuple(before.rebuild_mesh(mesh) for mesh in before.meshes_without([mesh.name for mesh in known]))
        return update(before.earlier, read.cloud, robot_hulls=read.hulls, soles=read.soles, known=(*known, *still))
    return perceive(
        read.cloud,
        reach=request.clouds.reach,
        robot_hulls=read.hulls,
        soles=read.soles,
        unknown=request.unknown,
        seed=request.clouds.seed,
        method=request.method,
        known=known,
    )


def _encode_pieces(request: SceneInput, seen: Perceived, meshes: Sequence[PlacedMesh]) -> dict[str, Any]:
    """Return the pieces with their evidence, and the changes since the earlier scene."""
    pieces = [*seen.scene.pieces, *(piece for mesh in meshes for piece in mesh.pieces)]
    facts = {piece.name: {"seen": _encode_evidence(piece)} for piece in seen.pieces}
    data: dict[str, Any] = {"pieces": [{**encode_piece(piece), **facts.get(piece.name, {})} for piece in pieces]}
    if request.before is not None:
        data["update"] = {"previous": str(request.before.path), **request.before.list_changes(pieces)}
    return data


def _encode_evidence(piece: Piece) -> dict[str, object]:
    """Return the evidence of a piece: number of points, shares of rays, and its plane."""
    summary = {key: value for key, value in piece.summary().items() if key not in ("name", "kind")}
    return {**summary, "plane": to_json_data(piece.plane)}


def _count_parts(data: Mapping[str, Any]) -> dict[str, Any]:
    changes = data.get("update", {})
    return {
        "pieces": len(data["pieces"]),
        **{f"{how}_pieces": len(names) for how, names in changes.items() if how != "previous"},
        "largest_piece_vertices": max((len(piece["vertices"]) for piece in data["pieces"]), default=0),
        "floor_levels": len(data["floor"]),
        "detections": len(data["detections"]),
        "meshes": len(data["meshes"]),
    }


def _covered_share(seen: Perceived, mesh_points: Mapping[str, Int[np.ndarray, "K"]]) -> float | None:
    """Return the share of the obstacle points inside a piece; None without obstacle points."""
    is_held = np.zeros(len(seen.view.obstacles), dtype=bool)
    for points in (*(piece.points for piece in seen.pieces), *mesh_points.values()):
        is_held[points] = True
    return round(float(is_held.mean()), 4) if len(is_held) else None


def _encode_level(level: FloorPlane) -> dict[str, Any]:
    """Return a floor level as JSON data: the plane ``normal . x == offset``, unbounded without outlines."""
    return {
        "normal": to_json_data(level.normal),
        "offset": float(level.offset),
        "slope_deg": round(level.slope_deg, 3),
        "rms_m": float(level.rms),
        "area_m2": round(float(level.area), 3),
        "outlines": to_json_data(list(level.outlines)),
    }
