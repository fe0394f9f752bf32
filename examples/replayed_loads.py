"""Balance by recorded contact forces, which are added up: under the loads of the hands, and on changing contacts.

A part of `check_certificate.py`; imports only numpy, scipy and pinocchio.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from replayed_motion import Replay
from scipy.optimize import nnls
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]
GRAVITY = 9.81
TOUCHING_M = 3e-3
TOLERANCE = 1e-6  # of forces and moments, as a share of the weight and of the weight times 1 m


def forces(replay: Replay, phase: dict[str, Any]) -> tuple[bool, str]:
    """Check that recorded forces hold the robot at every vertex of every region, and that the regions cover the loads.

    Forces stay in their cones and below their caps for every normal within its tilt, and balance weight and wrench for
    a centre of mass at the vertex. Every load at every sample is a mixture of these wrenches, so that a mixture of the
    forces holds it; where no hand pulls, so are the yaw moments of contact points that drift.
    """
    points, normals, friction, caps, tilts = _ground(phase)
    if len({contact["link"] for contact in phase["contacts"]}) < len(phase["contacts"]):
        return False, "a link has two contacts"
    weight = GRAVITY * sum(inertia.mass for inertia in list(replay.model.inertias)[1:])
    scale, count = TOLERANCE * weight, 0
    reached = phase["first"]
    for region in phase["regions"]:
        if region["first"] != reached or region["last"] <= reached:
            return False, f"no region covers the phase from sample {reached} on"
        reached = region["last"]
        polygon, wrenches = np.array(region["polygon"]), np.array(region["wrenches"])
        f = np.array(region["witnesses"])
        if f.shape != (len(polygon), len(wrenches), *points.shape):
            return False, f"forces of shape {f.shape} are not those of {len(points)} contact points"
        pressed = np.einsum("vwck,ck->vwc", f, normals)
        slid = np.linalg.norm(f - pressed[..., None] * normals, axis=3)
        off_normal = np.arctan2(slid, pressed)  # the tilted normal that is nearest is pressed most
        most = np.linalg.norm(f, axis=3) * np.cos(np.maximum(off_normal - tilts, 0.0))
        narrow = np.tan(np.maximum(np.arctan(friction) - tilts, 0.0))
        if (slid > narrow * pressed + scale).any() or (most > caps + scale).any():
            return False, "a force is outside its friction cone or above its cap"
        moments = np.cross(points, f).sum(axis=2)
        pull = np.stack([-weight * polygon[:, 1], weight * polygon[:, 0], 0.0 * polygon[:, 0]], axis=1)
        off = f.sum(axis=2) + wrenches[None, :, :3] + [0.0, 0.0, -weight]
        turn = moments + wrenches[None, :, 3:] + pull[:, None]
        if max(np.abs(off).max(), np.abs(turn).max()) > scale:
            return False, f"forces are {np.abs(off).max():.2g} N, moments {np.abs(turn).max():.2g} Nm off"
        if not phase["loads"]:
            ends = [int(wrenches[:, 5].argmin()), int(wrenches[:, 5].argmax())]
            sideways = np.linalg.norm(f[:, ends, :, :2], axis=3).sum(axis=2).max()
            reach = sideways * max(contact["tolerance_m"] for contact in phase["contacts"])
            if np.abs(wrenches[ends, :5]).max() > scale or np.abs(wrenches[ends, 5]).min() < reach - scale:
                return False, f"contacts that drift make a yaw moment of {reach:.2g} Nm, which is not held"
        for sample in range(region["first"], region["last"] + 1, max((region["last"] - region["first"]) // 12, 1)):
            for wrench in _loads(replay, phase, float(replay.samples[sample])):
                if _mix(wrench, wrenches) > scale:
                    return False, f"a load at sample {sample} is no mixture of the recorded wrenches"
        count += f.shape[0] * f.shape[1]
    if reached != phase["last"]:
        return False, f"no region covers the phase from sample {reached} on"
    return True, f"{count} balances of contact forces, weight and loads"


def touches(data: dict[str, Any], contact: dict[str, Any]) -> tuple[bool, str]:
    """Check that a piece is behind each point of a contact along its normal, with a face within its tilt.

    Round obstacles of the request count as they are: the recorded hull contains them and touches them along lines only.
    """
    normal, off, lean = np.array(contact["normal"]), [], []
    scene = data["request"].get("scene") or {}
    bars = {o["name"]: o for o in scene.get("obstacles") or [] if o["type"] in ("cylinder", "capsule")}
    for point in np.array(contact["sole"]):
        best = (np.inf, np.inf)
        for piece in data["pieces"]:
            if piece["kind"] == "unknown":
                continue
            found = _find_face(point, normal, np.array(piece["vertices"]))
            if found is not None and piece["name"] in bars:
                side = _find_side(point, normal, bars[piece["name"]])
                found = found if side is None else (max(abs(found[0]), abs(side[0])), side[1])
            if found is not None and abs(found[0]) < abs(best[0]):
                best = found
        off.append(abs(best[0]))
        lean.append(best[1])
    is_on = max(off) <= TOUCHING_M and max(lean) <= contact["tilt_rad"] + 1e-6
    return is_on, f"{1e3 * max(off):.2f} mm off what it presses on, which leans {np.degrees(max(lean)):.2f} deg"


def _find_face(point: Array, normal: Array, vertices: Array) -> tuple[float, float] | None:
    """Return where the line along a normal enters a hull, and the angle of the face there; None if it misses it."""
    try:
        planes = ConvexHull(vertices).equations
    except QhullError:
        return None
    first, last, face = -np.inf, np.inf, planes[0, :3]
    for *outward, offset in planes:
        height, slope = float(np.dot(outward, point)) + offset, float(np.dot(outward, normal))
        if abs(slope) <= 1e-9:
            if height > 1e-9:
                return None
        elif slope > 0.0 and height / slope > first:  # the point moved by -t along the normal is behind this face
            first, face = height / slope, np.array(outward)
        elif slope < 0.0:
            last = min(last, height / slope)
    if first > last + 1e-9 or not np.isfinite(first):
        return None
    return first, float(np.arccos(np.clip(face @ normal, -1.0, 1.0)))


def _find_side(point: Array, normal: Array, bar: dict[str, Any]) -> tuple[float, float] | None:
    """Return how far a point is off the side of a round bar, and the angle of the side there; None beyond its ends."""
    turn = np.array(bar.get("quaternion_wxyz") or (1.0, 0.0, 0.0, 0.0))
    w, x, y, z = turn / np.linalg.norm(turn)
    axis = np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
    offset = point - np.array(bar["position"])
    along = float(offset @ axis)
    if abs(along) > 0.5 * bar["height"]:
        return None
    outward = offset - along * axis
    across = float(np.linalg.norm(outward))
    return across - bar["radius"], float(np.arccos(np.clip(outward @ normal / across, -1.0, 1.0)))


def region_margin(replay: Replay, phase: dict[str, Any], region: dict[str, Any]) -> float:
    """Return how far inside a region the centre of mass has to stay: the margin, and what drift takes off it [m]."""
    weight = GRAVITY * sum(inertia.mass for inertia in list(replay.model.inertias)[1:])
    total = np.linalg.norm(np.array(region["witnesses"]), axis=3).sum(axis=2).max()
    feet = max(contact["tolerance_m"] for contact in phase["contacts"]) * total
    hands = sum(np.linalg.norm(load["force_n"]) * load["drift_m"] for load in phase["loads"])
    margin = phase["support"]["margin_m"] if phase["region_margin_m"] is None else phase["region_margin_m"]
    return float(margin + (feet + hands) / weight)


def _ground(phase: dict[str, Any]) -> tuple[Array, Array, Array, Array, Array]:
    """Return all contact points, their normals (of the sole's plane where none is stated), friction, caps and tilts."""
    points, normals, friction, caps, tilts = [], [], [], [], []
    for contact in phase["contacts"]:
        sole = np.array(contact["sole"])
        normal = contact["normal"]
        if normal is None:
            normal = np.linalg.svd(sole - sole.mean(axis=0))[2][2]
            normal = normal if normal[2] > 0 else -normal
        points.append(sole)
        normals.append(np.tile(normal, (len(sole), 1)))
        tilts += [contact["tilt_rad"]] * len(sole)
        friction += [contact["friction"]] * len(sole)
        caps += [contact["force_cap_n"]] * len(sole)
    return np.concatenate(points), np.concatenate(normals), np.array(friction), np.array(caps), np.array(tilts)


def _loads(replay: Replay, phase: dict[str, Any], s: float) -> list[Array]:
    """Return the wrenches of all loads at a place of the curve, absent or at their largest, at the ends of slides."""
    data = replay.model.createData()
    pin.framesForwardKinematics(replay.model, data, replay.q(s))
    choices = []
    for load in phase["loads"]:
        pose = data.oMf[replay.model.getFrameId(load["link"])]
        slide = np.zeros(3) if load["slide"] is None else np.array(load["slide"])
        places = [pose.act(np.array(load["place"]) + side * slide) for side in ((-1, 1) if slide.any() else (0,))]
        choices.append([np.zeros(6)])
        for force, moment in _parts(load):
            force, moment = -pose.rotation @ force, -pose.rotation @ moment
            choices[-1] += [np.concatenate([force, np.cross(place, force) + moment]) for place in places]
    return [np.sum([np.zeros(6), *each], axis=0) for each in product(*choices)]


def _parts(load: dict[str, Any]) -> list[tuple[Array, Array]]:
    """Return forces and moments of a load: at its largest, and with the largest across it and about it."""
    force = np.array(load["force_n"])
    across, twist = load.get("across_n", 0.0), load.get("twist_nm", 0.0)
    if not across and not twist:
        return [(force, np.zeros(3))]
    axis = force / np.linalg.norm(force)
    x, y = np.linalg.svd(axis[None])[2][1:]
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False) if across else [0.0]
    sides = [across * (np.cos(turn) * x + np.sin(turn) * y) for turn in turns]
    return [(s * force + side, sign * twist * axis) for s in (0.0, 1.0) for side in sides for sign in (-1.0, 1.0)]


def _mix(wrench: Array, wrenches: Array) -> float:
    """Return the distance of a wrench from the mixtures of others."""
    rows, ones = np.vstack([wrenches.T, 1e3 * np.ones(len(wrenches))]), np.append(wrench, 1e3)
    return float(nnls(rows, ones)[1])
