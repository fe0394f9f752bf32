"""What a robot has (joints, links, frames, groups, postures), and which of its links overlap at rest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from costs.robot import RobotModel, format_srdf, read_joint_axis
from costs.scene import Scene
from service.start.overlaps import find_overlaps

REST = "all joints at 0"
SRDF_REASONS = {"adjacent": "Adjacent", "same joint": "Adjacent", "derived": "Always"}


def describe_robot(robot: RobotModel) -> dict[str, Any]:
    """Return what a request can name of a robot, JSON-ready: SI units, null for what is unlimited."""
    model = robot.model
    shapes = Counter(body.link for body in robot.bodies)
    links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY and frame.name != "universe"]
    first = 6 if robot.is_floating else 0
    return {
        "name": robot.name,
        "base": name_base(robot),
        "mass_kg": float(pin.computeTotalMass(model)),
        "joints": [_describe_joint(robot, column) for column in range(first, robot.n)],
        "followers": _list_followers(robot),
        "links": [
            {"name": frame.name, "shapes": shapes[frame.name], "moves": int(frame.parentJoint) > 0} for frame in links
        ],
        "groups": {name: list(joints) for name, joints in robot.groups.items()},
        "link_groups": {name: list(names) for name, names in robot.link_groups.items()},
        "postures": list(robot.postures),
        "contacts": list(robot.contacts),
        "ignored_pairs": dict(Counter(reason.split(" ")[0] for reason in robot.ignored_reasons.values())),
        "notes": list(robot.notes),
    }


def name_base(robot: RobotModel) -> str:
    """Return how the base moves, as ``robot.root`` of a request says it."""
    if robot.is_floating or not robot.is_planar:
        return "floating" if robot.is_floating else "fixed"
    return "differential" if robot.rolls else "planar"


def _describe_joint(robot: RobotModel, column: int) -> dict[str, Any]:
    name = robot.joint_names[column]
    joint = robot.model.getJointId(name)
    is_turning = bool(np.any(read_joint_axis(robot, joint)[3:]))
    limits = {
        key: float(value) if np.isfinite(value) else None
        for key, value in (
            ("lower", robot.lower[column]),
            ("upper", robot.upper[column]),
            ("velocity", robot.velocity[column]),
            ("effort", robot.effort[column]),
        )
    }
    return {"name": name, "unit": "rad" if is_turning else "m", **limits}


def _list_followers(robot: RobotModel) -> list[dict[str, Any]]:
    followers = []
    for name, made in zip(list(robot.model.names), robot.model.joints, strict=True):
        if made.shortname() == "JointModelMimic":
            own = made.extract()
            followers.append(
                {
                    "name": name,
                    "follows": robot.joint_names[int(made.idx_q)],
                    "multiplier": float(own.scaling),
                    "offset": float(own.offset),
                }
            )
    return followers


@dataclass(frozen=True)
class RobotCheck:
    """Pairs of links that are not checked, and those whose hulls overlap at rest.

    Attributes:
        ignored: reason by pair that is not checked against each other.
        overlapping: by pair, the posture in which it overlaps most and how deep [m].
        srdf: text of an SRDF that leaves out both.
    """

    ignored: Mapping[tuple[str, str], str]
    overlapping: Mapping[tuple[str, str], tuple[str, float]]
    srdf: str


def check_robot(robot: RobotModel) -> RobotCheck:
    """Find the link pairs that overlap with all joints at 0 (or at the nearest limit) and in the named postures."""
    rest = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    overlapping: dict[tuple[str, str], tuple[str, float]] = {}
    for name, q in {REST: rest, **robot.postures}.items():
        for overlap in find_overlaps(robot, q, Scene(()), ()):
            first, second = sorted((overlap.link, overlap.other))
            if overlap.depth > overlapping.get((first, second), ("", 0.0))[1]:
                overlapping[first, second] = (name, overlap.depth)
    reasons = {pair: _word(reason) for pair, reason in robot.ignored_reasons.items()}
    reasons |= dict.fromkeys(overlapping, "Default")
    text = format_srdf(robot.source.srdf, robot.name, reasons)
    return RobotCheck(robot.ignored_reasons, overlapping, text)


def _word(reason: str) -> str:
    return SRDF_REASONS.get(reason, reason.removeprefix("srdf").strip(" ()") or "User")
