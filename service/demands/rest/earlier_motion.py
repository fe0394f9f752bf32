"""The motion of an earlier plan: what a request records of it, and what it is in the joints of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from costs.curve import Curve, TimeLaw
from costs.robot import RobotModel
from service.request.resume import NominalPhase, NominalRequest
from service.verify import Motion

DIGITS = 7  # of the positions and tangents of a record


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


def record_motion(motion: Motion) -> NominalRequest:
    """Return the section of a request that records a motion: its curve by phase, and its time law."""
    curve, law, phases = motion.curve, motion.law, {}
    for phase in motion.phases:
        knots = curve.find_knots(phase.first, phase.last)
        positions, tangents = (
            tuple(np.round(values[knots], DIGITS).ravel().tolist()) for values in (curve.positions, curve.tangents)
        )
        phases[phase.name] = NominalPhase(positions, tuple(curve.knots[knots].tolist()), tangents)
    path, speed = ((), ()) if law is None else (tuple(law.path.tolist()), tuple(law.speed.tolist()))
    return NominalRequest(motion.robot.joint_names, phases, path, speed)


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


def find_beginning(robot: RobotModel, recorded: NominalRequest) -> Float[np.ndarray, "n"] | None:
    """Return the configuration in which an earlier motion begins; None where its order or a joint is not recorded.

    The record may have further joints, such as those of a mechanism.
    """
    names = recorded.joint_names
    if not recorded.has_curve or not set(robot.joint_names) <= set(names):
        return None
    first = min(recorded.phases.values(), key=lambda phase: phase.knots[0])
    return np.array([first.positions[names.index(name)] for name in robot.joint_names])
