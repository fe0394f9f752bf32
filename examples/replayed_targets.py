"""Targets of the phases of a result: joints and frames at their promised places, checked on the curve.

A part of `check_certificate.py`; imports only numpy and pinocchio.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from replayed_holes import hole
from replayed_motion import Array, Replay
from replayed_regions import region
from replayed_ways import joint_way, way

TIP_M = 0.1  # a direction is checked by the tip of a rod of this length
Excess = Callable[[float], float]
"""Distance beyond the tolerance at a path parameter [m]; negative within the tolerance."""


def target(replay: Replay, phase: dict[str, Any], wanted: dict[str, Any]) -> tuple[bool, str]:
    """Check a pose, circle, axis, region, hole, way or joint value, at one path parameter or along the whole phase."""
    if wanted["kind"] == "region":
        return region(replay, phase, wanted)
    if wanted["kind"] == "hole":
        return hole(replay, phase, wanted)
    if wanted["kind"] == "way":
        return way(replay, phase, wanted)
    if wanted["kind"] == "joint_way":
        return joint_way(replay, phase, wanted)
    if wanted["kind"] == "joint":
        off = abs(replay.q(replay.samples[wanted["at"]])[replay.names.index(wanted["joint"])] - wanted["value"])
        return off <= wanted["tolerance"], f"{wanted['joint']} is {off:.5f} off"
    frame = replay.model.frames[replay.model.getFrameId(wanted["frame"])]
    joint, origin, turn = int(frame.parentJoint), frame.placement.translation, frame.placement.rotation
    worst = -np.inf
    for excess, rods in _excesses(replay, joint, origin, turn, wanted):
        if wanted.get("at") is not None:
            worst = max(worst, excess(replay.samples[wanted["at"]]))
            continue
        points = np.vstack([origin, origin + TIP_M * rods @ turn.T])
        chain = replay.chain(0, joint, points)
        # A direction is the difference of two points, and each may leave its chord; so may all three axes.
        far = {0: 1.0, 1: 2.0, 3: 2.0 * np.sqrt(1.5)}[len(rods)]
        leaving = lambda a, b, c=chain, p=points, f=far: f * replay.bound(a, b, c, joint, p)  # noqa: E731
        worst = max(worst, replay.highest(phase, excess, leaving, 0.0))
    return worst <= 1e-9, f"{-1e3 * worst:.2f} mm within what is allowed"


def _excesses(
    replay: Replay, joint: int, origin: Array, turn: Array, wanted: dict[str, Any]
) -> list[tuple[Excess, Array]]:
    """Return the excesses of a frame, each with the axes (in the frame) that it concerns, none for positions."""

    def place(s: float) -> Array:
        return np.asarray(replay.points(s, joint, origin[None])[0])

    def lean(axis: Array, direction: Array, most_deg: float) -> Excess:
        most = 2 * TIP_M * np.sin(0.5 * np.deg2rad(most_deg))
        return lambda s: float(np.linalg.norm(TIP_M * (replay.place(s, joint)[0] @ turn @ axis - direction)) - most)

    none = np.zeros((0, 3))
    if wanted["kind"] == "circle":
        centre, normal, radius = np.array(wanted["centre"]), np.array(wanted["axis"]), wanted["radius"]

        def off_circle(s: float) -> float:
            offset = place(s) - centre
            height = offset @ normal
            return float(np.hypot(height, np.linalg.norm(offset - height * normal) - radius) - wanted["tolerance_m"])

        asked: list[tuple[Excess, Array]] = [(off_circle, none)]
        if wanted["frame_axis"] is not None:
            own = np.array(wanted["frame_axis"])
            asked.append((lean(own, normal, wanted["axis_tolerance_deg"]), own[None]))
        return asked
    if wanted["kind"] == "axis":
        own = np.array(wanted["frame_axis"])
        return [(lean(own, np.array(wanted["axis"]), wanted["axis_tolerance_deg"]), own[None])]
    wide = np.array([np.inf if one is None else one for one in wanted["position_tolerance_m"]])
    goal, pose = np.array(wanted["position"]), np.eye(3)
    if wanted["quaternion_wxyz"] is not None:
        pose = pin.Quaternion(np.roll(wanted["quaternion_wxyz"], -1)).matrix()
    # Three equal tolerances are a distance, others offsets along the axes.
    size = np.linalg.norm if np.ptp(wide) == 0.0 and np.isfinite(wide[0]) else np.abs
    asked = [(lambda s: float((size((place(s) - goal) @ pose) - wide).max()), none)]
    turns = wanted["rotation_tolerance_deg"]
    if wanted["quaternion_wxyz"] is not None and None not in turns:
        most = 2.0 * TIP_M * np.sin(0.5 * np.deg2rad(turns[0]))

        def turned(s: float) -> float:
            """How much farther than allowed the turn moves the tip of a rod across its axis."""
            return float(TIP_M * np.linalg.norm(replay.place(s, joint)[0] @ turn - pose) / np.sqrt(2.0) - most)

        asked.append((turned, np.eye(3)))
    return asked
