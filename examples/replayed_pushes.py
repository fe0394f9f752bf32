"""Contacts of hands that push a mechanism, and how hands leave them, replayed at dense poses.

Normals are those of hulls, forces come from least squares.  Round parts are polygons here, so that a normal may be off
by half the angle between two of their faces.  A part of `check_certificate.py`; it imports numpy, scipy and pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from replayed_motion import Replay
from scipy.optimize import nnls

Array = NDArray[np.float64]
POSES = 25  # of a phase
FACET = np.deg2rad(12.0)  # by which the normal of a polygon may be off that of what it stands for
TOUCHING_M = 6e-3  # between surfaces; polygons are around round parts by 2 mm at most
LEAST_SHARE = 0.4  # of the pressure of a contact that slides, along the way
EDGES = 12  # of a pyramid in place of a cone
GONE_M, MOST_DRAG_M = 0.01, 5e-3  # gap from which on a hand is gone, and its way beside a face until then
Closest = Callable[[Array, Array, float], tuple[float, Array]]


def pushes(replay: Replay, data: dict[str, Any], phase: dict[str, Any], closest: Closest) -> tuple[bool, str]:
    """Check that hands move each joint of the mechanism that moves: they touch it, and can push it."""
    s = np.linspace(replay.samples[phase["first"]], replay.samples[phase["last"]], POSES)
    unpushed = set(list_moving(replay, data, phase)) - {push["joint"] for push in phase["pushes"]}
    open_claims = data["certificate"]["coverage"]["not_checked"]  # of a motion whose request is not known
    if any(f"what moves {joint} in '{phase['name']}'" not in open_claims for joint in unpushed):
        return False, f"nothing pushes {', '.join(sorted(unpushed))}"
    worst, farthest = 0.0, 0.0
    for push in phase["pushes"]:
        for at in s:
            met = [_meet(replay, data, push, contact, at, closest) for contact in push["contacts"]]
            near = [each for each in met if each[0] <= TOUCHING_M]
            farthest = max(farthest, min(each[0] for each in met))
            if not near or not _holds(push, near):
                return False, f"{push['joint']} is not pushed at {at:.2f}"
            worst = max(worst, min(_angle(normal, way) for _, normal, way, _ in near))
    return True, f"pushed {np.rad2deg(worst):.0f} deg off the way at most, {1e3 * farthest:.1f} mm off"


def leaving(replay: Replay, data: dict[str, Any], index: int, closest: Closest) -> tuple[bool, str] | None:
    """Check that a hand drags no joint along while it leaves what it pressed; None where it leaves nothing."""
    pushed = _find_last_push(replay, data, index)
    if pushed is None:
        return None
    phase, farthest = data["phases"][index], 0.0
    begin = float(replay.samples[pushed["last"]])
    s = np.linspace(replay.samples[phase["first"]], replay.samples[phase["last"]], POSES)
    for push in pushed["pushes"]:
        for contact in push["contacts"]:
            ways = _list_dragged(push, contact, _meet(replay, data, push, contact, begin, closest))
            joint, points = _locate_core(replay, contact)
            holder = replay.model.getJointId(_find_movable(data, contact)["joint"])
            ways = [way @ replay.place(begin, holder)[0] for way in ways]
            for at in s if ways else ():
                if _meet(replay, data, push, contact, at, closest)[0] <= GONE_M:
                    moved = replay.points(at, joint, points, holder) - replay.points(begin, joint, points, holder)
                    farthest = max(farthest, *(float((moved @ way).max()) for way in ways))
    is_ok = bool(farthest <= MOST_DRAG_M + np.sin(FACET) * GONE_M)
    return is_ok, f"moves {1e3 * farthest:.1f} mm at most along what nothing else holds"


def _find_last_push(replay: Replay, data: dict[str, Any], index: int) -> dict[str, Any] | None:
    """Return the last phase with pushes before one, if the mechanism has not moved since."""
    for k in range(index, -1, -1):
        phase: dict[str, Any] = data["phases"][k]
        if phase["pushes"]:
            return None if k == index else phase
        if list_moving(replay, data, phase):
            return None
    return None


def _list_dragged(
    push: dict[str, Any], contact: dict[str, Any], met: tuple[float, Array, Array, list[Array]]
) -> list[Array]:
    """Return the directions in which a contact that slides may drag a joint that does not bear it, in the world."""
    _, normal, way, held_ways = met
    off = max(_angle(normal, way) - FACET, 0.0)
    share = np.cos(off) - push["friction"][1] * np.sin(off) if len(push["contacts"]) == 1 else LEAST_SHARE
    pressure = min(max(push["force_n"], 1.0) / max(share, LEAST_SHARE), contact["cap_n"])
    found = []
    for held, moves in zip(push["held"], held_ways, strict=True):
        for sense, bears in ((1.0, held["high"]), (-1.0, held["low"])):
            along = sense * moves
            along = along - min(float(along @ normal), 0.0) * normal  # a hand that leaves does not pull
            size = float(np.linalg.norm(along))
            if bears is not None and sense * bears < push["friction"][1] * pressure * size:
                found.append(along / size)
    return found


def list_moving(replay: Replay, data: dict[str, Any], phase: dict[str, Any]) -> list[str]:
    """Return the joints of the mechanism that move in a phase."""
    s = np.linspace(replay.samples[phase["first"]], replay.samples[phase["last"]], POSES)
    columns = {movable["joint"]: replay.names.index(movable["joint"]) for movable in data["movables"]}
    return [joint for joint, column in columns.items() if np.ptp([replay.q(at)[column] for at in s]) > 1e-4]


def _locate_core(replay: Replay, contact: dict[str, Any]) -> tuple[int, Array]:
    """Return the joint that carries a surface of a hand, and the points of its core in the joint's frame."""
    frame = replay.model.frames[replay.model.getFrameId(contact["frame"])]
    return int(frame.parentJoint), np.array([frame.placement.act(np.array(point)) for point in contact["core"]])


def _find_movable(data: dict[str, Any], contact: dict[str, Any]) -> dict[str, Any]:
    return next(movable for movable in data["movables"] if movable["name"] == contact["link"])


def _meet(
    replay: Replay, data: dict[str, Any], push: dict[str, Any], contact: dict[str, Any], s: float, closest: Closest
) -> tuple[float, Array, Array, list[Array]]:
    """Return gap, normal, way, and how each held joint would move the contact point, in the world."""
    hand = replay.points(s, *_locate_core(replay, contact))
    movable = _find_movable(data, contact)
    body = next(body for body in movable["bodies"] if body["name"] == contact["body"])
    joint = replay.model.getJointId(movable["joint"])
    corners = replay.points(s, joint, np.array(body["vertices"]) - np.array(movable["origin"]))
    gap, normal = closest(hand, corners, np.inf)
    point = corners[((corners - hand.mean(axis=0)) @ normal).argsort()[:4]].mean(axis=0)
    ways = [_way(replay, name, s, point) for name in (push["joint"], *(held["joint"] for held in push["held"]))]
    way = push["sense"] * ways[0] / np.linalg.norm(ways[0])
    return gap - contact["radius"], normal, way, ways[1:]


def _way(replay: Replay, name: str, s: float, point: Array) -> Array:
    """Return how a joint moves a point per unit of its coordinate, in the world."""
    joint = replay.model.getJointId(name)
    rotation, origin = replay.place(s, joint)
    made = replay.model.joints[joint]
    state = made.createData()
    made.calc(state, pin.neutral(replay.model), np.zeros(replay.model.nv))
    axis = np.asarray(state.S).reshape(6, -1)[:, -1]
    return np.asarray(rotation @ axis[:3] + np.cross(rotation @ axis[3:], point - origin))


def _holds(push: dict[str, Any], near: list[tuple[float, Array, Array, list[Array]]]) -> bool:
    """Return whether forces about the normals push the joint and leave the held ones where they are."""
    low, high = push["friction"]
    jams = np.arccos(LEAST_SHARE * np.cos(np.arctan(high))) - np.arctan(high)
    if len(near) == 1 and _angle(near[0][1], near[0][2]) > jams + FACET:
        return False
    if len(near) == 1 and not push["held"]:
        return True
    half, force = np.arctan(low) + FACET, max(push["force_n"], 1.0)
    edges = [_pyramid(normal, half) for _, normal, _, _ in near]
    rows = [np.concatenate([e @ way for e, (_, _, way, _) in zip(edges, near, strict=True)])]
    values = [force]
    for k, held in enumerate(push["held"]):
        part = np.concatenate([e @ each[3][k] for e, each in zip(edges, near, strict=True)])
        rows += [part] if held["high"] is not None else []
        values += [held["high"]] if held["high"] is not None else []
        rows += [-part] if held["low"] is not None else []
        values += [-held["low"]] if held["low"] is not None else []
    slack = np.vstack([np.zeros((1, len(rows) - 1)), np.eye(len(rows) - 1)])
    _, rest = nnls(np.hstack([np.array(rows), slack]), np.array(values))
    return bool(rest < 1e-6 * force)


def _pyramid(normal: Array, half: float) -> Array:
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    turn = 2.0 * np.pi * np.arange(EDGES) / EDGES
    around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), np.cross(normal, first))
    return np.asarray(np.cos(half) * normal + np.sin(half) * around)


def _angle(one: Array, other: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))
