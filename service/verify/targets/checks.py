"""Checks of a phase's targets along the whole curve: poses, axes, circles, kept relative poses and joint values.

Lengths are Euclidean distances and angles those of rotations.  A distance changes by no more than its point moves, so
that along the path it exceeds its bound on the chord by at most the distance between the two.  The same holds for the
chord of an angle (``pose_errors``) and the tips of unit vectors; on straight lines both are convex, hence largest at an
end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from service.verify.certificate import Check
from service.verify.frame_paths import FramePath
from service.verify.motion import (
    AxisTarget,
    CircleTarget,
    HoleTarget,
    JointTarget,
    JointWayTarget,
    Phase,
    PoseTarget,
    RelativePoseTarget,
    VerifySettings,
    WayTarget,
)
from service.verify.phase_proof import Extreme, PhaseProof
from service.verify.prepared_motion import PreparedMotion
from service.verify.regions.checks import check_region
from service.verify.regions.region import RegionTarget
from service.verify.rounding import round_up
from service.verify.targets.holes import check_hole
from service.verify.targets.pose_errors import (
    AXIS_NAMES,
    PositionDemand,
    limits_rotation,
    list_position_demands,
    offset_from_target,
)
from service.verify.targets.turns import bound_lean, bound_turn
from service.verify.targets.ways import check_joint_way, check_way


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
        elif isinstance(target, RegionTarget):
            yield from check_region(proof, target)
        elif isinstance(target, HoleTarget):
            yield from check_hole(proof, target)
        elif isinstance(target, WayTarget):
            yield from check_way(proof, target)
        elif isinstance(target, JointWayTarget):
            yield from check_joint_way(proof, target)
        elif isinstance(target, CircleTarget):
            yield _circle_check(proof, target)
            if target.frame_axis is not None:
                tolerance = target.axis_tolerance_rad
                yield _axis_check(proof, AxisTarget(target.frame, target.frame_axis, target.axis, tolerance))
        else:
            yield _axis_check(proof, target)


@dataclass(frozen=True)
class _Claim:
    """A check's name, limit and sentences.

    Attributes:
        limit: in ``unit`` [m, rad].
        holds: sentence on a bound or the limit, given that as text.
        fails: sentence on the largest error, likewise.
        names: links concerned.
    """

    name: str
    limit: float
    unit: str
    holds: Callable[[str], str]
    fails: Callable[[str], str]
    names: tuple[str, ...]

    def check(self, proof: PhaseProof, extreme: Extreme, position: Float[np.ndarray, "3"]) -> Check:
        """Make the check of a bound; ``position`` is where the largest sample is [m]."""
        text = self.holds(self._show(extreme.bound))
        failure, promise = self.fails(self._show(extreme.sampled)), self.holds(self._show(self.limit))
        return proof.check(
            self.name,
            extreme,
            self.limit,
            self.unit,
            text,
            position,
            names=self.names,
            failure=failure,
            promise=promise,
        )

    def _show(self, value: float) -> str:
        return f"{round_up(1e3 * value, 2)} mm" if self.unit == "m" else f"{round_up(float(np.rad2deg(value)), 3)} deg"


def _joint_check(proof: PhaseProof, target: JointTarget) -> Check:
    motion = proof.prepared.motion
    value = float(motion.curve(np.array([target.at]))[0, motion.robot.joint_names.index(target.joint)])
    extreme = Extreme.at_one_pose(abs(value - target.value), target.at, target.tolerance)
    text = f"{target.joint} is at {value:.4f}, wanted {target.value:.4f}"
    return proof.check(f"target.{proof.phase.name}.{target.joint}", extreme, target.tolerance, "rad", text, None)


def _pose_checks(proof: PhaseProof, target: PoseTarget) -> Iterator[Check]:
    """Check the distance from a target's position, or offsets along its axes, and the angle off its orientation."""
    path = _origin_path(proof, target.frame)
    name, during = f"target.{proof.phase.name}.{target.frame}", proof.phase.name
    for demand in list_position_demands(target):

        def off(s: np.ndarray, demand: PositionDemand = demand) -> np.ndarray:
            return demand.measure(offset_from_target(target, path.at(s)[0][:, 0]))

        limit = demand.tolerance_m
        if target.at is None:
            extreme = proof.bound_convex(off, path.point_deviation, limit)
        else:
            extreme = Extreme.at_one_pose(float(off(np.array([target.at]))[0]), target.at, limit)
        axis = "" if demand.axis is None else AXIS_NAMES[demand.axis]
        own_name = f"{name}.{axis}" if axis else name
        claim = _make_pose_claim(target, own_name, limit, "m", during, axis)
        yield claim.check(proof, extreme, path.origin_at(extreme.s))
    if target.rotation is not None and limits_rotation(target):
        limit = float(target.rotation_tolerance[0])
        extreme = bound_turn(proof, path, target.rotation, None, limit, target.at)
        claim = _make_pose_claim(target, f"{name}.rotation", limit, "rad", during)
        yield claim.check(proof, extreme, path.origin_at(extreme.s))


def _make_pose_claim(target: PoseTarget, name: str, limit: float, unit: str, during: str, axis: str = "") -> _Claim:
    place = "its target"
    if axis:
        place += f" along {axis} of {'the world' if target.rotation is None else 'the target'}"
    return _Claim(
        name,
        limit,
        unit,
        lambda shown: f"{target.frame} is within {shown} of {place} in {during}",
        lambda shown: f"{target.frame} is {shown} off {place} in {during}",
        (target.frame,),
    )


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
    claim = _Claim(
        f"circle.{during}.{target.frame}",
        target.tolerance_m,
        "m",
        lambda shown: f"{target.frame} stays within {shown} of its circle during {during}",
        lambda shown: f"{target.frame} is {shown} off its circle during {during}",
        (target.frame,),
    )
    return claim.check(proof, extreme, path.origin_at(extreme.s))


def _relative_pose_checks(proof: PhaseProof, target: RelativePoseTarget) -> Iterator[Check]:
    """Check how far a frame moves relative to another, and how far it turns."""
    path, world_path = _origin_path(proof, target.frame, target.reference), _origin_path(proof, target.frame)
    to = "the world" if target.reference is None else target.reference
    during = f"relative to {to} during {proof.phase.name}"
    name = f"keep.{proof.phase.name}.{target.frame}.{target.reference or 'world'}"
    names = (target.frame,) if target.reference is None else (target.frame, target.reference)

    def shift(s: np.ndarray) -> np.ndarray:
        return _distance_from_slide(path.at(s)[0][:, 0] - target.position, target.slide)

    off = proof.bound_convex(shift, path.point_deviation, target.position_tolerance_m)
    place = _Claim(
        name,
        target.position_tolerance_m,
        "m",
        lambda shown: f"{target.frame} stays within {shown} of its place {during}",
        lambda shown: f"{target.frame} is {shown} off its place {during}",
        names,
    )
    yield place.check(proof, off, world_path.origin_at(off.s))
    what = target.frame if target.free_axis is None else f"the axis of {target.frame}"
    turned = bound_turn(proof, path, target.rotation, target.free_axis, target.rotation_tolerance_rad)
    turn = _Claim(
        f"{name}.rotation",
        target.rotation_tolerance_rad,
        "rad",
        lambda shown: f"{what} turns at most {shown} {during}",
        lambda shown: f"{what} turns by {shown} {during}",
        names,
    )
    yield turn.check(proof, turned, world_path.origin_at(turned.s))


def _axis_check(proof: PhaseProof, target: AxisTarget) -> Check:
    path, during = _origin_path(proof, target.frame), proof.phase.name
    extreme = bound_lean(proof, path, target.frame_axis, target.axis, target.tolerance_rad, target.at)
    claim = _Claim(
        f"axis.{during}.{target.frame}",
        target.tolerance_rad,
        "rad",
        lambda shown: f"the axis of {target.frame} leans at most {shown} during {during}",
        lambda shown: f"the axis of {target.frame} leans by {shown} during {during}",
        (target.frame,),
    )
    return claim.check(proof, extreme, path.origin_at(extreme.s))


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


def _segment_distance(a: Float[np.ndarray, "I 3"], b: Float[np.ndarray, "I 3"]) -> Float[np.ndarray, "I"]:
    """Return the distance of the origin from segments."""
    step = b - a
    along = np.clip(-(a * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + along[:, None] * step, axis=1))
