"""Ground truth of a recorded scene (``gt.json``) in the frames and sizes of the detectors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from perception import wheel_basis
from perception.simulate import Mesh
from perception.simulate.scenes import Truth


def truth_of(
    document: dict[str, Any], mesh: Mesh
) -> tuple[tuple[Truth, ...], tuple[tuple[str, np.ndarray], ...], frozenset[str]]:
    """Return the objects of a ``gt.json``, lookalikes, and the kinds that it does not cover."""
    truth: list[Truth] = []
    lookalikes: list[tuple[str, np.ndarray]] = []
    unknown: set[str] = set()
    parts = {part["name"]: part for part in reversed(document["parts"])}
    for valve in document.get("valves", ()):
        truth.append(_valve(valve))
    if "door" in document:
        door = _door(document["door"], parts, mesh)
        truth.append(door)
        handle = door.pose_world_object @ [*(door.sizes[f"handle_{axis}"] for axis in "xyz"), 1.0]
        reach = door.sizes["lever_direction"] * 0.08 * door.pose_world_object[:3, 0]
        lookalikes.append(("lever", np.array([handle[:3], handle[:3] + reach])))
    for beam in document.get("beams", ()):
        truth.append(_beam(beam, _part_vertices(mesh, parts[beam["name"]])))
    if "truss" in parts:
        # A truss is made of beams.
        lookalikes.append(("beam", _part_vertices(mesh, parts["truss"])[::7]))
    if "car" in document:
        car = document["car"]
        x, y, z = car["seat_box"]["centre"]
        seat = np.eye(4)
        seat[:3, 3] = x, y, z
        truth.append(Truth("seat", seat, {"height": z - car["floor_z"]}))
        wheel = np.array(car["steering_wheel"]["mean"])
        lookalikes.append(("seat", np.array([[x, wheel[1], z], [x, 0.5 * wheel[1], z]])))
        unknown |= {"opening"}
    return tuple(truth), tuple(lookalikes), frozenset(unknown)


def _valve(valve: Mapping[str, Any]) -> Truth:
    pose = np.eye(4)
    axis = np.array(valve["axis"], dtype=float)
    pose[:3, :3], pose[:3, 3] = wheel_basis(axis / np.linalg.norm(axis)).T, valve["centre"]
    outer, rim = float(valve["outer_radius"]), float(valve["rim_centreline_radius"])
    return Truth("valve", pose, {"outer_radius": outer, "rim_radius": rim, "tube_radius": outer - rim})


def _door(door: Mapping[str, Any], parts: Mapping[str, Mapping[str, Any]], mesh: Mesh) -> Truth:
    """Read a door; take the handle's place from its mesh, since the file's spindle is 3 cm off."""
    normal = np.array(door["leaf_normal_to_robot"])
    hinge, centre = np.array(door["hinge_point"]), np.array(door["leaf_centre"])
    x = centre - hinge
    x[2] = 0.0
    x /= np.linalg.norm(x)
    y = np.cross([0.0, 0.0, 1.0], x)
    side = float(np.sign(y @ normal))
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, y, [0.0, 0.0, 1.0]])
    face = np.array(door["leaf_face_point"])
    pose[:3, 3] = [*(hinge + ((face - hinge) @ normal) * normal)[:2], 0.0]
    rose = _part_vertices(mesh, parts["door/handles/ID4"])
    lever = _part_vertices(mesh, parts["door/handles/ID17"])
    out = lever @ normal
    bar = lever[out > out.max() - 0.03]
    pivot = 0.5 * (rose.min(axis=0) + rose.max(axis=0))
    pivot += (0.5 * (bar @ normal).min() + 0.5 * (bar @ normal).max() - pivot @ normal) * normal
    local = np.linalg.inv(pose) @ [*pivot, 1.0]
    width, height, open_deg = (float(door[key]) for key in ("leaf_width", "leaf_height", "open_deg"))
    sizes = {
        "width": width,
        "height": height,
        "ajar": float(np.radians(open_deg)),
        "handle_x": float(local[0]),
        "handle_y": float(local[1]),
        "handle_z": float(local[2]),
        "lever_direction": float(np.sign(x @ np.array(door["lever_direction"]))),
        "side": side,
    }
    return Truth("door", pose, sizes)


def _beam(beam: Mapping[str, Any], vertices: Float[np.ndarray, "V 3"]) -> Truth:
    """Read a beam: axis and sizes from the file, the rotation about the axis from the mesh."""
    x = np.array(beam["axis"], dtype=float)
    x /= np.linalg.norm(x)
    centre = np.array(beam["centre"], dtype=float)
    first = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    first /= np.linalg.norm(first)
    second = np.cross(x, first)
    angle = np.radians(np.arange(0.0, 180.0, 0.5))
    normals = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    z = normals[np.ptp((vertices - centre) @ normals.T, axis=0).argmin()]
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = centre
    length, thickness, width = (float(size) for size in beam["extents"])
    return Truth("beam", pose, {"length": length, "width": width, "thickness": thickness})


def _part_vertices(mesh: Mesh, part: Mapping[str, Any]) -> Float[np.ndarray, "V 3"]:
    first, last = part["tri"]
    return np.asarray(mesh.vertices[np.unique(mesh.triangles[first:last])])
