"""A perceived scan as the page reads it: thinned, packed, and free of what is not drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from perception import Perceived, on_floors
from perception.convex.freespace import carve
from service.viewer.frames import pack, quantize
from service.viewer.html import render_page
from service.viewer.payload import hull_of

if TYPE_CHECKING:
    from service.scan.make_scene import BuiltScene

MAX_POINTS = 80_000
MAX_CELLS = 1_500_000
MAX_DETECTION_POINTS = 2_000
NOBODYS, FLOORS, LEFT_OUT = 65535, 65534, 65533
_CELL = 0.05
_AROUND = 0.15


def render_scene(seen: BuiltScene, title: str) -> str:
    """The page of a scan: one file that asks the network for nothing."""
    return render_page(payload_of(seen, title), title, "scene")


def payload_of(seen: BuiltScene, title: str) -> dict[str, Any]:
    """Everything the page draws, JSON-ready.

    Args:
        seen: what the scan shows.
        title: what to call it.
    """
    scene, perceived = seen.data, seen.perceived
    points, owner = _owned_points(seen)
    change = {name: how for how in ("stayed", "changed", "new") for name in scene.get("update", {}).get(how, ())}
    return {
        "title": title,
        "figures": scene["figures"],
        "notes": scene["notes"],
        "kinds": scene["searched"],
        "pieces": [
            {
                "name": one["name"],
                "kind": one["kind"],
                "facts": one.get("seen"),
                "change": change.get(one["name"]),
                "hull": hull_of(one),
            }
            for one in scene["pieces"]
        ],
        "detections": [
            {**entry, "points": quantize(_some(np.asarray(hit.points, dtype=float), MAX_DETECTION_POINTS))}
            for entry, hit in zip(scene["detections"], seen.hits, strict=True)
        ],
        "meshes": scene["meshes"],
        "cloud": quantize(points),
        "owner": pack(owner, "u2"),
        "sensors": _places(perceived).tolist(),
        "space": _space(perceived),
    }


def _owned_points(seen: BuiltScene) -> tuple[Float[np.ndarray, "M 3"], Int[np.ndarray, "M"]]:
    """Points in reach, thinned, and what each belongs to: number of its piece, the floor, nobody, or left out."""
    view = seen.perceived.view
    number = {piece["name"]: i for i, piece in enumerate(seen.data["pieces"])}
    obstacles = np.full(len(view.obstacles), NOBODYS)
    for name, points in (*seen.mesh_points.items(), *((piece.name, piece.points) for piece in seen.perceived.pieces)):
        obstacles[points] = number[name]
    is_floor = on_floors(view.near.points, view.floors)
    rest = view.near.points[~is_floor & ~_among(view.near.points, view.obstacles)]
    parts = [(view.obstacles, obstacles)]
    parts += [(view.near.points[is_floor], np.full(int(is_floor.sum()), FLOORS)), (rest, np.full(len(rest), LEFT_OUT))]
    points, owner = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    step = -(-len(points) // MAX_POINTS)
    return points[::step], owner[::step]


def _among(points: Float[np.ndarray, "N 3"], chosen: Float[np.ndarray, "M 3"]) -> Bool[np.ndarray, "N"]:
    """Which points are also among the chosen ones, exactly."""
    rows = np.ascontiguousarray(np.concatenate([points, chosen])).view([("", np.float64)] * 3).ravel()
    return np.isin(rows[: len(points)], rows[len(points) :])


def _some(points: Float[np.ndarray, "N 3"], most: int) -> Float[np.ndarray, "M 3"]:
    return points[:: max(1, -(-len(points) // most))]


def _places(perceived: Perceived) -> Float[np.ndarray, "S 3"]:
    """Where rays started, to a decimetre, at most 100 places."""
    starts = np.unique(np.round(perceived.view.cloud.starts, 1), axis=0)
    return _some(starts, 100)


def _space(perceived: Perceived) -> dict[str, Any]:
    """A grid of cells, one bit for each, x slowest: where points of surfaces are, and what else rays went through.

    ``size`` is the edge of a cell [m].  A cell that is neither was seen by nobody.
    """
    view = perceived.view
    lower, upper = view.near.points.min(axis=0) - _AROUND, view.near.points.max(axis=0) + _AROUND
    size = max(_CELL, float((np.prod(upper - lower) / MAX_CELLS) ** (1.0 / 3.0)))
    space = carve(*view.cloud.rays, view.near.points[:0], lower, upper, size)
    occupied = np.zeros(space.free.shape, dtype=bool)
    surfaces = np.concatenate([view.obstacles, view.near.points[on_floors(view.near.points, view.floors)]])
    occupied[tuple(np.floor((surfaces - space.lower) / space.size).astype(int).T)] = True
    return {
        "lower": space.lower.tolist(),
        "size": float(space.size),
        "shape": list(space.free.shape),
        "free": _bits(space.free & ~occupied),
        "occupied": _bits(occupied),
    }


def _bits(cells: Bool[np.ndarray, "X Y Z"]) -> dict[str, Any]:
    return pack(np.packbits(cells.ravel(), bitorder="little"), "u1")
