"""Checks of a phase's targets along the whole curve: poses, axes, circles, kept relative poses and joint values."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float

from service.verify.certificate import Check
from service.verify.frame_paths import FramePath
from service.verify.motion import (
    AxisTarget,
    CircleTarget,
    JointTarget,
    Phase,
    PoseTarget,
    RelativePoseTarget,
    VerifySettings,
)
from service.verify.phase_proof import Extreme, PhaseProof, values_at_ends
from service.verify.prepared_motion import PreparedMotion


def check_targets(prepared: PreparedMotion, phase: Phase, settings: VerifySettings) -> Iterator[Check]:
    """Check the targets of one phase."""
    proof = PhaseProof(prepared, phase, settings)
    for target in phase.targets:
        if isinstance(target, JointTarget):
            yield _joint_check(proof, target)
        elif isinstance(target, PoseTarget):
            yield from _pose_checks(proof, target)
        elif isinstance(target, RelativePoseTarget):
            yield from _relative_pose_checks(proof, target)
        elif isinstance(target, CircleTarget):
            yield _circle_check(proof, target)
            if target.frame_axis is not None:
                tolerance = target.axis_tolerance_rad
                yield _axis_check(proof, AxisTarget(target.frame, target.frame_axis, target.axis, tolerance))
        else:
            yield _axis_check(proof, target)


def _joint_check(proof: PhaseProof, target: JointTarget) -> Check:
    motion = proof.prepared.motion
    value = float(motion.curve(np.array([target.at]))[0, motion.robot.joint_names.index(target.joint)])
    extreme = Extreme.at_one_pose(abs(value - target.value), target.at, target.tolerance)
    text = f"{target.joint} is at {value:.4f}, wanted {target.value:.4f}"
    return proof.check(f"target.{proof.phase.name}.{target.joint}", extreme, target.tolerance, "rad", text, None)


def _pose_checks(proof: PhaseProof, target: PoseTarget) -> Iterator[Check]:
    path = _origin_path(proof, target.frame)
    wanted = np.eye(3) if target.rotation is None else target.rotation

    def shift(s: np.ndarray) -> np.ndarray:
        offset = np.abs((path.at(s)[0][:, 0] - target.position) @ wanted)
        return np.asarray(offset[:, np.isfinite(target.position_tolerance_m)])

    tolerance = target.position_tolerance_m[np.isfinite(target.position_tolerance_m)]
    name = f"target.{proof.phase.name}.{target.frame}"
    if len(tolerance):
        yield _component_check(proof, target, path, shift, tolerance, name, "m")
    if target.rotation is None or not np.any(np.isfinite(target.rotation_tolerance)):
        return

    def turn(s: np.ndarray) -> np.ndarray:
        return np.asarray(np.abs(_sine_vector(wanted.T @ path.at(s)[1]))[:, np.isfinite(target.rotation_tolerance)])

    # The sine vector is linear in the rotation matrix, hence along the chord.
    sines = np.sin(np.minimum(target.rotation_tolerance[np.isfinite(target.rotation_tolerance)], 0.5 * np.pi))
    yield _component_check(proof, target, path, turn, sines, f"{name}.rotation", "rad")


def _component_check(
    proof: PhaseProof,
    target: PoseTarget,
    path: FramePath,
    errors: Callable[[np.ndarray], np.ndarray],
    tolerance: Float[np.ndarray, "k"],
    name: str,
    unit: str,
) -> Check:
    """Check the largest error in units of its tolerance, at one pose or along the phase."""
    scale = float(tolerance.min())

    def relative(s: np.ndarray) -> np.ndarray:
        return np.asarray((errors(s) / tolerance).max(axis=1) * scale)

    if target.at is None:
        extreme = proof.bound_convex(relative, path.point_deviation if unit == "m" else path.direction_deviation, scale)
    else:
        extreme = Extreme.at_one_pose(float(relative(np.array([target.at]))[0]), target.at, scale)
    shown = f"{1e3 * extreme.bound:.2f} mm" if unit == "m" else f"{np.rad2deg(extreme.bound):.3f} deg"
    text = f"{target.frame} is within {shown} of its target in {proof.phase.name}"
    return proof.check(name, extreme, scale, unit, text, path.origin_at(extreme.s), names=(target.frame,))


def _circle_check(proof: PhaseProof, target: CircleTarget) -> Check:
    path = _origin_path(proof, target.frame)

    def split(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = path.at(s)[0][:, 0] - target.centre
        height = offset @ target.axis
        return height, offset - height[:, None] * target.axis

    def error(height: np.ndarray, flat: np.ndarray) -> np.ndarray:
        return np.asarray(np.hypot(height, np.linalg.norm(flat, axis=1) - target.radius))

    def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (h0, f0), (h1, f1) = split(first), split(last)
        # Along the chord the height is largest at an end, the radius largest at an end and smallest at its foot.
        outer = np.maximum(np.linalg.norm(f0, axis=1), np.linalg.norm(f1, axis=1)) - target.radius
        inner = target.radius - _segment_distance(f0, f1)
        upper = np.hypot(np.maximum(np.abs(h0), np.abs(h1)), np.maximum(outer, inner))
        return upper + path.point_deviation(first, last), error(h0, f0), error(h1, f1)

    extreme, during = proof.bound(evaluate, target.tolerance_m), proof.phase.name
    text = f"{target.frame} stays within {1e3 * extreme.bound:.2f} mm of its circle during {during}"
    name, at = f"circle.{during}.{target.frame}", path.origin_at(extreme.s)
    return proof.check(name, extreme, target.tolerance_m, "m", text, at, names=(target.frame,))


def _relative_pose_checks(proof: PhaseProof, target: RelativePoseTarget) -> Iterator[Check]:
    """Check how far a frame moves relative to another, and how far it turns."""
    path = _origin_path(proof, target.frame, target.reference)
    to = "the world" if target.reference is None else target.reference
    during = f"relative to {to} during {proof.phase.name}"
    name = f"keep.{proof.phase.name}.{target.frame}.{target.reference or 'world'}"
    names = (target.frame,) if target.reference is None else (target.frame, target.reference)
    kept = target.rotation if target.free_axis is None else target.rotation @ target.free_axis[:, None]

    def shift(s: np.ndarray) -> np.ndarray:
        return _distance_from_slide(path.at(s)[0][:, 0] - target.position, target.slide)

    def chord(s: np.ndarray) -> np.ndarray:
        """Return the largest distance of the tip of a kept unit vector from its place: 2 sin(half the angle) [-]."""
        rotation = path.at(s)[1]
        if target.free_axis is None:
            return np.asarray(np.linalg.norm(rotation - kept, axis=(1, 2)) / np.sqrt(2.0))
        return np.asarray(np.linalg.norm(rotation @ target.free_axis[:, None] - kept, axis=(1, 2)))

    def turns(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # The distance of the tip of a unit vector from its place is convex along the chord.
        ends = values_at_ends(chord, first, last)
        largest_chord = np.maximum(*ends) + path.direction_deviation(first, last)
        return _angle(largest_chord), _angle(ends[0]), _angle(ends[1])

    limit, angle = target.position_tolerance_m, target.rotation_tolerance_rad
    off, turned = proof.bound_convex(shift, path.point_deviation, limit), proof.bound(turns, angle)
    world_path = _origin_path(proof, target.frame)
    text = f"{target.frame} stays within {1e3 * off.bound:.2f} mm of its place {during}"
    failure = f"{target.frame} is {1e3 * off.sampled:.2f} mm off its place {during}"
    yield proof.check(name, off, limit, "m", text, world_path.origin_at(off.s), names=names, failure=failure)
    what = target.frame if target.free_axis is None else f"the axis of {target.frame}"
    text = f"{what} turns at most {np.rad2deg(turned.bound):.3f} deg {during}"
    failure = f"{what} turns by {np.rad2deg(turned.sampled):.3f} deg {during}"
    at = world_path.origin_at(turned.s)
    yield proof.check(f"{name}.rotation", turned, angle, "rad", text, at, names=names, failure=failure)


def _axis_check(proof: PhaseProof, target: AxisTarget) -> Check:
    path = _origin_path(proof, target.frame)

    def split(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        direction = path.at(s)[1] @ target.frame_axis
        along = direction @ target.axis
        return along, np.linalg.norm(direction - along[:, None] * target.axis, axis=1)

    def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (a0, p0), (a1, p1) = split(first), split(last)
        deviation = path.direction_deviation(first, last)
        # Across the axis the chord is farthest at an end, along it least at an end; the path is near the chord.
        upper = np.arctan2(np.maximum(p0, p1) + deviation, np.minimum(a0, a1) - deviation)
        return upper, np.arctan2(p0, a0), np.arctan2(p1, a1)

    if target.at is None:
        extreme = proof.bound(evaluate, target.tolerance_rad)
    else:
        along, across = split(np.array([target.at]))
        extreme = Extreme.at_one_pose(float(np.arctan2(across, along)[0]), target.at, target.tolerance_rad)
    text = f"the axis of {target.frame} leans at most {np.rad2deg(extreme.bound):.2f} deg during {proof.phase.name}"
    name, at = f"axis.{proof.phase.name}.{target.frame}", path.origin_at(extreme.s)
    return proof.check(name, extreme, target.tolerance_rad, "rad", text, at, names=(target.frame,))


def _distance_from_slide(
    offset: Float[np.ndarray, "S 3"], slide: Float[np.ndarray, "3"] | None
) -> Float[np.ndarray, "S"]:
    """Return the distance of points from the segment +- ``slide`` about the origin; of the origin without one [m].

    Like every distance from a convex set, it is convex along a chord.
    """
    if slide is None or not np.any(slide):
        return np.asarray(np.linalg.norm(offset, axis=1))
    share = np.clip(offset @ slide / (slide @ slide), -1.0, 1.0)
    return np.asarray(np.linalg.norm(offset - share[:, None] * slide, axis=1))


def _origin_path(proof: PhaseProof, frame: str, reference: str | None = None) -> FramePath:
    return FramePath.of(proof.prepared, frame, np.zeros((1, 3)), proof.settings.rounding, reference)


def _sine_vector(rotation: Float[np.ndarray, "S 3 3"]) -> Float[np.ndarray, "S 3"]:
    """Return sin(angle) times the rotation's axis; beyond a quarter turn a vector longer than any sine."""
    sine = 0.5 * np.stack(
        [
            rotation[:, 2, 1] - rotation[:, 1, 2],
            rotation[:, 0, 2] - rotation[:, 2, 0],
            rotation[:, 1, 0] - rotation[:, 0, 1],
        ],
        axis=1,
    )
    is_far = np.trace(rotation, axis1=1, axis2=2) <= 1.0
    return np.where(is_far[:, None], 2.0, sine)


def _angle(chord: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the angle between unit vectors whose tips are ``chord`` apart [rad]; pi beyond the diameter."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))


def _segment_distance(a: Float[np.ndarray, "I 3"], b: Float[np.ndarray, "I 3"]) -> Float[np.ndarray, "I"]:
    """Return the distance of the origin from segments."""
    step = b - a
    along = np.clip(-(a * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + along[:, None] * step, axis=1))
