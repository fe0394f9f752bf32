"""Page of a perceived scan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from perception import Perceived
from perception.convex.freespace import carve
from service.viewer.html import render_page
from service.viewer.payload import pack, pack_hull, quantize, thin_points

if TYPE_CHECKING:
    from service.scan.make_scene import BuiltScene

MAX_POINTS = 80_000
MAX_CELLS = 1_500_000
MAX_DETECTION_POINTS = 2_000
MAX_SENSORS = 100
UNASSIGNED, FLOOR, LEFT_OUT = 65535, 65534, 65533  # owners of points that belong to no piece
_CELL = 0.05  # smallest edge of the grid's cells [m]
_MARGIN = 0.15  # of the grid around the points [m]


def render_scene(built: BuiltScene, title: str) -> str:
    """Return the page of a scan, which works offline."""
    return render_page(make_scene_payload(built, title), title, "scene")


def make_scene_payload(built: BuiltScene, title: str) -> dict[str, Any]:
    """Return everything the page draws, JSON-ready."""
    scene, perceived = built.data, built.perceived
    points, owner = _assign_points(built, perceived.view.is_floor)
    change = {name: how for how in ("stayed", "changed", "new") for name in scene.get("update", {}).get(how, ())}
    return {
        "title": title,
        "figures": scene["figures"],
        "notes": scene["notes"],
        "kinds": scene["searched"],
        "pieces": [
            {
                "name": piece["name"],
                "kind": piece["kind"],
                "facts": piece.get("seen"),
                "change": change.get(piece["name"]),
                "hull": pack_hull(piece),
            }
            for piece in scene["pieces"]
        ],
        "detections": [
            {**entry, "points": quantize(thin_points(np.asarray(hit.points, dtype=float), MAX_DETECTION_POINTS))}
            for entry, hit in zip(scene["detections"], built.hits, strict=True)
        ],
        "meshes": scene["meshes"],
        "cloud": quantize(points),
        "owner": pack(owner, "u2"),
        "sensors": _list_sensors(perceived).tolist(),
        "space": _make_space(perceived, perceived.view.is_floor),
    }


def _assign_points(
    built: BuiltScene, is_floor: Bool[np.ndarray, "N"]
) -> tuple[Float[np.ndarray, "M 3"], Int[np.ndarray, "M"]]:
    """Return the points in reach, thinned, and the owner of each: index of its piece, or one of the constants above."""
    view = built.perceived.view
    number = {piece["name"]: i for i, piece in enumerate(built.data["pieces"])}
    obstacles = np.full(len(view.obstacles), UNASSIGNED)
    for name, points in (*built.mesh_points.items(), *((piece.name, piece.points) for piece in built.perceived.pieces)):
        obstacles[points] = number[name]
    rest = view.near.points[~is_floor & ~_find_among(view.near.points, view.obstacles)]
    parts = [(view.obstacles, obstacles)]
    parts += [(view.near.points[is_floor], np.full(int(is_floor.sum()), FLOOR)), (rest, np.full(len(rest), LEFT_OUT))]
    points, owner = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    step = -(-len(points) // MAX_POINTS)
    return points[::step], owner[::step]


def _find_among(points: Float[np.ndarray, "N 3"], chosen: Float[np.ndarray, "M 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points are also among the chosen ones, exactly."""
    rows = np.ascontiguousarray(np.concatenate([points, chosen])).view([("", np.float64)] * 3).ravel()
    return np.isin(rows[: len(points)], rows[len(points) :])


def _list_sensors(perceived: Perceived) -> Float[np.ndarray, "S 3"]:
    """Return the origins of the rays, rounded to 0.1 m."""
    return thin_points(np.unique(np.round(perceived.view.cloud.starts, 1), axis=0), MAX_SENSORS)


def _make_space(perceived: Perceived, is_floor: Bool[np.ndarray, "N"]) -> dict[str, Any]:
    """Return a grid of cells, one bit each, x slowest: those with points of surfaces, and others that rays crossed.

    ``size`` is the edge of a cell [m].  A cell that is neither is unknown.
    """
    view = perceived.view
    lower, upper = view.near.points.min(axis=0) - _MARGIN, view.near.points.max(axis=0) + _MARGIN
    size = max(_CELL, float((np.prod(upper - lower) / MAX_CELLS) ** (1.0 / 3.0)))
    space = carve(*view.cloud.rays, view.near.points[:0], lower, upper, size)
    occupied = np.zeros(space.free.shape, dtype=bool)
    surfaces = np.concatenate([view.obstacles, view.near.points[is_floor]])
    occupied[tuple(np.floor((surfaces - space.lower) / space.size).astype(int).T)] = True
    return {
        "lower": space.lower.tolist(),
        "size": float(space.size),
        "shape": list(space.free.shape),
        "free": _pack_bits(space.free & ~occupied),
        "occupied": _pack_bits(occupied),
    }


def _pack_bits(cells: Bool[np.ndarray, "X Y Z"]) -> dict[str, Any]:
    return pack(np.packbits(cells.ravel(), bitorder="little"), "u1")
