"""Detection of valves of either kind: wheels and levers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from perception.detect.shared.arithmetic import cross, rising
from perception.detect.shared.bar_pivot import Pivot
from perception.detect.shared.bars import Bar
from perception.detect.shared.detection import CONFIDENT, Detection
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.lever_bars import LENGTHS, FittedBar, find_levers, find_pipes
from perception.detect.valve.lever_joint import LeverJoint, joint_of, settle_joint
from perception.detect.valve.wheel import find_wheels
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex
from perception.view import View

_REPORTED, _HOPELESS = 0.05, 0.02
_SLIM = (5.5, 8.5)  # length by radius; smaller for a hose coupling on a standpipe
_END_UNSEEN = 0.4
_AIR_ABOUT_A_PIPE = (0.5, 0.7)  # the edge of a box has air on one of two sides
# Share of a pipe's length beside which rays show air or none; of a box fitted as a pipe, only the corners.
_KNOWN_OF_IT = (0.25, 0.5)
_SPREADS = (np.radians(1.8), np.radians(3.2))  # deviation of an axis rated 1, and of one rated 0 [rad]
_SURE = 0.8  # least confidence of a sure wheel with a hint, which raises confidences
_BESIDE = 0.05
_RIM_NOISE = 0.02
# A face behind a lever: from which share of the lever on it is looked for, how far beside and behind the lever [m], the
# least slope of rays, the least share of rays that end on it, and the factor on the confidence.
_FAR_HALF, _FACE_BESIDE, _FACE_BEHIND = 0.4, (0.03, 0.07), (0.02, 0.095)
_FACE_SLOPE, _FACE_SHARE, _BEFORE_FACE = 0.3, 0.8, 0.3


@dataclass(frozen=True)
class _Lever:
    """Lever valve: the fitted lever, its joint with the pipe, and the confidence."""

    fitted: FittedBar
    bar: Bar
    joint: LeverJoint
    confidence: float


def detect_lever_valve(
    view: View,
    hint: Float[np.ndarray, "3"] | None = None,
    foreground: Foreground | None = None,
    wheels: Sequence[Detection] = (),
) -> list[Detection]:
    """Find lever valves, best first; origin the pivot, z the pivot's axis to the sensor, x along the lever.

    The pivot's axis is perpendicular to lever and pipe.  Where these cross, the pivot lies at their closest approach;
    where they are parallel, at the end of the lever behind which no rays pass.

    Args:
        hint: (3,) a point near the valve: only points within 0.6 m of it are searched [m].
        wheels: wheels whose points are no levers.
    """
    if not len(view.obstacles):
        return []
    foreground = foreground or Foreground.of(view)
    valves: list[_Lever] = []
    with threadpool_limits(limits=1, user_api="blas"):
        apart_from = replace(foreground, points=foreground.points[~_on_any(wheels, foreground.points)])
        levers = find_levers(apart_from, view.floor, hint)
        pipes = find_pipes(foreground, view.floor, hint) if levers else []
        for lever in levers:
            valves += [
                valve for pipe in pipes if (valve := _join(lever, pipe, foreground.index, view.floor)) is not None
            ]
    valves.sort(key=lambda valve: -valve.confidence)
    apart: list[_Lever] = []
    for valve in valves:
        if all(np.linalg.norm(valve.bar.middle - other.bar.middle) > 0.1 for other in apart):
            apart.append(valve)
    detections = [_as_detection(valve, hint is not None) for valve in apart]
    if hint is None:
        detections = [_doubt_before_face(valve, foreground.index) for valve in detections]
    return [valve for valve in detections if valve.confidence >= _REPORTED]


def _doubt_before_face(valve: Detection, index: SightIndex) -> Detection:
    """Return the detection, less sure if the rays beside the lever end on a face close behind it: a switch's box."""
    pose, length = valve.pose_world_object, valve.sizes["lever_length"]
    along = np.linspace(_FAR_HALF, 1.0, 5) * length
    rays = index.passing(pose[:3, 3] + along[:, None] * pose[:3, 0], _FACE_BESIDE[1])
    slope = rays.direction @ pose[:3, 2]
    rays, slope = rays.select(slope < -_FACE_SLOPE), slope[slope < -_FACE_SLOPE]
    crossing = -((rays.start - pose[:3, 3]) @ pose[:3, 2]) / slope
    place = (rays.start + crossing[:, None] * rays.direction - pose[:3, 3]) @ pose[:3, :2]
    behind = -((rays.ends - pose[:3, 3]) @ pose[:3, 2])
    beside = (np.abs(place[:, 1]) > _FACE_BESIDE[0]) & (np.abs(place[:, 1]) < _FACE_BESIDE[1])
    beside &= (place[:, 0] > _FAR_HALF * length) & (place[:, 0] < length) & (behind > _FACE_BEHIND[0])
    if not beside.any() or (behind[beside] < _FACE_BEHIND[1]).mean() < _FACE_SHARE:
        return valve
    return replace(valve, confidence=_BEFORE_FACE * valve.confidence)


def _join(lever: FittedBar, pipe: FittedBar, index: SightIndex, floor: FloorPlane | None) -> _Lever | None:
    """Return the valve of a lever and a pipe; None when their sizes or positions do not fit."""
    joint = joint_of(lever.bar, pipe.bar, (lever.fit.spread[0], pipe.fit.spread[0]), index)
    if joint is None:
        return None
    confidence = (
        rising(lever.evidence.solid, 0.6, 0.85)
        * rising(lever.evidence.air, 0.15, 0.4)
        * rising(lever.evidence.visible, 0.6, 0.85)
        * rising(-lever.evidence.rms, -0.02, -0.016)
        * rising(float(lever.evidence.n_hits), 12.0, 40.0)
        * rising(pipe.evidence.solid, 0.5, 0.75)
        * rising(pipe.evidence.air, *_AIR_ABOUT_A_PIPE)
        * rising(pipe.evidence.known, *_KNOWN_OF_IT)
    )
    if confidence * _as_a_lever(joint.pivot, lever.bar.half[0]) < _HOPELESS:
        return None
    both = settle_joint(lever.bar, pipe.bar, joint.pivot.along, joint.axis, index, floor)
    tilts = [(new or old).spread[0] for new, old in zip(both.fits, (lever.fit, pipe.fit), strict=True)]
    again = joint_of(both.lever, both.pipe, (tilts[0], tilts[1]), index)
    if again is None or (again.pivot.far > again.pivot.along) != (joint.pivot.far > joint.pivot.along):
        return None
    far_seen = both.is_seen and lever.ends.seen[joint.pivot.far == lever.bar.last]
    confidence *= _as_a_lever(again.pivot, both.lever.half[0]) * (1.0 if far_seen else _END_UNSEEN)
    return _Lever(lever, both.lever, again, float(confidence * rising(-again.spread, -_SPREADS[1], -_SPREADS[0])))


def _as_a_lever(pivot: Pivot, radius: float) -> float:
    """Return the rating of a bar as a lever, 0 to 1: long enough, slim, held at one end."""
    length = abs(pivot.far - pivot.along)
    return rising(length, LENGTHS[0], LENGTHS[0] + 0.03) * rising(length / radius, *_SLIM) * pivot.confidence


def _as_detection(valve: _Lever, is_hinted: bool) -> Detection:
    """Return the valve as a detection: pose at the pivot, sizes, residuals and points of the lever."""
    bar, pivot = valve.bar, valve.joint.pivot
    x = np.sign(pivot.far - pivot.along) * bar.axis
    z = valve.joint.axis - (valve.joint.axis @ x) * x
    z /= np.linalg.norm(z)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, cross(z, x), z])
    pose[:3, 3] = bar.centre + pivot.along * bar.axis
    sizes = {"lever_length": abs(pivot.far - pivot.along), "lever_radius": bar.half[0]}
    residuals = {
        "rms": valve.fitted.evidence.rms,
        "solid_share": valve.fitted.evidence.solid,
        "air_share": valve.fitted.evidence.air,
        "pivot_score": pivot.confidence,
        "n_hits": float(valve.fitted.evidence.n_hits),
        "axis_rad": valve.joint.spread,
    }
    confidence = float(np.sqrt(valve.confidence)) if is_hinted else valve.confidence
    return Detection("valve", pose, sizes, confidence, residuals, bar.places(0.01))


def detect_valve(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find valves, best first: those with ``outer_radius`` are wheels, those with ``lever_length`` are levers."""
    if not len(view.obstacles):
        return []
    foreground = Foreground.of(view)
    wheels = [valve.as_detection() for valve in find_wheels(view, hint, foreground)]
    sure = [wheel for wheel in wheels if wheel.confidence >= (CONFIDENT if hint is None else _SURE)]
    # Spokes and rim segments look like levers, and round parts near a lever look like wheels.
    levers = [
        lever
        for lever in detect_lever_valve(view, hint, foreground, sure)
        if not any(_is_part_of(lever, wheel) for wheel in sure)
    ]
    others = [wheel for wheel in wheels if not any(_is_about(wheel, lever) for lever in levers)]
    return sorted([*others, *levers], key=lambda hit: -hit.confidence)


def _on_any(wheels: Sequence[Detection], points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Return which points lie in the rim's disc of a wheel."""
    mask = np.zeros(len(points), dtype=bool)
    for wheel in wheels:
        local = (points - wheel.pose_world_object[:3, 3]) @ wheel.pose_world_object[:3, :3]
        mask |= (np.hypot(*local.T[:2]) < wheel.sizes["outer_radius"] + _RIM_NOISE) & (np.abs(local[:, 2]) < _BESIDE)
    return mask


def _is_part_of(lever: Detection, wheel: Detection) -> bool:
    apart = np.linalg.norm(lever.pose_world_object[:3, 3] - wheel.pose_world_object[:3, 3])
    return bool(apart < wheel.sizes["outer_radius"] + _BESIDE)


def _is_about(wheel: Detection, lever: Detection) -> bool:
    """Return whether a wheel of lower confidence than the lever overlaps it."""
    pose, length = lever.pose_world_object, lever.sizes["lever_length"]
    offset = wheel.pose_world_object[:3, 3] - pose[:3, 3]
    along = float(np.clip(offset @ pose[:3, 0], 0.0, length))
    apart = float(np.linalg.norm(offset - along * pose[:3, 0]))
    return wheel.confidence < lever.confidence and apart < wheel.sizes["outer_radius"] + _BESIDE
