"""Result of a search for a stance: JSON, a picture from above, and the request with the stance filled in."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from service.errors import RequestError
from service.request.file import parse_request, read_plain_request
from service.start.standing import FLOOR_KIND
from service.tasks.stances.poses import StanceTask
from service.tasks.stances.search import StanceCandidate, StanceSearch

SCALE = 200.0  # pixels per metre
MARGIN_M = 0.7  # of the picture about places and mechanism
HEAD_M = 2.0  # pieces that begin higher are left out of the picture
MOST_DRAWN = 12
JSON_NAME, PICTURE_NAME = "stance.json", "stance.svg"


@dataclass(frozen=True)
class WrittenStance:
    """Files of a search: its JSON, the picture, and the request with the best stance if it was asked for."""

    json: Path
    picture: Path
    request: Path | None


def describe_search(search: StanceSearch) -> dict[str, Any]:
    """Return the search as plain JSON data: ``best`` is a request's ``start.base``, or None."""
    best = search.best
    return {
        "best": None if best is None else _describe_base(best),
        "candidates": [_describe_candidate(search, candidate) for candidate in search.candidates],
        "notes": list(search.notes),
        "ranked": search.n_ranked,
        "is_complete": search.is_complete,
        "seconds": round(search.seconds, 3),
    }


def write_search(search: StanceSearch, folder: Path) -> tuple[Path, Path]:
    """Write ``stance.json`` and ``stance.svg`` to a folder, which is made; return both paths.

    Raises:
        RequestError: the folder cannot be written to.
    """
    data, picture = folder / JSON_NAME, folder / PICTURE_NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        data.write_text(json.dumps(describe_search(search), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        picture.write_text(draw_search(search), encoding="utf-8")
    except OSError as error:
        raise RequestError(f"--out: {folder} cannot be written to: {error.strerror}") from None
    return data, picture


def write_request(request: Path, candidate: StanceCandidate, out: Path) -> None:
    """Write a request file with a candidate as ``start.base``; its relative paths are adapted to the new folder.

    Raises:
        RequestError: the file cannot be written.
    """
    data = read_plain_request(request)
    start = {**(data.get("start") or {}), "base": _describe_base(candidate)}
    data = _move_paths({**data, "start": start}, request.parent, out.parent)
    parse_request(data, out.parent)
    try:
        out.write_text(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")
    except OSError as error:
        raise RequestError(f"--write: {out} cannot be written: {error.strerror}") from None


def draw_search(search: StanceSearch) -> str:
    """Return the picture from above as SVG: pieces, mechanism before and after, and the soles of the best places."""
    drawn = [candidate for candidate in search.candidates if not candidate.refused][:MOST_DRAWN]
    refused = [candidate for candidate in search.candidates if candidate.refused]
    before, after = (_draw_parts(search.task, is_end=is_end) for is_end in (False, True))
    points = [*before, *after, *(sole[:, :2] for candidate in drawn for sole in candidate.soles.values())]
    points += [candidate.base[None, :2] for candidate in refused] + [search.setup.start[None, :2]]
    low = np.concatenate(points).min(axis=0) - MARGIN_M
    high = np.concatenate(points).max(axis=0) + MARGIN_M
    width, height = SCALE * (high - low)

    def place(corners: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        return np.column_stack([SCALE * (corners[:, 0] - low[0]), SCALE * (high[1] - corners[:, 1])])

    def polygon(corners: Float[np.ndarray, "N 2"], style: str, title: str) -> str:
        pairs = " ".join(f"{x:.1f},{y:.1f}" for x, y in place(_hull(corners)))
        return f'<polygon points="{pairs}" {style}><title>{escape(title)}</title></polygon>'

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height + 60.0:.0f}" '
        f'width="{width:.0f}" height="{height + 60.0:.0f}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width:.0f}" height="{height + 60.0:.0f}" fill="white"/>',
    ]
    for piece in search.setup.scene.pieces:
        corners = piece.vertices
        is_drawn = piece.kind != FLOOR_KIND and corners[:, 2].min() < HEAD_M and corners[:, 2].max() > 0.05
        is_near = np.all(corners[:, :2].max(axis=0) > low) and np.all(corners[:, :2].min(axis=0) < high)
        if is_drawn and is_near:
            lines.append(polygon(corners[:, :2], 'fill="#d8d8d8" stroke="#999999"', piece.name))
    lines += [polygon(part, 'fill="none" stroke="#335577" stroke-dasharray="5 4"', "at the end") for part in after]
    lines += [polygon(part, 'fill="#8899bb" stroke="#335577"', "at the start") for part in before]
    for candidate in refused:
        ((x, y),) = place(candidate.base[None, :2])
        title = escape(candidate.refused[0])
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2" fill="#bbbbbb"><title>{title}</title></circle>')
    for rank, candidate in reversed(list(enumerate(drawn))):
        lines += _draw_candidate(candidate, rank, polygon, place)
    ((x, y),) = place(search.setup.start[None, :2])
    lines.append(
        f'<path d="M {x - 6:.1f} {y:.1f} h 12 M {x:.1f} {y - 6:.1f} v 12" stroke="black" stroke-width="2">'
        "<title>start of the request</title></path>"
    )
    lines.append(f'<rect y="{height:.0f}" width="{width:.0f}" height="60" fill="white"/>')
    lines += _draw_legend(height)
    return "\n".join([*lines, "</svg>"]) + "\n"


def _draw_candidate(candidate: StanceCandidate, rank: int, polygon: Any, place: Any) -> list[str]:
    colour = _colour(candidate.score)
    edge = 'stroke="black" stroke-width="2.5"' if rank == 0 else 'stroke="#555555" stroke-width="0.7"'
    style = f'fill="{colour}" fill-opacity="{0.95 if rank == 0 else 0.55}" {edge}'
    title = f"{rank + 1}: score {candidate.score:.2f}"
    shapes = [polygon(sole[:, :2], style, title) for sole in candidate.soles.values()]
    ahead = 0.25 * np.array([np.cos(candidate.base[2]), np.sin(candidate.base[2])])
    (x, y), (tip_x, tip_y) = place(np.stack([candidate.base[:2], candidate.base[:2] + ahead]))
    width = 2.5 if rank == 0 else 1.0
    shapes.append(
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{tip_x:.1f}" y2="{tip_y:.1f}" stroke="{colour}" stroke-width="{width}"/>'
    )
    if rank == 0:
        shapes.append(f'<text x="{tip_x + 4.0:.1f}" y="{tip_y:.1f}">{candidate.score:.2f}</text>')
    return shapes


def _draw_legend(top: float) -> list[str]:
    lines = []
    for at in range(11):
        fill = _colour(at / 10.0)
        lines.append(f'<rect x="{10 + 14 * at}" y="{top + 12:.0f}" width="14" height="12" fill="{fill}"/>')
    lines.append(f'<text x="10" y="{top + 42:.0f}">score 0 to 1</text>')
    lines.append(
        f'<line x1="200" y1="{top + 18:.0f}" x2="{200 + SCALE:.0f}" y2="{top + 18:.0f}" stroke="black" '
        f'stroke-width="2"/><text x="200" y="{top + 42:.0f}">1 m; x to the right, y up</text>'
    )
    return lines


def _colour(score: float) -> str:
    """Return red for 0, yellow, green for 1."""
    red, green = min(2.0 * (1.0 - score), 1.0), min(2.0 * score, 1.0)
    return f"#{int(210 * red):02x}{int(180 * green):02x}30"


def _hull(points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "H 2"]:
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points


def _draw_parts(task: StanceTask | None, *, is_end: bool) -> list[Float[np.ndarray, "N 2"]]:
    """Return the outlines of the mechanism's bodies from above, at the start or at the end."""
    return [] if task is None else [points[:, :2] for points in task.place_parts(is_end=is_end)]


def _describe_base(candidate: StanceCandidate) -> dict[str, Any]:
    return {"position": list(candidate.position), "quaternion_wxyz": list(candidate.quaternion_wxyz)}


def _describe_candidate(search: StanceSearch, candidate: StanceCandidate) -> dict[str, Any]:
    outcome = candidate.outcome
    data: dict[str, Any] = {
        "base": _describe_base(candidate),
        "yaw_deg": round(float(np.rad2deg((candidate.base[2] + np.pi) % (2.0 * np.pi) - np.pi)), 2),
        "score": round(candidate.score, 4),
        "refused": list(candidate.refused),
    }
    if outcome is not None and search.task is not None:
        task = search.task
        angles = (outcome.reached, task.whole) if task.is_angle else (None, None)
        reached, asked = (None if angle is None else round(float(np.rad2deg(angle)), 2) for angle in angles)
        data["parts"] = {
            "share": round(outcome.reached / task.whole, 4),
            "angle_deg": reached,
            "asked_deg": asked,
            "balance_m": round(outcome.balance_m, 4),
            "reach_m": round(outcome.reach_m, 4),
            "clearance_m": round(candidate.clearance_m, 4),
            "torque_share": round(outcome.torque_share, 3),
        }
        data["hold"], data["missing"] = outcome.hold, outcome.missing
    return data


def _move_paths(data: Mapping[str, Any], old: Path, new: Path) -> dict[str, Any]:
    """Return a request's data with its relative paths for a file in another folder."""

    def move(path: Any) -> Any:
        if not isinstance(path, str) or os.path.isabs(path):
            return path
        return os.path.relpath((old / path).absolute(), new.absolute())

    def move_fields(section: Any, fields: Sequence[str]) -> Any:
        if not isinstance(section, Mapping):
            return section
        return {key: move(value) if key in fields else value for key, value in section.items()}

    moved = {**data}
    if "robot" in moved:
        moved["robot"] = move_fields(moved["robot"], ("urdf", "srdf"))
        if isinstance(moved["robot"], dict) and "package_dirs" in moved["robot"]:
            moved["robot"]["package_dirs"] = [move(path) for path in moved["robot"]["package_dirs"]]
    scene = moved.get("scene")
    if isinstance(scene, Mapping):
        scene = move_fields(scene, ("file", "cloud"))
        if isinstance(scene.get("cloud"), list):
            scene["cloud"] = [move_fields(cloud, ("file",)) for cloud in scene["cloud"]]
        if isinstance(scene.get("obstacles"), list):
            scene["obstacles"] = [move_fields(obstacle, ("file",)) for obstacle in scene["obstacles"]]
        moved["scene"] = scene
    return moved
