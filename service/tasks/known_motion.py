"""Poses and ways of an earlier plan that did the same, from which a motion that changes contacts begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.request.contacts import ContactsRequest
from service.start.configuration import make_posture

LEAST_WAYPOINTS = 4  # of the rest of a way, so that something between its ends is left


@dataclass(frozen=True)
class KnownMotion:
    """Configurations that are known already, by name of the stance they lead to.

    Attributes:
        leave: in which the contacts that stay hold the robot alone, before the others leave.
        arrive: the same when the new contacts are in their places.
        there: in which the stance holds the robot.
        ways: (K, n) waypoints of the swing or move, both ends included.
    """

    leave: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    arrive: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    there: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    ways: Mapping[str, Float[np.ndarray, "K n"]] = field(default_factory=dict)


def read_known_motion(robot: RobotModel, request: ContactsRequest) -> KnownMotion | None:
    """Return the poses and ways that a request knows already; None without any.

    Raises:
        RequestError: an unknown posture or joint.
    """
    known: dict[str, dict[str, Float[np.ndarray, "n"]]] = {"leaving": {}, "arriving": {}, "standing": {}}
    ways: dict[str, Float[np.ndarray, "K n"]] = {}
    for k, stance in enumerate(request.stances):
        field_name = f"task.contacts.stances[{k}].poses"
        for kind, poses in known.items():
            posture = getattr(stance.poses, kind)
            if posture is not None:
                poses[stance.name] = make_posture(robot, posture, f"{field_name}.{kind}")
        if stance.poses.way:
            rows = [make_posture(robot, row, f"{field_name}.way[{i}]") for i, row in enumerate(stance.poses.way)]
            ways[stance.name] = np.array(rows)
    if not ways and not any(known.values()):
        return None
    return KnownMotion(known["leaving"], known["arriving"], known["standing"], ways)


def lead_way(
    way: Float[np.ndarray, "K n"], first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "T n"] | None:
    """Return the rest of a way from the waypoint nearest to ``first`` on, led to other ends; None where little is left.

    The displacement of either end fades along the way.
    """
    begin = int(np.abs(way[:-1] - first).max(axis=1).argmin())
    rest = way[begin:]
    if len(rest) < LEAST_WAYPOINTS:
        return None
    steps = np.linalg.norm(np.diff(rest, axis=0), axis=1)
    share = np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), 1e-12)
    return np.asarray(rest + np.outer(1.0 - share, first - rest[0]) + np.outer(share, last - rest[-1]))
