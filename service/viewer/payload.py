"""Data of the viewer page: a result at the page's frame rate, in packed arrays, without what is not drawn."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, repeat
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from costs.robot import VisualMesh
from service.viewer.forces import find_holding_forces, list_contact_points, sum_loads
from service.viewer.hulls import make_convex_mesh
from service.viewer.movables import is_prismatic, make_local_bodies, place_movables, read_angles
from service.viewer.objects import list_object_bodies
from service.viewer.placements import LinkPlacements
from service.viewer.proof import ClearanceTrack, trace_clearance

MAX_CLOUD_POINTS = 60_000
MAX_VERTICES = 65_535  # of one mesh, whose indices have 16 bits


def make_payload(
    result: Mapping[str, Any],
    placements: LinkPlacements,
    visuals: Sequence[VisualMesh] = (),
    hand_contacts: Sequence[Sequence[Mapping[str, Any]]] = (),
) -> dict[str, Any]:
    """Return everything the page draws, JSON-ready.

    Args:
        result: a parsed ``result.json`` (docs/result-format.md); keys that need a trajectory may be missing or null.
        placements: the links of ``result["bodies"]`` at the samples of ``result["trajectory"]``; without a trajectory,
            a single pose or none.
        visuals: meshes that the robot's links look like, drawn instead of the collision hulls.
        hand_contacts: those of each phase (``trace_hand_contacts``); none are drawn without.

    Raises:
        ValueError: placements and trajectory have different numbers of samples, or a body's link has no placement.
    """
    times = sample_times(result, placements)
    missing = sorted({body["link"] for body in _get_list(result, "bodies")} - set(placements.links))
    if missing and len(times):
        raise ValueError(f"no placement for link {missing[0]!r} of the result's bodies")
    phases, waypoints = _get_list(result, "phases"), [int(i) for i in _get_list(result, "waypoints")]
    kept = select_samples(times, [*waypoints, *(int(p[end]) for p in phases for end in ("first", "last"))])
    movables = _get_list(result, "movables")
    moved = place_movables(movables, len(times))
    # What the task moves is drawn like the robot's links, after them.
    poses = np.concatenate([placements.poses[kept], moved.poses[kept]], axis=1) if len(times) else placements.poses
    com = _read_rows(result, "com", len(times), 3)
    proof = trace_clearance(result) if len(times) else None
    objects = {item["name"] for item in _get_list(result, "objects")}
    return {
        **_summarize(result),
        "checks": _place_checks(result, proof),
        "clearance": pack(np.empty((0, 2)) if proof is None else np.column_stack([proof.times, proof.clearance]), "f4"),
        "gaps": [] if proof is None else [{"names": list(g.pair), "start": g.start, "end": g.end} for g in proof.gaps],
        "obstruction": result.get("obstruction"),
        "shapeless": _list_shapeless(result, placements),
        "times": pack(times[kept], "f4"),
        "links": [*placements.links, *(moved.links if len(times) else ())],
        "positions": quantize(poses[..., :3]),
        "rotations": pack(np.round(poses[..., 3:] * 32767.0), "i2"),
        "bodies": [
            {"name": b["name"], "link": b["link"], "hull": pack_hull(b)}
            for b in (*_get_list(result, "bodies"), *list_object_bodies(result))
            if b["link"] in placements.links or b["name"] not in objects
        ],
        "visuals": [_make_visual(mesh) for mesh in visuals if mesh.link in placements.links],
        "pieces": [_make_piece(piece) for piece in _get_list(result, "pieces")],
        "movables": [_make_movable(movable, len(times), kept) for movable in movables],
        "waypoints": np.searchsorted(kept, [i for i in waypoints if 0 <= i < len(times)]).tolist(),
        "phases": [
            {**_make_phase(phase, times, kept, com, moved), "hand_contacts": list(pressed)}
            for phase, pressed in zip(phases, chain(hand_contacts, repeat(())), strict=False)
        ],
        "support": [_make_support(polygon, times) for polygon in _get_list(result, "support_polygons")],
        "com": pack(com[kept], "f4"),
        "cloud": quantize(_read_cloud(result)),
    }


def sample_times(result: Mapping[str, Any], placements: LinkPlacements) -> Float[np.ndarray, "S"]:
    """Return the times of the placements [s]: 0 for a single pose without a trajectory."""
    trajectory = result.get("trajectory") or {}
    times = np.asarray(trajectory.get("times") or [], dtype=float)
    n_poses = len(placements.poses)
    if len(times) == 0 and n_poses <= 1:
        return np.zeros(n_poses)
    if len(times) != n_poses:
        raise ValueError(f"trajectory has {len(times)} samples, placements have {n_poses}")
    return times


def pack_hull(body: Mapping[str, Any]) -> dict[str, Any]:
    """Return the packed hull of an object with ``vertices``."""
    mesh = make_convex_mesh(np.asarray(body["vertices"], dtype=float))
    return {
        "vertices": pack(mesh.vertices, "f4"),
        "triangles": pack(mesh.triangles, "u2"),
        "edges": pack(mesh.edges, "u2"),
        "bends": pack(np.round(mesh.bends / np.pi * 255.0), "u1"),
    }


def select_samples(times: Float[np.ndarray, "S"], always: Iterable[int], rate_hz: float = 30.0) -> Int[np.ndarray, "F"]:
    """Select the samples to animate: at most ``rate_hz`` per second, and ``always`` (waypoints, phase borders)."""
    if len(times) == 0:
        return np.empty(0, dtype=int)
    slots = np.floor((times - times[0]) * rate_hz + 1e-9)
    regular = np.flatnonzero(np.diff(slots, prepend=-1.0) > 0.0)
    fixed = [index for index in always if 0 <= index < len(times)]
    return np.unique(np.concatenate([regular, np.asarray([0, len(times) - 1, *fixed], dtype=int)]))


def pack(values: Shaped[np.ndarray, "..."], dtype: str) -> dict[str, Any]:
    """Encode an array for the page: numpy type code, shape, little-endian bytes in base64."""
    array = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
    return {"dtype": dtype, "shape": list(array.shape), "data": base64.b64encode(array.tobytes()).decode("ascii")}


def quantize(values: Float[np.ndarray, "... 3"]) -> dict[str, Any]:
    """Encode points on a 16-bit grid over their bounding box (5 m: steps of 0.08 mm), with the box [m]."""
    if values.size == 0:
        return {**pack(values, "u2"), "lower": [0.0, 0.0, 0.0], "upper": [1.0, 1.0, 1.0]}
    flat = values.reshape(-1, values.shape[-1])
    lower, upper = flat.min(axis=0), flat.max(axis=0)
    span = np.where(upper > lower, upper - lower, 1.0)
    grid = np.round((values - lower) / span * 65535.0)
    return {**pack(grid, "u2"), "lower": lower.tolist(), "upper": (lower + span).tolist()}


def thin_points(points: Float[np.ndarray, "N 3"], most: int) -> Float[np.ndarray, "M 3"]:
    """Return every k-th point, at most ``most`` of them."""
    return points[:: max(1, -(-len(points) // most))]


def _summarize(result: Mapping[str, Any]) -> dict[str, Any]:
    request = result.get("request") or {}
    task = (request.get("task") or request.get("goal")) if isinstance(request, Mapping) else None
    robot, certificate, curve = (result.get(key) or {} for key in ("robot", "certificate", "curve"))
    return {
        "verdict": result.get("verdict", ""),
        "robot": robot.get("name", ""),
        "task": _name_task(task) if isinstance(task, Mapping) else "",
        "explanation": _get_list(result, "explanation"),
        "notes": _get_list(result, "notes"),
        "rests_on": [note for note in _get_list(certificate, "notes") if note not in _get_list(result, "notes")],
        "not_checked": _list_unchecked(result),
        "is_timed": not curve or curve.get("law") is not None,
        "figures": result.get("figures") or {},
        "timings": result.get("timings") or {},
        "planning_time_s": result.get("planning_time_s"),
        "min_clearance_m": result.get("min_clearance_m"),
        "min_clearance_pair": result.get("min_clearance_pair") or [],
        "min_balance_margin_m": result.get("min_balance_margin_m"),
        "request_hash": result.get("request_hash", ""),
    }


def _name_task(task: Mapping[str, Any]) -> str:
    """Return a short name: that of the first section of the task or goal that is not empty."""
    named = next((str(name) for name, content in task.items() if content), "")
    return {"poses": "reach", "joints": "joint goal"}.get(named, named)


def _place_checks(result: Mapping[str, Any], proof: ClearanceTrack | None) -> list[Mapping[str, Any]]:
    """Return the checks with their places; that of the curve's clearance is where the proven clearance is smallest.

    In an untimed motion, the path parameter replaces the time, as in its samples.
    """
    is_untimed = bool(result.get("curve")) and result["curve"].get("law") is None
    checks: list[Mapping[str, Any]] = []
    for check in _get_list(result, "checks"):
        where = check.get("where") or {}
        if is_untimed and where:
            where = {**where, "time_s": where.get("s")}
        if check["name"] == "clearance" and where.get("time_s") is None and proof is not None and proof.pair:
            where = {"time_s": proof.time_s, "position": None, "names": list(proof.pair)}
        checks.append({**check, "where": where})
    return checks


def _list_unchecked(result: Mapping[str, Any]) -> list[str]:
    """Return what the certificate's coverage lists as unchecked, joint neighbours aside."""
    coverage = result.get("coverage") or {}
    left_out = _get_list(coverage, "left_out")
    others = [pair for pair in left_out if not pair["is_neighbour"] and pair.get("reason") != "same joint"]
    pairs = [f"{len(others)} pairs of links that are no neighbours"] if others else []
    return [*_get_list(coverage, "not_checked"), *pairs]


def _list_shapeless(result: Mapping[str, Any], placements: LinkPlacements) -> list[str]:
    """Return the links without a collision shape that have a placement."""
    names = (result.get("robot") or {}).get("links_without_shape") or []
    return [link for link in names if link in placements.links or not placements.links]


def _get_list(result: Mapping[str, Any], key: str) -> Sequence[Any]:
    return result.get(key) or []


def _make_piece(piece: Mapping[str, Any]) -> dict[str, Any]:
    return {"name": piece["name"], "kind": piece.get("kind", "obstacle"), "hull": pack_hull(piece)}


def _make_visual(mesh: VisualMesh) -> dict[str, Any]:
    """Return the triangles of a link, with 16-bit indices: corner by corner where there are too many vertices."""
    vertices, triangles = mesh.vertices, mesh.triangles
    if len(vertices) > MAX_VERTICES:
        vertices, triangles = vertices[triangles].reshape(-1, 3)[:MAX_VERTICES], np.arange(MAX_VERTICES).reshape(-1, 3)
    return {"link": mesh.link, "vertices": quantize(vertices), "triangles": pack(triangles, "u2")}


def _make_movable(movable: Mapping[str, Any], n_samples: int, kept: Int[np.ndarray, "F"]) -> dict[str, Any]:
    """Return a movable with its bodies in its own frame, whose poses are among the links'."""
    return {
        "name": movable["name"],
        "joint": movable.get("joint", ""),
        "type": "prismatic" if is_prismatic(movable) else "revolute",
        "parent": movable.get("parent"),
        "origin": list(movable["origin"]),
        "axis": list(movable["axis"]),
        "bodies": [_make_piece(body) for body in make_local_bodies(movable)],
        "angles": pack(read_angles(movable, n_samples)[kept], "f4"),
    }


def _make_phase(
    phase: Mapping[str, Any],
    times: Float[np.ndarray, "S"],
    kept: Int[np.ndarray, "F"],
    com: Float[np.ndarray, "S 3"],
    moved: LinkPlacements,
) -> dict[str, Any]:
    """Return a phase with times for samples, and its static regions with forces that hold the robot."""
    found = phase.get("regions") or []
    wrench = sum_loads(phase, moved) if found and len(times) else np.zeros((len(times), 6))
    regions = [_make_region(region, phase, times, kept, com, wrench) for region in found]
    rest = {key: value for key, value in phase.items() if key != "pushes"}
    return {**_replace_samples(rest, times), "regions": regions}


def _make_region(
    region: Mapping[str, Any],
    phase: Mapping[str, Any],
    times: Float[np.ndarray, "S"],
    kept: Int[np.ndarray, "F"],
    com: Float[np.ndarray, "S 3"],
    wrench: Float[np.ndarray, "S 6"],
) -> dict[str, Any]:
    """Return a static region with forces that hold the robot, one row per frame from ``frame`` on.

    Without witnesses for exactly the corners of the phase's soles there are no forces.
    """
    frames = np.flatnonzero((kept >= region["first"]) & (kept <= region["last"]))
    places, shape = list_contact_points(phase), np.shape(region.get("witnesses") or [])
    forces = np.empty((0, 0, 3))
    if len(places) and len(shape) == 4 and shape[0] == len(region["polygon"]) and shape[2] == len(places):
        forces = find_holding_forces(region, com[kept[frames]], wrench[kept[frames]])
    return {
        **_replace_samples({"first": region["first"], "last": region["last"]}, times),
        "polygon": region["polygon"],
        "margin_m": region.get("margin_m", phase.get("region_margin_m")),
        "places": places.tolist(),
        "frame": int(frames[0]) if len(frames) else 0,
        "forces": pack(forces, "f4"),
    }


def _replace_samples(entry: Mapping[str, Any], times: Float[np.ndarray, "S"]) -> dict[str, Any]:
    """Replace the samples ``first`` and ``last`` of an entry by the times ``start`` and ``end`` [s]."""
    rest = {key: value for key, value in entry.items() if key not in ("first", "last")}
    if len(times) == 0:
        return {**rest, "start": 0.0, "end": 0.0}
    first, last = (int(np.clip(entry[end], 0, len(times) - 1)) for end in ("first", "last"))
    return {**rest, "start": float(times[first]), "end": float(times[last])}


def _make_support(entry: Mapping[str, Any], times: Float[np.ndarray, "S"]) -> dict[str, Any]:
    """Return a support polygon with its ZMP as rows of time, x and y; NaN where no foot is loaded."""
    zmp = entry.get("zmp") or {"times": [], "points": []}
    rows = [[time, *(point or (np.nan, np.nan))] for time, point in zip(zmp["times"], zmp["points"], strict=True)]
    return {**_replace_samples(entry, times), "zmp": pack(np.array(rows).reshape(-1, 3), "f8")}


def _read_rows(result: Mapping[str, Any], key: str, n_samples: int, width: int) -> Float[np.ndarray, "S w"]:
    """Return a table with a row per sample, or rows of NaN, which are not drawn, if the result has none."""
    rows = np.asarray(_get_list(result, key), dtype=float)
    return rows if rows.shape == (n_samples, width) else np.full((n_samples, width), np.nan)


def _read_cloud(result: Mapping[str, Any]) -> Float[np.ndarray, "N 3"]:
    points = np.asarray(_get_list(result, "cloud"), dtype=float).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return thin_points(points, MAX_CLOUD_POINTS)
