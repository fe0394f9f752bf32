"""Poses and motions of an earlier plan that did the same, from which a motion that changes contacts begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from service.body.task_plan import KeptCurve
from service.request.tasks.contacts import ContactsRequest
from service.start.configuration import make_posture
from service.tasks.rest.earlier_motion import EarlierMotion

LEAST_WAYPOINTS = 4  # of the rest of a way, so that something between its ends is left


@dataclass(frozen=True)
class KnownMotion:
    """Configurations and motions that are known already.

    Attributes:
        leave: by stance that they lead to: in which the contacts that stay hold the robot alone, before others leave.
        arrive: the same when the new contacts are in their places.
        there: in which the stance holds the robot.
        curves: of an earlier motion, by name of the phase.
    """

    leave: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    arrive: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    there: Mapping[str, Float[np.ndarray, "n"]] = field(default_factory=dict)
    curves: Mapping[str, KeptCurve] = field(default_factory=dict)


def make_known_motion(robot: RobotModel, request: ContactsRequest, earlier: EarlierMotion) -> KnownMotion | None:
    """Return the postures that a request moves to and what the earlier motion did before them; None without any.

    An earlier motion of other joints, or without knots, says nothing.

    Raises:
        RequestError: an unknown posture or joint.
    """
    curves = {name: kept for name in earlier.curves if (kept := earlier.keep(name)) is not None}
    there = {
        stance.name: make_posture(robot, stance.posture, f"task.contacts.stances[{k}].posture")
        for k, stance in enumerate(request.stances)
        if stance.posture is not None
    }
    for name in there:  # a last phase that led to a posture by name leads to it as a stance
        if name in curves:
            curves[f"{name}: move"] = curves[name]
    if not curves and not there:
        return None
    ends = {name: kept.curve.positions[-1] for name, kept in curves.items()}
    leave, arrive = (
        {stance.name: ends[name] for stance in request.stances if (name := f"{stance.name}: {kind}") in ends}
        for kind in ("shift", "land")
    )
    return KnownMotion(leave, arrive, there, curves)


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
