"""A perceived scan as the page reads it: thinned, packed, and free of what is not drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from perception import Detection, Perceived, on_floors
from perception.convex.freespace import carve
from service.viewer.frames import packed, quantized
from service.viewer.html import render_page
from service.viewer.payload import hull_of

MAX_POINTS = 80_000
MAX_CELLS = 1_500_000
MAX_DETECTION_POINTS = 2_000
NOBODYS, FLOORS, LEFT_OUT = 65535, 65534, 65533
_CELL = 0.05
_AROUND = 0.15


def render_scene(scene: Mapping[str, Any], perceived: Perceived, hits: Sequence[Detection], title: str) -> str:
    """The page of a scan: one file that asks the network for nothing."""
    return render_page(payload_of(scene, perceived, hits, title), title, "scene")


def payload_of(scene: Mapping[str, Any], perceived: Perceived, hits: Sequence[Detection], title: str) -> dict[str, Any]:
    """Everything the page draws, JSON-ready.

    Args:
        scene: what the scene file holds.
        perceived: what it was made from.
        hits: the detections, in the order of ``scene["detections"]``.
        title: what to call the scan.
    """
    points, owner = _owned_points(perceived, [piece["name"] for piece in scene["pieces"]])
    return {
        "title": title,
        "figures": scene["figures"],
        "notes": scene["notes"],
        "kinds": scene["searched"],
        "pieces": [
            {"name": one["name"], "kind": one["kind"], "facts": one.get("seen"), "hull": hull_of(one)}
            for one in scene["pieces"]
        ],
        "detections": [
            {**entry, "points": quantized(_some(np.asarray(hit.points, dtype=float), MAX_DETECTION_POINTS))}
            for entry, hit in zip(scene["detections"], hits, strict=True)
        ],
        "cloud": quantized(points),
        "owner": packed(owner, "u2"),
        "sensors": _places(perceived).tolist(),
        "free": _free_space(perceived),
    }


def _owned_points(perceived: Perceived, names: Sequence[str]) -> tuple[Float[np.ndarray, "M 3"], Int[np.ndarray, "M"]]:
    """Points in reach, thinned, and what each belongs to: number of its piece, the floor, nobody, or left out."""
    view = perceived.view
    number = {name: i for i, name in enumerate(names)}
    obstacles = np.full(len(view.obstacles), NOBODYS)
    for piece in perceived.pieces:
        obstacles[piece.points] = number[piece.name]
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


def _free_space(perceived: Perceived) -> dict[str, Any]:
    """The grid of cells that rays went through, one bit for each, x slowest; ``size`` is the edge of a cell [m]."""
    view = perceived.view
    lower, upper = view.near.points.min(axis=0) - _AROUND, view.near.points.max(axis=0) + _AROUND
    size = max(_CELL, float((np.prod(upper - lower) / MAX_CELLS) ** (1.0 / 3.0)))
    space = carve(*view.cloud.rays, view.near.points, lower, upper, size)
    bits = np.packbits(space.free.ravel(), bitorder="little")
    return {
        "lower": space.lower.tolist(),
        "size": float(space.size),
        "shape": list(space.free.shape),
        "bits": packed(bits, "u1"),
    }
