"""``scopt scene``: cloud files as pieces, floor, objects and figures, JSON-ready."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Int

from perception import Detection, FloorPlane, Perceived, PerceptionError, Piece, perceive, update
from perception.solids.match import KnownMesh
from service.errors import RequestError
from service.json_data import piece_json, plain
from service.request.choices import Method, Unknown
from service.scan.cloud import CloudInput, CloudRead, OnStep, read_input, view_figures
from service.scan.detect import Search, check_hint, check_kinds, hint_notes, hit_json, search_objects
from service.scan.earlier import EarlierScene
from service.scan.known_meshes import MeshInput, PlacedMesh, load_known_meshes, place_meshes
from service.scan.scene_file import SceneSettings, scene_document
from service.scan.time_limit import OutOfTimeError, TimeOver, limit_time


@dataclass(frozen=True)
class SceneInput:
    """What to make of the clouds.

    Attributes:
        clouds: the files.
        kinds: of objects to look for; ``all`` for every kind.
        hint: a point near the object that is looked for [m].
        unknown: what space no ray has seen is taken for.
        method: how pieces are made.
        meshes: known objects, placed or to be found.
        before: what an earlier scan of the same scene showed, which is held against this one; it was made with the
            same reach, seed, ``unknown`` and ``method``.
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
        """What the scene is made with, apart from its clouds."""
        clouds = self.clouds
        return SceneSettings(clouds.reach_m, clouds.top_m, clouds.bottom_m, clouds.seed, self.unknown, self.method)


@dataclass(frozen=True)
class BuiltScene:
    """A scan's world: ``data`` is what the file holds, the rest what the page is made from.

    ``mesh_points`` are indices of the obstacle points of known meshes, by the name of a piece of the mesh.
    """

    data: dict[str, Any]
    perceived: Perceived
    hits: tuple[Detection, ...]
    mesh_points: Mapping[str, Int[np.ndarray, "K"]]


def apply_earlier_settings(before: EarlierScene, asked: SceneInput, said: Mapping[str, str], option: str) -> SceneInput:
    """What was asked, with the settings of the scene before.

    Args:
        said: settings that the user has said, and what they are called there; they have to be those of the scene.
        option: what the update is called there.

    Raises:
        RequestError: one of them is not.
    """
    of = before.settings
    for name, called in sorted(said.items()):
        was, wanted = getattr(of, name), getattr(asked.settings, name)
        if was != wanted:
            raise RequestError(
                f"{called}: {before.path} was made with {was}, and an update keeps to that; leave it out, "
                f"or leave out {option}"
            )
    clouds = replace(asked.clouds, reach_m=of.reach_m, top_m=of.top_m, bottom_m=of.bottom_m, seed=of.seed)
    return replace(asked, clouds=clouds, unknown=of.unknown, method=of.method, before=before)


def build_scene(asked: SceneInput, on_step: OnStep, time_limit_s: float | None = None) -> BuiltScene:
    """Pieces, floor, objects and figures of cloud files.

    Args:
        asked: files and what to make of them.
        on_step: told the name of each step before it begins.
        time_limit_s: of all together; objects found until then are given, and what was not looked for is named.

    Raises:
        RequestError: one line for a file, name or value that cannot be used.
        OutOfTimeError: the time was over before the pieces were made.
    """
    started = time.perf_counter()
    kinds = check_kinds(asked.kinds, "--detect")
    check_hint(asked.hint)
    search = None
    try:
        with limit_time(time_limit_s):
            known = load_known_meshes(asked.meshes)
            read = read_input(asked.clouds, on_step)
            on_step("find pieces" if asked.before is None else "update pieces")
            seen = _seen(asked, read, known)
            if known:
                on_step("split meshes")
            meshes = place_meshes(known, asked.meshes, seen.matches)
            search = Search()
            search_objects(kinds, seen.view, asked.hint, on_step, search)
    except PerceptionError as error:
        raise RequestError(f"{asked.clouds.named}: {error}") from None
    except TimeOver:
        if search is None:
            raise OutOfTimeError(
                f"--time-limit: {time_limit_s:g} s were over before the pieces were made; expected more"
            ) from None
    if asked.before is not None:
        meshes += [asked.before.placed(one, seen) for one in asked.before.without([one.name for one in known])]
    mesh_points = {mesh.pieces[0].name: mesh.explains(seen.view.obstacles) for mesh in meshes if mesh.pieces}
    data = scene_document(
        asked.settings,
        _pieces(asked, seen, meshes),
        floor=[_level_json(level) for level in seen.view.floors],
        searched=list(search.kinds),
        unfinished=search.unfinished(kinds),
        detections=[hit_json(hit) for hit in search.hits],
        meshes=[mesh.to_json() for mesh in meshes],
        timings=plain(dict(seen.timings)),
        notes=[
            *seen.notes,
            *hint_notes(seen.view, asked.hint),
            *(note for mesh in meshes for note in mesh.notes),
            *search.notes,
        ],
    )
    data["figures"] = {
        **view_figures(read, seen.view),
        **_figures(data),
        "covered_points": _share(seen, mesh_points),
        "reach_m": asked.clouds.reach_m,
        "top_m": asked.clouds.top_m,
        "bottom_m": asked.clouds.bottom_m,
        "time_s": round(time.perf_counter() - started, 3),
    }
    return BuiltScene(data, seen, tuple(search.hits), mesh_points)


def _seen(asked: SceneInput, read: CloudRead, known: tuple[KnownMesh, ...]) -> Perceived:
    """What the scan shows, by itself or held against the scene before."""
    before = asked.before
    if before is not None:
        still = tuple(before.known(one) for one in before.without([one.name for one in known]))
        return update(before.earlier, read.cloud, robot_hulls=read.hulls, soles=read.soles, known=(*known, *still))
    return perceive(
        read.cloud,
        reach=asked.clouds.reach,
        robot_hulls=read.hulls,
        soles=read.soles,
        unknown=asked.unknown,
        seed=asked.clouds.seed,
        method=asked.method,
        known=known,
    )


def _pieces(asked: SceneInput, seen: Perceived, meshes: Sequence[PlacedMesh]) -> dict[str, Any]:
    """The pieces, each with what the scan says of it, and how they differ from those of the scene before."""
    pieces = [*seen.scene.pieces, *(piece for mesh in meshes for piece in mesh.pieces)]
    facts = {piece.name: {"seen": piece_evidence(piece)} for piece in seen.pieces}
    told: dict[str, Any] = {"pieces": [{**piece_json(piece), **facts.get(piece.name, {})} for piece in pieces]}
    if asked.before is not None:
        told["update"] = {"previous": str(asked.before.path), **asked.before.changes(pieces)}
    return told


def piece_evidence(piece: Piece) -> dict[str, object]:
    """What a scan says of a piece: how many points it stands for, what the rays about it saw, the plane it is on."""
    told = {key: value for key, value in piece.summary().items() if key not in ("name", "kind")}
    return {**told, "plane": plain(piece.plane)}


def _figures(data: Mapping[str, Any]) -> dict[str, Any]:
    changes = data.get("update", {})
    return {
        "pieces": len(data["pieces"]),
        **{f"{how}_pieces": len(names) for how, names in changes.items() if how != "previous"},
        "largest_piece_vertices": max((len(piece["vertices"]) for piece in data["pieces"]), default=0),
        "floor_levels": len(data["floor"]),
        "detections": len(data["detections"]),
        "meshes": len(data["meshes"]),
    }


def _share(seen: Perceived, mesh_points: Mapping[str, Int[np.ndarray, "K"]]) -> float | None:
    """Share of the obstacle points that a piece stands for; None when there are none."""
    is_held = np.zeros(len(seen.view.obstacles), dtype=bool)
    for points in (*(piece.points for piece in seen.pieces), *mesh_points.values()):
        is_held[points] = True
    return round(float(is_held.mean()), 4) if len(is_held) else None


def _level_json(level: FloorPlane) -> dict[str, Any]:
    """A level of the floor: the plane ``normal . x == offset``; without outlines it goes on as far as it matters."""
    return {
        "normal": plain(level.normal),
        "offset": float(level.offset),
        "slope_deg": round(level.slope_deg, 3),
        "rms_m": float(level.rms),
        "area_m2": round(float(level.area), 3),
        "outlines": plain(list(level.outlines)),
    }
