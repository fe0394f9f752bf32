"""The motion of an earlier plan, as a request records it, in the joints of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel
from service.body.task_plan import KeptCurve
from service.request.resume import NominalRequest

LEAST_WAYPOINTS = 4  # of the rest of a way, so that something between its ends is left


@dataclass(frozen=True)
class EarlierMotion:
    """What an earlier plan did.

    Attributes:
        ways: (T, n) waypoints by name of the phase.
        curves: exact curve by name of the phase; only of a motion that names all joints of the robot.
        law: time law along all curves; None for an untimed plan.
    """

    ways: Mapping[str, Float[np.ndarray, "T n"]] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)
    law: TimeLaw | None = None

    def keep(self, phase: str) -> KeptCurve | None:
        """Return a phase's curve, with its own part of the time law where that leads from rest to rest; or None."""
        curve = self.curves.get(phase)
        if curve is None:
            return None
        law = None if self.law is None else self.law.cut(float(curve.knots[0]), float(curve.knots[-1]))
        return KeptCurve(curve, law, is_settled=law is not None)


def read_earlier_motion(
    robot: RobotModel, recorded: NominalRequest | None, at: Float[np.ndarray, "n"]
) -> EarlierMotion:
    """Return an earlier motion; an empty one without a record, or where that names a joint that the robot has not.

    Args:
        robot: whose order the joints take.
        recorded: the section of the request.
        at: (n,) where joints are that the record does not name.
    """
    if recorded is None or not set(recorded.joint_names) <= set(robot.joint_names):
        return EarlierMotion()
    columns = [robot.joint_names.index(name) for name in recorded.joint_names]
    ways, curves = {}, {}
    for name, phase in recorded.phases.items():
        known = np.reshape(phase.positions, (-1, len(columns)))
        ways[name] = np.tile(at, (len(known), 1))
        ways[name][:, columns] = known
        if len(phase.knots) > 1 and len(columns) == robot.n:
            tangents = np.empty_like(ways[name])
            tangents[:, columns] = np.reshape(phase.tangents, (-1, len(columns)))
            curves[name] = Curve(np.array(phase.knots), ways[name], tangents)
    law = TimeLaw.accelerated(np.array(recorded.law_path), np.array(recorded.law_speed)) if recorded.law_path else None
    return EarlierMotion(ways, curves, law)


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
