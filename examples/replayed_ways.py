"""Ways of frames and of joints: lines, arcs, screws, and straight lines of configurations, compared pose by pose.

A part of `check_certificate.py`; imports only numpy and pinocchio. The nearest share of a way is searched on a grid.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from replayed_motion import Array, Replay

POSES = 300  # of a phase
AHEAD, STEP = 0.05, 1e-4  # of the shares that are tried beside the one before


def way(replay: Replay, phase: dict[str, Any], wanted: dict[str, Any]) -> tuple[bool, str]:
    """Check that a frame is on its way at poses of a phase, and does all of it."""
    frame = replay.model.frames[replay.model.getFrameId(wanted["frame"])]
    share, worst, turned = 0.0, 0.0, 0.0
    for s in np.linspace(replay.samples[phase["first"]], replay.samples[phase["last"]], POSES):
        rotation, place = replay.place(float(s), int(frame.parentJoint))
        at, turn = rotation @ frame.placement.translation + place, rotation @ frame.placement.rotation
        tried = share + np.arange(-AHEAD, AHEAD, STEP)
        places = np.array([_place(wanted, u) for u in tried])
        lean = np.array([_lean(wanted, turn, u) for u in tried])
        off = np.linalg.norm(places - at, axis=1)
        best = int((off + 0.1 * lean).argmin())
        share = float(tried[best])
        worst, turned = max(worst, float(off[best])), max(turned, float(lean[best]))
    most, most_deg = wanted["tolerance_m"], wanted["rotation_tolerance_deg"]
    grid = STEP * _length(wanted)
    is_near = most is None or worst <= most + grid
    is_turned = most_deg is None or np.rad2deg(turned) <= most_deg + 0.1
    text = f"{1e3 * worst:.2f} mm and {np.rad2deg(turned):.2f} deg off at {POSES} poses, {100 * share:.1f} % done"
    return is_near and is_turned and abs(share - 1.0) < 0.01, text


def joint_way(replay: Replay, phase: dict[str, Any], wanted: dict[str, Any]) -> tuple[bool, str]:
    """Check that joints are on a straight line of configurations at poses of a phase, and end where it does."""
    if not wanted["joints"]:
        return True, "no joints"
    columns = [replay.names.index(name) for name in wanted["joints"]]
    first, last = np.array(wanted["first"]), np.array(wanted["last"])
    step, worst = last - first, 0.0
    ends = replay.samples[phase["first"]], replay.samples[phase["last"]]
    for s in np.linspace(*ends, POSES):
        offset = replay.q(float(s))[columns] - first
        if step.any():
            offset = offset - np.clip(offset @ step / (step @ step), 0.0, 1.0) * step
        worst = max(worst, float(np.linalg.norm(offset)))
    end = float(np.abs(replay.q(float(ends[1]))[columns] - last).max())
    return max(worst, end) <= wanted["tolerance"], f"{worst:.1e} off the line, {end:.1e} off its end"


def _turn(vector: Array) -> Array:
    return np.asarray(pin.exp3(np.asarray(vector, float)))


def _place(wanted: dict[str, Any], share: float) -> Array:
    centre, axis = np.array(wanted["centre"]), np.array(wanted["axis"])
    carried = _turn(share * wanted["angle_rad"] * axis) @ (np.array(wanted["position"]) - centre)
    return np.asarray(centre + carried + share * np.array(wanted["shift"]))


def _lean(wanted: dict[str, Any], turn: Array, share: float) -> float:
    """Return the angle off the orientation that belongs to a share, or that between the free axes [rad]."""
    if wanted["rotation_tolerance_deg"] is None:
        return 0.0
    own = pin.Quaternion(np.roll(wanted["quaternion_wxyz"], -1)).matrix()
    meant = _turn(share * np.array(wanted["turn_rad"])) @ own
    if wanted["free_axis"] is not None:
        axis = np.array(wanted["free_axis"])
        return float(2.0 * np.arcsin(min(0.5 * float(np.linalg.norm((turn - meant) @ axis)), 1.0)))
    return float(np.arccos(np.clip(0.5 * (np.trace(meant.T @ turn) - 1.0), -1.0, 1.0)))


def _length(wanted: dict[str, Any]) -> float:
    arm = np.cross(np.array(wanted["axis"]), np.array(wanted["position"]) - np.array(wanted["centre"]))
    return float(np.linalg.norm(wanted["angle_rad"] * arm) + np.linalg.norm(wanted["shift"]))
