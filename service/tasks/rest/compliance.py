"""Keep an earlier motion though its mechanism has moved a little: the arm that holds it yields, nothing else changes.

The joints between trunk and hand are displaced by the least that leads the hand along the mechanism where it is now.
Base, legs, trunk and the other arm do exactly what they did, at the same times; only stretches on which the displaced
arm would pass a limit of speed or acceleration are slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from costs.curve import Curve
from costs.kinematics import KinematicsEngine, locate_frame
from costs.robot import RobotModel
from costs.terms import FramePose
from service.body.holds import POSITION, Hold, linearize_holds
from service.body.task_plan import KeptCurve, TaskPlan
from service.demands.phase import FrameMotion, TaskPhase
from service.demands.rest.earlier_motion import EarlierMotion
from service.tasks.handling import list_arm_joints
from service.tasks.held_tool import aim_tool, make_hold, slide_tool
from service.tasks.sequence import PhaseSequence

MOST_M, MOST_RAD = 0.015, np.deg2rad(5.0)  # by which a hand yields [m, rad]
SAME_STATE = 2e-5  # of the robot where the rest begins: the earlier motion is written with five digits [rad, m]
SAME_MECHANISM = 1e-4  # of the mechanism at the ends of a phase [rad, m]
SAME_HOLD = 1e-3  # of the arm's joints where the rest begins with the hand at its place [rad]
STEPS = 25  # of Gauss-Newton
DAMPING, LEAST_DAMPING = 1e-3, 1e-6  # of the first and of the last ones [m^2, rad^2]
KEPT_WEIGHT = 0.03  # of the hand's earlier pose, which is kept as far as its place and its lean allow; it fades
KEPT_LENGTH = 0.3  # by which the hand may as well be off as by 1 rad [m]
SLIDE_RESERVE = 2e-3  # of what a hand may slide, for the curve between the knots [m]
FADING = 0.6  # of damping and weight from step to step
MOST_STEP = 0.05  # of a joint [rad, m]
SETTLED = 1e-5  # of the arm's joints in a step [rad]
LIMIT_ROUNDS = 4  # of the search for joints at their limits
RESERVE = 0.01  # kept from the joint limits, for the curve between the knots [rad, m]
BETWEEN = np.array([0.25, 0.5, 0.75])  # of an interval: where the displacement is measured besides the knots


class CannotFollowError(ValueError):
    """The earlier motion cannot be kept; the message says why."""


@dataclass(frozen=True)
class Displacement:
    """Largest displacement of a hand from the earlier motion.

    Attributes:
        distance_m, turn_rad: of the tool's origin and of its orientation, each at its largest.
        phase: in which the distance is largest.
        hand: the tool.
    """

    distance_m: float
    turn_rad: float
    phase: str
    hand: str

    @property
    def is_compliance(self) -> bool:
        """Whether a hand that yields is displaced as far without another command."""
        return self.distance_m <= MOST_M and self.turn_rad <= MOST_RAD

    def __str__(self) -> str:
        size = f"{1e3 * self.distance_m:.1f} mm and {np.rad2deg(self.turn_rad):.1f} deg"
        return f"{self.hand} is displaced by up to {size}, most in '{self.phase}'"


def keep_motion(sequence: PhaseSequence, earlier: EarlierMotion) -> tuple[TaskPlan, Displacement]:
    """Return the earlier motion with the arm displaced that holds the mechanism of the sequence, and by how much.

    Args:
        sequence: phases of the rest.
        earlier: the earlier motion with knots, tangents and time law.

    Raises:
        CannotFollowError: the robot or the mechanism is not as the earlier motion begins, or an arm does not reach.
    """
    body, engine = sequence.solver.body, sequence.solver.body.engine
    curve, borders = _join_curves(sequence, earlier)
    _check_start(sequence, curve, borders)
    paths = [curve.positions[a : b + 1] for a, b in borders]
    offset = np.zeros_like(curve.positions)
    for spec, (a, b), path in zip(sequence.specs, borders, paths, strict=True):
        if spec.hand is not None and not spec.hand.is_line:
            offset[a : b + 1] = _yield_arm(engine, spec, spec.hand, path) - path
    for spec, (a, b), path in zip(sequence.specs, borders, paths, strict=True):
        if spec.hand is not None and spec.hand.is_line:
            contact = path[[0 if spec.hand.leaves else -1]]
            off = _locate(engine, spec.hand.tool, _yield_arm(engine, spec, spec.hand, contact))[1]
            off = (off - _locate(engine, spec.hand.tool, contact)[1])[0]
            offset[a : b + 1] = _yield_arm(engine, spec, spec.hand, path, off) - path
    for spec, (a, b), path in zip(sequence.specs, borders, paths, strict=True):
        if spec.hand is None:
            blend = _blend(curve.knots[a : b + 1], *_find_ends(offset, a, b))
            offset[a : b + 1] = np.clip(path + blend, *_find_limits(body.robot, path, np.arange(body.robot.n))) - path
    _begin_at_start(sequence.specs[0], curve, offset, borders[0][1])
    tangents = np.concatenate([_differentiate(curve.knots[a : b + 1], offset[a : b + 1])[:-1] for a, b in borders])
    displaced = Curve(
        curve.knots,
        curve.positions + offset,
        curve.tangents + np.concatenate([tangents, np.zeros((1, body.robot.n))]),
    )
    largest = _measure(engine, sequence.specs, borders, curve, displaced)
    phases = []
    for phase, (a, b) in zip(sequence.take([displaced.positions[a : b + 1] for a, b in borders]), borders, strict=True):
        own = displaced.cut(slice(a, b + 1))
        known = KeptCurve.of(earlier, phase.name)
        if earlier.law is not None and (known is None or known.law is None):
            raise CannotFollowError(f"the earlier time law does not lead from rest to rest through '{phase.name}'")
        phases.append(replace(phase, kept=KeptCurve(own, None if known is None else known.law)))
    return TaskPlan(body, tuple(phases)), largest


def _join_curves(sequence: PhaseSequence, earlier: EarlierMotion) -> tuple[Curve, list[tuple[int, int]]]:
    """Return the earlier curve of the rest, and the first and the last knot of each of its phases."""
    if not earlier.curves:
        raise CannotFollowError("the earlier motion has other joints")
    parts: list[Curve] = []
    borders: list[tuple[int, int]] = []
    for spec in sequence.specs:
        curve = earlier.curves.get(spec.name)
        if curve is None:
            raise CannotFollowError(f"the earlier motion has no phase '{spec.name}'")
        if parts and curve.knots[0] != parts[-1].knots[-1]:
            raise CannotFollowError(f"in the earlier motion '{spec.name}' does not follow on the phase before")
        first = borders[-1][1] if borders else 0
        borders.append((first, first + len(curve.knots) - 1))
        parts.append(curve.cut(slice(1 if parts else 0, None)))
    columns = zip(*((part.knots, part.positions, part.tangents) for part in parts), strict=True)
    return Curve(*map(np.concatenate, columns)), borders


def _check_start(sequence: PhaseSequence, curve: Curve, borders: Sequence[tuple[int, int]]) -> None:
    """Refuse a robot or a mechanism that is not where the earlier motion has it; take the start's last digits."""
    names, count = sequence.solver.body.robot.joint_names, len(sequence.mechanism.joints)
    off = np.abs(curve.positions[0] - sequence.solver.body.nominal)
    worst = int(off.argmax())
    if off[worst] > SAME_STATE:
        raise CannotFollowError(f"{names[worst]} is {off[worst]:.3g} off the beginning of the earlier motion")
    curve.positions[0] = sequence.solver.body.nominal
    for spec, (a, b) in zip(sequence.specs, borders, strict=True):
        for knot, values in ((a, spec.first), (b, spec.last)):
            if np.abs(curve.positions[knot, -count:] - values).max() > SAME_MECHANISM:
                raise CannotFollowError(f"in '{spec.name}' the mechanism moves otherwise than in the earlier motion")
            curve.positions[knot, -count:] = values


def _yield_arm(
    engine: KinematicsEngine,
    spec: TaskPhase,
    hand: FrameMotion,
    q: Float[np.ndarray, "T n"],
    off_m: Float[np.ndarray, "3"] | None = None,
) -> Float[np.ndarray, "T n"]:
    """Return configurations with the hand at its place, or ``off_m`` from where it was in the world, by a small change.

    Gauss-Newton from the earlier motion.  The hand leans no farther than half-way between what the waypoints of a new
    plan and its curve may, and is turned otherwise as little as that allows.
    """
    robot, model = engine.robot, engine.robot.model
    columns = np.array([int(model.joints[joint].idx_v) for joint in list_arm_joints(robot, hand.tool)])
    poses = np.tile(np.eye(4), (len(q), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = _locate(engine, hand.tool, q)
    shifted = poses.copy()
    shifted[:, :3, :3] = np.eye(3)
    shifted[:, :3, 3] += 0.0 if off_m is None else off_m
    beside: Hold = lambda waypoints: FramePose(robot, hand.tool, waypoints, shifted[waypoints], POSITION)  # noqa: E731
    axis: Hold = lambda waypoints: aim_tool(robot, hand, waypoints)  # noqa: E731
    kept: Hold = lambda waypoints: FramePose(robot, hand.tool, waypoints, poses[waypoints], (True,) * 6)  # noqa: E731
    along: Hold = lambda waypoints: slide_tool(robot, hand, waypoints, hand.place[None])  # noqa: E731
    slide = None if off_m is not None else hand.slide
    room = 0.0 if slide is None else float(np.linalg.norm(slide)) - SLIDE_RESERVE
    holds = [make_hold(robot, hand) if off_m is None else beside, *([] if slide is None else [along]), axis, kept]
    lean = 0.5 * (hand.aim_rad + hand.tilt_rad)
    x, limits = np.array(q), _find_limits(robot, q, columns)
    for step in range(STEPS):
        value, rows = linearize_holds(engine, x, holds)
        off = float(np.abs(value[:, : -8 if slide is None else -9]).max())
        if slide is not None:
            _limit_rows(value[:, -9:-8], rows[:, -9:-8], room)
        leans = _limit_rows(value[:, -8:-6], rows[:, -8:-6], lean)
        weight = KEPT_WEIGHT * FADING**step * np.repeat([1.0 / KEPT_LENGTH, 1.0], 3)
        value[:, -6:] *= weight
        rows[:, -6:] *= weight[:, None]
        damping = max(DAMPING * FADING**step, LEAST_DAMPING)
        moved = _step_within(x[:, columns], value, rows[:, :, columns], damping, limits)
        change = np.abs(moved - x[:, columns]).max()
        x[:, columns] = moved
        if change <= SETTLED:
            break
    if off > hand.tolerance_m or leans > hand.tilt_rad - lean:
        words = f"{1e3 * off:.1f} mm and {np.rad2deg(leans):.1f} deg"
        raise CannotFollowError(f"the arm of {hand.tool} alone does not follow in '{spec.name}': it stays {words} off")
    return x


def _limit_rows(value: Float[np.ndarray, "T k"], rows: Float[np.ndarray, "T k n"], most: float) -> float:
    """Reduce residuals and their derivatives in place to what is beyond a length; return the most that is beyond it."""
    length = np.linalg.norm(value, axis=1)
    beyond = np.maximum(1.0 - most / np.maximum(length, most), 0.0)
    value *= beyond[:, None]
    rows *= (beyond > 0.0)[:, None, None]
    return float(np.max(beyond * length))


def _find_limits(
    robot: RobotModel, q: Float[np.ndarray, "T n"], columns: Int[np.ndarray, "a"]
) -> tuple[Float[np.ndarray, "T a"], Float[np.ndarray, "T a"]]:
    """Return limits of joints that leave room for the curve between the knots, as far as the earlier motion does."""
    at = q[:, columns]
    return np.minimum(robot.lower[columns] + RESERVE, at), np.maximum(robot.upper[columns] - RESERVE, at)


def _step_within(
    x: Float[np.ndarray, "T a"],
    value: Float[np.ndarray, "T k"],
    jacobian: Float[np.ndarray, "T k a"],
    damping: float,
    limits: tuple[Float[np.ndarray, "T a"], Float[np.ndarray, "T a"]],
) -> Float[np.ndarray, "T a"]:
    """Return joints after a damped least-norm step; those that would pass a limit stay at it while the others move."""
    at_limit = np.zeros(x.shape, dtype=bool)
    moved = x
    for _ in range(LIMIT_ROUNDS):
        rest = value + np.einsum("tka,ta->tk", jacobian, np.where(at_limit, moved - x, 0.0))
        free = np.where(at_limit[:, None, :], 0.0, jacobian)
        gram = free @ free.transpose(0, 2, 1) + damping * np.eye(value.shape[1])
        step = np.einsum("tka,tk->ta", free, np.linalg.solve(gram, rest[..., None])[..., 0])
        step *= np.minimum(1.0, MOST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), MOST_STEP))
        moved = np.where(at_limit, moved, np.clip(x - step, *limits))
        beyond = ~at_limit & ((x - step < limits[0]) | (x - step > limits[1]))
        if not beyond.any():
            break
        at_limit |= beyond
    return moved


def _locate(
    engine: KinematicsEngine, frame: str, q: Float[np.ndarray, "T n"]
) -> tuple[Float[np.ndarray, "T 3 3"], Float[np.ndarray, "T 3"]]:
    """Return a frame's rotations and positions in the world."""
    joint, pose = locate_frame(engine.robot, frame)
    kinematics = engine(q)
    rotation = kinematics.rotation[:, joint]
    return rotation @ pose[:3, :3], rotation @ pose[:3, 3] + kinematics.position[:, joint]


def _begin_at_start(spec: TaskPhase, curve: Curve, offset: Float[np.ndarray, "K n"], last: int) -> None:
    """Let the displacement begin at nothing, in place, where the first phase has a hand."""
    off = offset[0].copy()
    if spec.hand is not None and not spec.hand.is_line and np.abs(off).max() > SAME_HOLD:
        raise CannotFollowError(f"the hand is not at its place where '{spec.name}' begins")
    offset[: last + 1] -= _blend(curve.knots[: last + 1], off, np.zeros_like(off))


def _find_ends(
    offset: Float[np.ndarray, "K n"], first: int, last: int
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the displacements between which a free phase leads: none where the motion begins or ends."""
    still = np.zeros(offset.shape[1])
    return (offset[first] if first else still), (offset[last] if last < len(offset) - 1 else still)


def _blend(
    s: Float[np.ndarray, "T"], first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "T n"]:
    """Return displacements that lead from one to another and begin and end at rest."""
    share = ((s - s[0]) / (s[-1] - s[0]))[:, None]
    return np.asarray(first + (last - first) * share**2 * (3.0 - 2.0 * share))


def _differentiate(s: Float[np.ndarray, "T"], q: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T n"]:
    """Return three-point derivatives, zero at both ends."""
    slopes, h = np.diff(q, axis=0) / np.diff(s)[:, None], np.diff(s)[:, None]
    tangents = np.zeros_like(q)
    tangents[1:-1] = (h[1:] * slopes[:-1] + h[:-1] * slopes[1:]) / (h[1:] + h[:-1])
    return tangents


def _measure(
    engine: KinematicsEngine,
    specs: Sequence[TaskPhase],
    borders: Sequence[tuple[int, int]],
    earlier: Curve,
    displaced: Curve,
) -> Displacement:
    """Return the largest displacement of a hand while it handles the mechanism, at the knots and between them."""
    largest = Displacement(0.0, 0.0, specs[0].name, "no hand")
    for tool in dict.fromkeys(spec.hand.tool for spec in specs if spec.hand is not None):
        for spec, (a, b) in zip(specs, borders, strict=True):
            if spec.hand is None or spec.hand.tool != tool:
                continue
            knots = earlier.knots[a : b + 1]
            s = np.concatenate([knots, (knots[:-1] + BETWEEN[:, None] * np.diff(knots)).ravel()])
            (r0, p0), (r1, p1) = (_locate(engine, tool, curve(s)) for curve in (earlier, displaced))
            distance = float(np.linalg.norm(p1 - p0, axis=1).max())
            cosine = 0.5 * (np.einsum("tij,tij->t", r0, r1) - 1.0)
            turn = max(float(np.arccos(np.clip(cosine, -1.0, 1.0)).max()), largest.turn_rad)
            if distance > largest.distance_m:
                largest = Displacement(distance, turn, spec.name, tool)
            largest = replace(largest, turn_rad=turn)
    return largest
