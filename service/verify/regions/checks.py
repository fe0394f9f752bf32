"""Checks of regions: offsets along axes, distances, angles, and axes that point to a place, between all waypoints.

A box, a cylinder and a ball are convex, so that along a chord a frame is farthest out at an end.  A component of a
rotation vector of angle ``a`` changes by no more than ``(a / 2) / sin(a / 2)`` times the turn (the inverse of the left
Jacobian of SO(3) has that norm).  A direction to a place at least ``d`` away turns by at most ``2 asin(r / (2 d))``
while the frame's origin moves by ``r``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from service.verify.certificate import Check
from service.verify.frame_paths import FramePath
from service.verify.motion import Motion
from service.verify.phase_proof import Extreme, PhaseProof, values_at_ends
from service.verify.regions.region import RegionTarget
from service.verify.rounding import round_down, round_up
from service.verify.targets.pose_errors import AXIS_NAMES, measure_rotation_vector
from service.verify.targets.turns import bound_lean, bound_turn

LARGEST_TURN = np.pi - 1e-3  # angle of a rotation vector beyond which its components have no bound [rad]
FINE_M = 1e-3  # of a bound on one side, by which it may exceed the largest value [m]
NEAREST_M = 1e-6  # of a place to look at [m]


@dataclass(frozen=True)
class _Limited:
    """One limit of a region.

    Attributes:
        part: end of the check's name.
        what: subject and measure, in words that a figure follows; of a bound on one side, what it is beyond.
        limit: in ``unit`` [m, rad]; 0 of a bound on one side.
        extreme: largest value.
    """

    part: str
    what: str
    limit: float
    unit: str
    extreme: Extreme


def check_region(proof: PhaseProof, target: RegionTarget) -> Iterator[Check]:
    """Check each limit of a region on its part of the phase."""
    span = find_span(proof.prepared.motion, target, proof.phase.first, proof.phase.last)
    if span is None:
        return
    name, where = proof.phase.name, proof
    if target.at is None:
        where = replace(proof, phase=replace(proof.phase, first=span[0], last=span[1]))
    to = "the world" if target.reference is None else target.reference
    path = FramePath.of(proof.prepared, target.frame, np.zeros((1, 3)), proof.settings.rounding, target.reference)
    world = FramePath.of(proof.prepared, target.frame, np.zeros((1, 3)), proof.settings.rounding)
    for one in _list_limits(where, target, path):
        limit, bound, sampled = (
            _show(value, one.unit) for value in (one.limit, one.extreme.bound, one.extreme.sampled)
        )
        during = f"relative to {to} in {name}"
        text, failure = (
            f"{one.what} at most {bound} {during}",
            f"{one.what} {sampled} instead of at most {limit} {during}",
        )
        promise = f"{one.what} at most {limit} {during}"
        if one.limit == 0.0:
            text = f"{target.frame} stays {round_down(-1e3 * one.extreme.bound, 2)} mm inside of {one.what} {during}"
            promise = f"{target.frame} stays inside of {one.what} {during}"
            failure = f"{target.frame} is {sampled} beyond {one.what} {during}"
        yield where.check(
            f"region.{name}.{target.frame}.{target.reference or 'world'}.{_describe_part(target)}{one.part}",
            one.extreme,
            one.limit,
            one.unit,
            text,
            world.origin_at(one.extreme.s),
            names=(target.frame,) if target.reference is None else (target.frame, target.reference),
            failure=failure,
            promise=promise,
        )


def find_span(motion: Motion, target: RegionTarget, first: float, last: float) -> tuple[float, float] | None:
    """Return the path parameters of a phase between which a region holds; None where it does not."""
    if target.at is not None:
        return target.at, target.at
    start, length = float(motion.curve.knots[0]), float(motion.curve.knots[-1] - motion.curve.knots[0])
    begin, end = (float(start + share * length) for share in target.during)
    if end <= first or begin >= last:
        return None
    return max(begin, first), min(end, last)


def _describe_part(target: RegionTarget) -> str:
    """Return the part of the motion as a piece of a check's name; empty for all of it, and for one pose."""
    if target.at is not None or (target.during[0] <= 0.0 and target.during[1] >= 1.0):
        return ""
    return f"{target.during[0]:g}-{target.during[1]:g}."


def _list_limits(proof: PhaseProof, target: RegionTarget, path: FramePath) -> Iterator[_Limited]:
    frame = target.frame

    def offset(s: np.ndarray) -> np.ndarray:
        return np.asarray((path.at(s)[0][:, 0] - target.position) @ target.rotation)

    def bound(value: Callable[[np.ndarray], np.ndarray], limit: float, fine: float | None = None) -> Extreme:
        if target.at is not None:
            return Extreme.at_one_pose(float(value(np.array([target.at]))[0]), target.at, limit)
        return proof.bound_convex(value, path.point_deviation, limit, fine)

    for k, axis in enumerate(AXIS_NAMES):
        low, high = float(target.lower[k]), float(target.upper[k])
        if np.isfinite(low) and np.isfinite(high):
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            extreme = bound(lambda s, k=k, m=middle: np.abs(offset(s)[:, k] - m), half)  # type: ignore[misc]
            yield _Limited(axis, f"{frame} is off the middle of its region along {axis} by", half, "m", extreme)
        elif np.isfinite(high):
            extreme = bound(lambda s, k=k, h=high: offset(s)[:, k] - h, 0.0, FINE_M)  # type: ignore[misc]
            yield _Limited(axis, f"{high:g} m along {axis}", 0.0, "m", extreme)
        elif np.isfinite(low):
            extreme = bound(lambda s, k=k, h=low: h - offset(s)[:, k], 0.0, FINE_M)  # type: ignore[misc]
            yield _Limited(axis, f"{low:g} m along {axis}", 0.0, "m", extreme)
    if np.isfinite(target.radius_m):
        extreme = bound(lambda s: np.linalg.norm(offset(s)[:, :2], axis=1), target.radius_m)
        yield _Limited("radius", f"{frame} is off the z axis of its region by", target.radius_m, "m", extreme)
    if np.isfinite(target.distance_m):
        extreme = bound(lambda s: np.linalg.norm(offset(s), axis=1), target.distance_m)
        yield _Limited("distance", f"{frame} is off its place by", target.distance_m, "m", extreme)
    if np.isfinite(target.turn_rad):
        extreme = bound_turn(proof, path, target.rotation, None, target.turn_rad, target.at)
        yield _Limited("rotation", f"{frame} is turned by", target.turn_rad, "rad", extreme)
    for k, axis in enumerate(AXIS_NAMES):
        if np.isfinite(target.turns_rad[k]):
            limit = float(target.turns_rad[k])
            extreme = _bound_component(proof, path, target.rotation, k, limit, target.at)
            yield _Limited(f"about_{axis}", f"{frame} is turned about {axis} by", limit, "rad", extreme)
    if target.axis is not None and np.isfinite(target.lean_rad):
        if target.place is None:
            wanted = target.rotation @ target.axis
            extreme = bound_lean(proof, path, target.axis, wanted, target.lean_rad, target.at)
            yield _Limited("axis", f"the axis of {frame} leans by", target.lean_rad, "rad", extreme)
        else:
            extreme = _bound_sight(proof, path, target.axis, target.place, target.lean_rad, target.at)
            yield _Limited("look", f"the axis of {frame} misses its place by", target.lean_rad, "rad", extreme)


def _bound_component(
    proof: PhaseProof,
    path: FramePath,
    wanted: Float[np.ndarray, "3 3"],
    k: int,
    limit: float,
    at: float | None,
) -> Extreme:
    """Bound the absolute component of the rotation vector from a wanted orientation [rad]."""

    def vectors(s: np.ndarray) -> np.ndarray:
        return measure_rotation_vector(wanted.T @ path.at(s)[1])

    if at is not None:
        return Extreme.at_one_pose(float(abs(vectors(np.array([at]))[0, k])), at, limit)

    def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        both = vectors(np.concatenate([first, last]))
        before, after = both[: len(first)], both[len(first) :]
        turn = path.turning_angle(first, last)
        farthest = 0.5 * (np.linalg.norm(before, axis=1) + np.linalg.norm(after, axis=1) + turn)
        half = 0.5 * np.minimum(farthest, LARGEST_TURN)
        gain = np.where(half > 1e-9, half / np.sin(np.maximum(half, 1e-9)), 1.0)
        ends = np.abs(before[:, k]), np.abs(after[:, k])
        upper = np.where(farthest < LARGEST_TURN, 0.5 * (ends[0] + ends[1] + gain * turn), np.pi)
        return np.maximum(upper, np.maximum(*ends)), *ends

    return proof.bound(evaluate, limit, largest=np.pi)


def _bound_sight(
    proof: PhaseProof,
    path: FramePath,
    axis: Float[np.ndarray, "3"],
    place: Float[np.ndarray, "3"],
    limit: float,
    at: float | None,
) -> Extreme:
    """Bound the angle between an axis of a frame and the direction from its origin to a place [rad]."""

    def angle(s: np.ndarray) -> np.ndarray:
        points, rotation = path.at(s)
        sight = place - points[:, 0]
        along = np.einsum("sk,sk->s", rotation @ axis, sight)
        across = np.linalg.norm(np.cross(rotation @ axis, sight), axis=1)
        return np.where(np.linalg.norm(sight, axis=1) > NEAREST_M, np.arctan2(across, along), np.pi)

    if at is not None:
        return Extreme.at_one_pose(float(angle(np.array([at]))[0]), at, limit)

    def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ends = values_at_ends(angle, first, last)
        before, after = path.at(first)[0][:, 0], path.at(last)[0][:, 0]
        deviation = path.point_deviation(first, last)
        chord = np.linalg.norm(after - before, axis=1)
        away = np.maximum(_distance_from_chord(before - place, after - place) - deviation, NEAREST_M)
        swept = _arc(deviation, away) + _arc(chord + deviation, away)
        upper = 0.5 * (ends[0] + ends[1] + path.turning_angle(first, last) + swept)
        return np.maximum(np.minimum(upper, np.pi), np.maximum(*ends)), *ends

    return proof.bound(evaluate, limit, largest=np.pi)


def _arc(moved: Float[np.ndarray, "I"], away: Float[np.ndarray, "I"]) -> Float[np.ndarray, "I"]:
    """Return the largest turn of a direction to a place at least ``away`` off while the origin moves [rad]."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * moved / away, 1.0)))


def _distance_from_chord(a: Float[np.ndarray, "I 3"], b: Float[np.ndarray, "I 3"]) -> Float[np.ndarray, "I"]:
    """Return the distance of the origin from the segments between two rows of points [m]."""
    step = b - a
    share = np.clip(-(a * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + share[:, None] * step, axis=1))


def _show(value: float, unit: str) -> str:
    return f"{round_up(1e3 * value, 2)} mm" if unit == "m" else f"{round_up(float(np.rad2deg(value)), 3)} deg"
