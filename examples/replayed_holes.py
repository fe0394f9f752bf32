"""Objects that go into holes: Whitney's conditions of jamming, tried at depths, forces and moments of both senses.

A part of `check_certificate.py`; imports only numpy and pinocchio. Whitney, J. Dyn. Sys. Meas. Control 104 (1982).
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from replayed_motion import Replay

POSES, DEPTHS = 300, 200  # of a phase, of a hole


def hole(replay: Replay, phase: dict[str, Any], wanted: dict[str, Any]) -> tuple[bool, str]:
    """Check that the force along a hole is enough for what the hand's stiffness exerts across it."""
    frame = replay.model.frames[replay.model.getFrameId(wanted["frame"])]
    axis, own = np.array(wanted["axis"]), np.array(wanted["frame_axis"])
    beside, lean = 0.0, 0.0
    for s in np.linspace(replay.samples[phase["first"]], replay.samples[phase["last"]], POSES):
        rotation, place = replay.place(float(s), int(frame.parentJoint))
        offset = rotation @ frame.placement.translation + place - np.array(wanted["position"])
        beside = max(beside, float(np.linalg.norm(np.cross(axis, offset))))
        lean = max(lean, float(np.linalg.norm(np.cross(axis, rotation @ frame.placement.rotation @ own))))
    stiff, turns, length = wanted["stiffness_n_m"], wanted["turn_stiffness_n_m_rad"], wanted["length_m"]
    off = beside + lean * length
    across, moment = stiff * off, turns * lean + stiff * off * length
    turned = lean + np.sqrt(lean**2 + stiff / turns * off**2)  # by the hole, with no more energy than straight in it
    along, radius, friction = wanted["force_n"], wanted["radius_m"], wanted["friction"]
    slides = friction * across <= along
    touches = wanted["play_m"] / max(turned, 1e-12)  # depth at which both ends of the object touch
    for depth in np.linspace(touches, wanted["depth_m"], DEPTHS) if touches < wanted["depth_m"] else ():
        share = depth / (2 * radius * friction)
        for sense, turn in itertools.product((-1, 1), repeat=2):
            tilts = turn * moment / radius + sense * friction * (1 + share) * across
            slides = slides and abs(tilts) <= share * along
    text = f"{across:.1f} N across the hole and {moment:.2f} N m, {along:g} N along it"
    return bool(slides), text
