"""Balance under the loads of the hands: the ground's recorded forces, added up.

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

Array = NDArray[np.float64]
GRAVITY = 9.81
TOLERANCE = 1e-6  # of forces and moments, as a share of the weight and of the weight times 1 m


def forces(replay: Replay, phase: dict[str, Any]) -> tuple[bool, str]:
    """Check that recorded forces hold the robot at every vertex of every region, and that the regions cover the loads.

    Forces stay in their cones and below their caps, and balance weight and wrench for a centre of mass at the vertex.
    Every load at every sample is a mixture of these wrenches, so that a mixture of the forces holds it.
    """
    points, normals, friction, caps = _ground(phase)
    weight = GRAVITY * sum(inertia.mass for inertia in list(replay.model.inertias)[1:])
    scale, count = TOLERANCE * weight, 0
    reached = phase["first"]
    for region in phase["regions"]:
        if region["first"] != reached or region["last"] <= reached:
            return False, f"no region covers the phase from sample {reached} on"
        reached = region["last"]
        polygon, wrenches = np.array(region["polygon"]), np.array(region["wrenches"])
        f = np.array(region["witnesses"])
        pressed = np.einsum("vwck,ck->vwc", f, normals)
        slid = np.linalg.norm(f - pressed[..., None] * normals, axis=3)
        if (slid > friction * pressed + scale).any() or (pressed > caps + scale).any():
            return False, "a force is outside its friction cone or above its cap"
        moments = np.cross(points, f).sum(axis=2)
        pull = np.stack([-weight * polygon[:, 1], weight * polygon[:, 0], 0.0 * polygon[:, 0]], axis=1)
        off = f.sum(axis=2) + wrenches[None, :, :3] + [0.0, 0.0, -weight]
        turn = moments + wrenches[None, :, 3:] + pull[:, None]
        if max(np.abs(off).max(), np.abs(turn).max()) > scale:
            return False, f"forces are {np.abs(off).max():.2g} N, moments {np.abs(turn).max():.2g} Nm off"
        for sample in range(region["first"], region["last"] + 1, max((region["last"] - region["first"]) // 12, 1)):
            for wrench in _loads(replay, phase, float(replay.samples[sample])):
                if _mix(wrench, wrenches) > scale:
                    return False, f"a load at sample {sample} is no mixture of the recorded wrenches"
        count += f.shape[0] * f.shape[1]
    if reached != phase["last"]:
        return False, f"no region covers the phase from sample {reached} on"
    return True, f"{count} balances of the ground's forces, weight and loads"


def region_margin(replay: Replay, phase: dict[str, Any], region: dict[str, Any]) -> float:
    """Return how far inside a region the centre of mass has to stay: the margin, and what drift takes off it [m]."""
    weight = GRAVITY * sum(inertia.mass for inertia in list(replay.model.inertias)[1:])
    total = np.linalg.norm(np.array(region["witnesses"]), axis=3).sum(axis=2).max()
    feet = max(contact["tolerance_m"] for contact in phase["contacts"]) * total
    hands = sum(np.linalg.norm(load["force_n"]) * load["drift_m"] for load in phase["loads"])
    return float(phase["support"]["margin_m"] + (feet + hands) / weight)


def _ground(phase: dict[str, Any]) -> tuple[Array, Array, Array, Array]:
    """Return the corners of all soles, the normals of their planes, coefficients of friction, and caps."""
    points, normals, friction, caps = [], [], [], []
    for contact in phase["contacts"]:
        sole = np.array(contact["sole"])
        normal = np.linalg.svd(sole - sole.mean(axis=0))[2][2]
        points.append(sole)
        normals.append(np.tile(normal if normal[2] > 0 else -normal, (len(sole), 1)))
        friction += [contact["friction"]] * len(sole)
        caps += [contact["force_cap_n"]] * len(sole)
    return np.concatenate(points), np.concatenate(normals), np.array(friction), np.array(caps)


def _loads(replay: Replay, phase: dict[str, Any], s: float) -> list[Array]:
    """Return the wrenches of all loads at a place of the curve, absent or at their largest, at the ends of slides."""
    data = replay.model.createData()
    pin.framesForwardKinematics(replay.model, data, replay.q(s))
    choices = []
    for load in phase["loads"]:
        pose = data.oMf[replay.model.getFrameId(load["link"])]
        force = -pose.rotation @ np.array(load["force_n"])
        slide = np.zeros(3) if load["slide"] is None else np.array(load["slide"])
        places = [pose.act(np.array(load["place"]) + side * slide) for side in ((-1, 1) if slide.any() else (0,))]
        choices.append([np.zeros(6), *(np.concatenate([force, np.cross(place, force)]) for place in places)])
    return [np.sum(each, axis=0) for each in product(*choices)]


def _mix(wrench: Array, wrenches: Array) -> float:
    """Return the distance of a wrench from the mixtures of others."""
    rows, ones = np.vstack([wrenches.T, 1e3 * np.ones(len(wrenches))]), np.append(wrench, 1e3)
    return float(nnls(rows, ones)[1])
