"""Whether hands reach their targets from every base within the sway that something else lets it have."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot.model import RobotModel
from costs.stopping import poll
from costs.work_space import borrow_data
from service.verify.carrying.placing import place_frames
from service.verify.certificate import Basis, Check, Where
from service.verify.motion import Phase, PoseTarget, VerifySettings
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import find_time

MOST_OFF_M = 1e-3  # by which a corrected frame may be beside its place
LEVER_M = 0.2  # at which a turn counts as a distance
ROUNDS, DAMPING = 30, 1e-8  # of the search for the corrected pose


def list_swayed_targets(phase: Phase) -> tuple[PoseTarget, ...]:
    """Return the targets of a phase that hands have to reach from swaying bases: poses at one moment."""
    return tuple(target for target in phase.targets if isinstance(target, PoseTarget) and target.at is not None)


def check_swayed_reach(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check that joints within their limits bring frames back to their places from bases moved by the whole sway.

    The base is moved along and turned about its axes and the diagonals between them.
    """
    motion = prepared.motion
    if not motion.sway:
        return
    bases = _list_bases(motion.sway.distance_m, np.deg2rad(motion.sway.angle_deg))
    for target in list_swayed_targets(phase):
        s = float(target.at if target.at is not None else phase.last)
        q = motion.curve(np.array([s]))[0]
        planned = pin.SE3(place_frames(motion.robot, q, [target.frame])[target.frame])
        offs = [_find_leftover(motion.robot, target, q, base.inverse() * planned) for base in bases]
        worst = max(offs)
        is_ok = worst <= MOST_OFF_M
        text = (
            f"{target.frame} is brought back to within {1e3 * worst:.1f} mm of its place from {len(bases)} swayed bases"
        )
        if not is_ok:
            text = (
                f"{target.frame} stays {1e3 * worst:.1f} mm beside its place where the base has swayed by "
                f"{1e3 * motion.sway.distance_m:g} mm and {motion.sway.angle_deg:g} deg"
            )
        where = Where(s, find_time(motion.law, s), None, (target.frame,))
        yield Check(f"swayed.{phase.name}.{target.frame}", is_ok, worst, MOST_OFF_M, "m", text, where, Basis.SAMPLES)


def _list_bases(distance_m: float, angle_rad: float) -> list[pin.SE3]:
    """Return places of the base with the whole sway in 14 directions each."""
    ways = [np.eye(3)[k] * sign for k in range(3) for sign in (-1.0, 1.0)]
    ways += [np.array(corner) / np.sqrt(3.0) for corner in product((-1.0, 1.0), repeat=3)]
    return [pin.SE3(pin.exp3(angle_rad * turn), distance_m * way) for way, turn in product(ways, ways)]


def _find_leftover(robot: RobotModel, target: PoseTarget, q: Float[np.ndarray, "n"], wanted: pin.SE3) -> float:
    """Return how far a frame stays from its wanted pose after the joints, from ``q`` on, have gone towards it [m]."""
    poll()
    model, data = robot.model, borrow_data(robot.model)
    frame = model.getFrameId(target.frame)
    q = np.array(q)
    n_rows = 3 if target.rotation is None else 6
    best = np.inf
    for _ in range(ROUNDS):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        off = pin.log6(data.oMf[frame].inverse() * wanted)
        size = float(np.linalg.norm(data.oMf[frame].translation - wanted.translation))
        if target.rotation is not None:
            size = max(size, LEVER_M * float(np.linalg.norm(off.angular)))
        best = min(best, size)
        if best <= 0.1 * MOST_OFF_M:
            break
        jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)[:n_rows]
        step = off.vector[:n_rows]
        if target.rotation is None:
            step = data.oMf[frame].rotation.T @ (wanted.translation - data.oMf[frame].translation)
        free = ((q > robot.lower) | (jacobian.T @ step > 0.0)) & ((q < robot.upper) | (jacobian.T @ step < 0.0))
        jacobian = jacobian * free
        square = jacobian @ jacobian.T + DAMPING * np.eye(n_rows)
        q = np.clip(q + jacobian.T @ np.linalg.solve(square, step), robot.lower, robot.upper)
    return best
