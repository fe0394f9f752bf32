"""A result as the viewer page reads it: thinned to the frame rate, packed, and free of what is not drawn."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from service.viewer.frames import kept_samples, pack, quantize
from service.viewer.hulls import convex_mesh
from service.viewer.placements import LinkPlacements
from service.viewer.proof import ClearanceTrack, clearance_track

MAX_CLOUD_POINTS = 60_000


def make_payload(result: Mapping[str, Any], placements: LinkPlacements) -> dict[str, Any]:
    """Everything the page draws, JSON-ready.

    Args:
        result: a parsed ``result.json`` (docs/result-format.md).  Whatever a result without a trajectory lacks may
            be missing or null.
        placements: the links of ``result["bodies"]`` at the samples of ``result["trajectory"]``, or a single pose
            or none when there is no trajectory.

    Raises:
        ValueError: placements and trajectory have different numbers of samples, or a body's link has no placement.
    """
    times = sample_times(result, placements)
    missing = sorted({body["link"] for body in _list(result, "bodies")} - set(placements.links))
    if missing and len(times):
        raise ValueError(f"no placement for link {missing[0]!r} of the result's bodies")
    phases, waypoints = _list(result, "phases"), [int(i) for i in _list(result, "waypoints")]
    kept = kept_samples(times, [*waypoints, *(int(p[end]) for p in phases for end in ("first", "last"))])
    poses = placements.poses[kept]
    proof = clearance_track(result) if len(times) else None
    return {
        **_summary(result),
        "checks": _placed_checks(result, proof),
        "clearance": pack(_track_rows(proof), "f4"),
        "gaps": [] if proof is None else [{"names": list(g.pair), "start": g.start, "end": g.end} for g in proof.gaps],
        "obstruction": result.get("obstruction"),
        "shapeless": _shapeless(result, placements),
        "times": pack(times[kept], "f4"),
        "links": list(placements.links),
        "positions": quantize(poses[..., :3]),
        "rotations": pack(np.round(poses[..., 3:] * 32767.0), "i2"),
        "bodies": [{"name": b["name"], "link": b["link"], "hull": hull_of(b)} for b in _list(result, "bodies")],
        "pieces": [_named_hull(piece) for piece in _list(result, "pieces")],
        "movables": [_movable(movable, len(times), kept) for movable in _list(result, "movables")],
        "waypoints": np.searchsorted(kept, [i for i in waypoints if 0 <= i < len(times)]).tolist(),
        "phases": [_timed(phase, times) for phase in phases],
        "support": [_support(polygon, times) for polygon in _list(result, "support_polygons")],
        "com": pack(_rows(result, "com", len(times), 3)[kept], "f4"),
        "cloud": quantize(_cloud(result)),
    }


def sample_times(result: Mapping[str, Any], placements: LinkPlacements) -> Float[np.ndarray, "S"]:
    """Times of the placements [s]; a single pose without a trajectory stands at 0."""
    trajectory = result.get("trajectory") or {}
    times = np.asarray(trajectory.get("times") or [], dtype=float)
    n_poses = len(placements.poses)
    if len(times) == 0 and n_poses <= 1:
        return np.zeros(n_poses)
    if len(times) != n_poses:
        raise ValueError(f"trajectory has {len(times)} samples, placements have {n_poses}")
    return times


def hull_of(body: Mapping[str, Any]) -> dict[str, Any]:
    """The packed hull of anything with ``vertices``."""
    mesh = convex_mesh(np.asarray(body["vertices"], dtype=float))
    return {
        "vertices": pack(mesh.vertices, "f4"),
        "triangles": pack(mesh.triangles, "u2"),
        "edges": pack(mesh.edges, "u2"),
        "bends": pack(np.round(mesh.bends / np.pi * 255.0), "u1"),
    }


def json_safe(value: Any) -> Any:
    """The value with numbers that JSON lacks (NaN, infinities) as null and arrays as lists."""
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return json_safe(value.tolist())
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): json_safe(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(entry) for entry in value]
    return value


def _summary(result: Mapping[str, Any]) -> dict[str, Any]:
    request = result.get("request") or {}
    task = (request.get("task") or request.get("goal")) if isinstance(request, Mapping) else None
    robot, certificate, curve = (result.get(key) or {} for key in ("robot", "certificate", "curve"))
    return {
        "verdict": result.get("verdict", ""),
        "robot": robot.get("name", ""),
        "task": _task_name(task) if isinstance(task, Mapping) else "",
        "explanation": _list(result, "explanation"),
        "notes": _list(result, "notes"),
        "rests_on": [note for note in _list(certificate, "notes") if note not in _list(result, "notes")],
        "not_checked": _not_checked(result),
        "is_timed": not curve or curve.get("law") is not None,
        "figures": result.get("figures") or {},
        "timings": result.get("timings") or {},
        "planning_time_s": result.get("planning_time_s"),
        "min_clearance_m": result.get("min_clearance_m"),
        "min_clearance_pair": result.get("min_clearance_pair") or [],
        "min_balance_margin_m": result.get("min_balance_margin_m"),
        "request_hash": result.get("request_hash", ""),
    }


def _task_name(task: Mapping[str, Any]) -> str:
    """What is asked for, in one word: the first thing of the task or goal that is not empty."""
    named = next((str(name) for name, content in task.items() if content), "")
    return {"poses": "reach", "joints": "joint goal"}.get(named, named)


def _placed_checks(result: Mapping[str, Any], proof: ClearanceTrack | None) -> list[Mapping[str, Any]]:
    """The checks; the clearance of the whole curve is shown where its proof has least to spare.

    Of an untimed motion the path parameter stands for the time, as in its samples.
    """
    is_untimed = bool(result.get("curve")) and result["curve"].get("law") is None
    checks: list[Mapping[str, Any]] = []
    for check in _list(result, "checks"):
        where = check.get("where") or {}
        if is_untimed and where:
            where = {**where, "time_s": where.get("s")}
        if check["name"] == "clearance" and where.get("time_s") is None and proof is not None and proof.pair:
            where = {"time_s": proof.time_s, "position": None, "names": list(proof.pair)}
        checks.append({**check, "where": where})
    return checks


def _track_rows(proof: ClearanceTrack | None) -> Float[np.ndarray, "N 2"]:
    return np.empty((0, 2)) if proof is None else np.column_stack([proof.times, proof.clearance])


def _not_checked(result: Mapping[str, Any]) -> list[str]:
    """What the certificate's coverage says was not checked; joint neighbours are expected not to be."""
    coverage = result.get("coverage") or {}
    others = [
        one for one in _list(coverage, "left_out") if not one["is_neighbour"] and one.get("reason") != "same joint"
    ]
    pairs = [f"{len(others)} pairs of links that are no neighbours"] if others else []
    return [*_list(coverage, "not_checked"), *pairs]


def _shapeless(result: Mapping[str, Any], placements: LinkPlacements) -> list[str]:
    """Links without a collision shape that there is a place for."""
    named = (result.get("robot") or {}).get("links_without_shape") or []
    return [link for link in named if link in placements.links or not placements.links]


def _list(result: Mapping[str, Any], key: str) -> Sequence[Any]:
    return result.get(key) or []


def _named_hull(piece: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": piece["name"], "kind": piece.get("kind", "obstacle"), "hull": hull_of(piece)}


def _movable(movable: Mapping[str, Any], n_samples: int, kept: Int[np.ndarray, "F"]) -> dict[str, Any]:
    angles = np.asarray(movable.get("angles") or [], dtype=float)
    if len(angles) != n_samples:
        angles = np.full(n_samples, angles[0] if len(angles) else 0.0)
    return {
        "name": movable["name"],
        "joint": movable.get("joint", ""),
        "origin": list(movable["origin"]),
        "axis": list(movable["axis"]),
        "bodies": [_named_hull(body) for body in movable["bodies"]],
        "angles": pack(angles[kept], "f4"),
    }


def _timed(entry: Mapping[str, Any], times: Float[np.ndarray, "S"]) -> dict[str, Any]:
    """An entry that spans samples ``first`` to ``last`` with its times ``start`` and ``end`` [s] instead."""
    rest = {key: value for key, value in entry.items() if key not in ("first", "last")}
    if len(times) == 0:
        return {**rest, "start": 0.0, "end": 0.0}
    first, last = (int(np.clip(entry[end], 0, len(times) - 1)) for end in ("first", "last"))
    return {**rest, "start": float(times[first]), "end": float(times[last])}


def _support(entry: Mapping[str, Any], times: Float[np.ndarray, "S"]) -> dict[str, Any]:
    """A support polygon with its ZMP as rows of time, x and y; NaN where nothing presses on the ground."""
    zmp = entry.get("zmp") or {"times": [], "points": []}
    rows = [[time, *(point or (np.nan, np.nan))] for time, point in zip(zmp["times"], zmp["points"], strict=True)]
    return {**_timed(entry, times), "zmp": pack(np.array(rows).reshape(-1, 3), "f8")}


def _rows(result: Mapping[str, Any], key: str, n_samples: int, width: int) -> Float[np.ndarray, "S w"]:
    """A per-sample table, or NaN rows where the result has none (the page draws nothing there)."""
    rows = np.asarray(_list(result, key), dtype=float)
    return rows if rows.shape == (n_samples, width) else np.full((n_samples, width), np.nan)


def _cloud(result: Mapping[str, Any]) -> Float[np.ndarray, "N 3"]:
    points = np.asarray(_list(result, "cloud"), dtype=float).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    stride: Iterable[int] | slice = slice(None, None, max(1, -(-len(points) // MAX_CLOUD_POINTS)))
    return np.asarray(points[stride])
