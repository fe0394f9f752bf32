"""``scopt scene``: cloud files as a JSON file of convex pieces, with a page beside it that shows them."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perception import Detection, FloorPlane, Perceived, PerceptionError, Piece, perceive
from service.cloud_asked import CloudAsked, OnStep, read_asked, view_figures
from service.detect_file import check_hint, checked_kinds, found, hint_notes, hit_json
from service.errors import RequestError, ResultError
from service.result_json import piece_json, plain
from service.scan_choices import Method, Unknown

FORMAT = "scopt-scene/1"


@dataclass(frozen=True)
class SceneAsked:
    """What to make of the clouds.

    Attributes:
        clouds: the files.
        kinds: of objects to look for; ``all`` for every kind.
        hint: a point near the object that is looked for [m].
        unknown: what space no ray has seen is taken for.
        method: how pieces are made.
    """

    clouds: CloudAsked
    kinds: tuple[str, ...] = ()
    hint: tuple[float, float, float] | None = None
    unknown: Unknown = "free"
    method: Method = "planes"


@dataclass(frozen=True)
class SceneSeen:
    """A scan's world: ``data`` is what the file holds, the rest what the page is made from."""

    data: dict[str, Any]
    perceived: Perceived
    hits: tuple[Detection, ...]


def see_files(asked: SceneAsked, on_step: OnStep) -> SceneSeen:
    """Pieces, floor, objects and figures of cloud files.

    Args:
        asked: files and what to make of them.
        on_step: told the name of each step before it begins.

    Raises:
        RequestError: one line for a file, name or value that cannot be used.
    """
    started = time.perf_counter()
    kinds = checked_kinds(asked.kinds, "--detect")
    check_hint(asked.hint)
    read = read_asked(asked.clouds, on_step)
    try:
        on_step("find pieces")
        seen = perceive(
            read.cloud,
            reach=asked.clouds.reach,
            robot_hulls=read.hulls,
            soles=read.soles,
            valve=False,
            unknown=asked.unknown,
            seed=asked.clouds.seed,
            method=asked.method,
        )
    except PerceptionError as error:
        raise RequestError(f"{asked.clouds.named}: {error}") from None
    hits = tuple(found(seen.view, kinds, asked.hint, on_step))
    pieces = seen.scene.pieces
    facts = {piece.name: {"seen": seen_of(piece)} for piece in seen.pieces}
    figures = {
        **view_figures(read, seen.view),
        "pieces": len(pieces),
        "largest_piece_vertices": max((len(piece.vertices) for piece in pieces), default=0),
        "covered_points": _share(seen),
        "floor_levels": len(seen.view.floors),
        "detections": len(hits),
        "reach_m": asked.clouds.reach_m,
        "top_m": asked.clouds.top_m,
        "bottom_m": asked.clouds.bottom_m,
        "time_s": round(time.perf_counter() - started, 3),
    }
    data = {
        "format": FORMAT,
        "pieces": [{**piece_json(piece), **facts.get(piece.name, {})} for piece in pieces],
        "floor": [_level_json(level) for level in seen.view.floors],
        "searched": list(kinds),
        "detections": [hit_json(hit) for hit in hits],
        "figures": figures,
        "timings": plain(dict(seen.timings)),
        "notes": [*seen.notes, *hint_notes(seen.view, asked.hint)],
    }
    return SceneSeen(data, seen, hits)


def seen_of(piece: Piece) -> dict[str, object]:
    """What a scan says of a piece: how many points it stands for, and what the rays about it saw."""
    return {key: value for key, value in piece.summary().items() if key not in ("name", "kind")}


def check_out(path: Path, inputs: Iterable[Path]) -> None:
    """Refuse a place for the scene where it, or the page beside it, would overwrite what it is made from.

    Raises:
        RequestError: the name does not end in .json, or is, as the page's may be, one of the inputs.
    """
    if path.suffix.lower() != ".json":
        raise RequestError(f"--out: {path} does not end in .json; a name that does, of a file for the pieces, would do")
    read = {one.resolve() for one in inputs}
    for written in (path, _page_beside(path)):
        if written.resolve() in read:
            raise RequestError(f"--out: {written} is read and would be overwritten; another name would do")


def write_scene(seen: SceneSeen, path: Path) -> Path:
    """Write the scene as JSON, and beside it the page that shows it; each as a whole or not at all.

    Args:
        seen: what to write.
        path: a name that ``check_out`` accepts.

    Returns:
        The page's path.

    Raises:
        ResultError: a file cannot be written.
    """
    from service.scene_view import render_scene

    page = _page_beside(path)
    _replace(path, json.dumps(seen.data, allow_nan=False))
    _replace(page, render_scene(seen.data, seen.perceived, seen.hits, path.stem))
    return page


def _page_beside(path: Path) -> Path:
    return path.with_suffix(".html")


def _replace(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as scratch:
            fresh = Path(scratch) / path.name
            fresh.write_text(text, encoding="utf-8")
            os.replace(fresh, path)
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror or error}") from None


def _share(seen: Perceived) -> float | None:
    """Share of the obstacle points that a piece stands for; None when there are none."""
    n_points = len(seen.view.obstacles)
    held: Sequence[int] = [len(piece.points) for piece in seen.pieces]
    return round(sum(held) / n_points, 4) if n_points else None


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
