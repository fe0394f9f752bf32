"""Groups and named postures of the bundled Atlas."""

from __future__ import annotations

from collections.abc import Mapping

from costs.robot.atlas.figures import JOINTS

_ARM = ("shz", "shx", "ely", "elx", "wry", "wrx", "wry2")
_LEG = ("hpz", "hpx", "hpy", "kny", "aky", "akx")
# A joint that turns about y bends both sides alike; one about x or z is mirrored.
_MIRRORED = frozenset({"shz", "shx", "elx", "wrx", "hpz", "hpx", "akx"})

GROUPS: Mapping[str, tuple[str, ...]] = {
    "left_arm": tuple(f"l_arm_{joint}" for joint in _ARM),
    "right_arm": tuple(f"r_arm_{joint}" for joint in _ARM),
    "back": ("back_bkz", "back_bky", "back_bkx"),
    "left_leg": tuple(f"l_leg_{joint}" for joint in _LEG),
    "right_leg": tuple(f"r_leg_{joint}" for joint in _LEG),
    "head": ("neck_ry",),
    "whole_body": tuple(joint.name for joint in JOINTS),
}

LINK_GROUPS: Mapping[str, tuple[str, ...]] = {
    "feet": ("l_foot", "r_foot"),
    "hands": ("l_hand", "r_hand"),
    "upright": ("pelvis", "utorso"),
}

# Angles of the left side [rad]; the right side mirrors them. Knees bent, soles level (hpy + kny + aky = 0 and
# hpx + akx = 0), and the feet below the centre of mass, which the arms move a little.
# fmt: off
POSTURES: Mapping[str, Mapping[str, float]] = {
    "stand": {"hpx": 0.03, "hpy": -0.31, "kny": 0.60, "aky": -0.29, "akx": -0.03,
              "shz": -0.3, "shx": -1.25, "ely": 1.9, "elx": 0.5},
    "reach_ready": {"hpx": 0.03, "hpy": -0.32, "kny": 0.60, "aky": -0.28, "akx": -0.03,
                    "shz": -0.27, "shx": -1.32, "ely": 1.5, "elx": 1.7},
}
# fmt: on


def whole_posture(name: str) -> Mapping[str, float]:
    """Return the angle of every joint in a posture, in the order of ``JOINTS`` [rad]."""
    angles = dict.fromkeys((joint.name for joint in JOINTS), 0.0)
    for joint, angle in POSTURES[name].items():
        part = "arm" if joint in _ARM else "leg"
        angles[f"l_{part}_{joint}"] = angle
        angles[f"r_{part}_{joint}"] = -angle if joint in _MIRRORED else angle
    return angles
