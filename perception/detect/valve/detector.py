"""Detection of valves of either kind: wheels and levers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from perception.detect.shared.arithmetic import rising
from perception.detect.shared.bar_search import rays_about, rivalry
from perception.detect.shared.bar_starts import run_of
from perception.detect.shared.bars import Bar
from perception.detect.shared.detection import CONFIDENT, Detection
from perception.detect.valve.close_levers import find_close_levers, join_close
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.lever_bars import FittedBar, find_levers, find_pipes, fit_again
from perception.detect.valve.lever_joint import LeverJoint, are_parallel, joint_of, settle_lever, settle_pipe
from perception.detect.valve.lever_on_pipe import END_UNSEEN, SPREADS, LeverOnPipe, rate_lever, rate_pipe, rate_pivot
from perception.detect.valve.lever_valve import LeverDetection, find_grip, is_about_grip
from perception.detect.valve.wheel import detect_wheels, find_wheels
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex, index_of
from perception.view import View

_REPORTED, _HOPELESS = 0.05, 0.02
_SURE_END = 0.9  # confidence of a pivot that needs no grip to show it, or is shown by one
# Sections of boxes that are compared with a pipe, as half sizes [m], and the share of its misfit by which a box may
# explain the rays better: a handle on a switch box is no lever valve.
_BOXES = ((0.025, 0.0125), (0.03, 0.03), (0.06, 0.03), (0.06, 0.06), (0.1, 0.05), (0.11, 0.11))
_BETTER_AS_BOX = (0.04, 0.12)
_BEYOND_PIPE = 0.1
_SURE = 0.9  # least confidence of a sure wheel with a hint, which raises confidences
_BESIDE = 0.05
_RIM_NOISE = 0.02


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
    valves: list[LeverOnPipe] = []
    with threadpool_limits(limits=1, user_api="blas"):
        apart_from = replace(foreground, points=foreground.points[~_on_any(wheels, foreground.points)])
        levers = find_levers(apart_from, view.floor, hint)
        pipes = find_pipes(foreground, view.floor, hint)
        for lever in levers:
            valves += [valve for pipe in pipes if (valve := _join(lever, pipe, foreground.index, view)) is not None]
        for lever, pipe in find_close_levers(pipes, apart_from, view.floor):
            if (valve := join_close(lever, pipe, foreground.index, view.floor)) is not None:
                valves.append(valve)
        valves = _rate_pipes(valves, foreground.index, view.floor)
    valves.sort(key=lambda valve: -valve.confidence)
    apart: list[LeverOnPipe] = []
    for valve in valves:
        if all(np.linalg.norm(valve.bar.middle - other.bar.middle) > 0.1 for other in apart):
            apart.append(valve)
    with threadpool_limits(limits=1, user_api="blas"):
        settled = [_settle_crank(valve, view, foreground.index) for valve in apart]
    detections = [_as_detection(*valve, is_hinted=hint is not None) for valve in settled]
    return [valve for valve in detections if valve.confidence >= _REPORTED]


def _join(
    lever: FittedBar, pipe: FittedBar, index: SightIndex, view: View, *, has_grip: bool = False
) -> LeverOnPipe | None:
    """Return the valve of a lever and a pipe; None when their sizes or positions do not fit.

    Args:
        has_grip: whether a grip shows where the lever ends.
    """
    tilts = (lever.fit.spread[0], pipe.fit.spread[0])
    noise = lever.evidence.rms
    joint = _find_joint(lever.bar, pipe.bar, tilts, noise, index, view)
    if joint is None:
        return None
    confidence = rate_lever(lever) * rate_pipe(pipe)
    if confidence * rate_pivot(joint.pivot, lever.bar.half[0]) < _HOPELESS:
        return None
    place = lever.bar.centre + joint.pivot.along * lever.bar.axis
    own = settle_lever(lever.bar, joint.pivot.along, joint.axis, index, view.floor)
    other = settle_pipe(pipe.bar, place, index, view.floor)
    tilts = (own.fit or lever.fit).spread[0], (other.fit or pipe.fit).spread[0]
    again = _find_joint(own.bar, other.bar, tilts, noise, index, view)
    if again is None or (again.pivot.far > again.pivot.along) != (joint.pivot.far > joint.pivot.along):
        return None
    far_seen = has_grip or (own.is_seen and lever.ends.seen[joint.pivot.far == lever.bar.last])
    confidence *= rate_pivot(again.pivot, own.bar.half[0]) * (1.0 if far_seen else END_UNSEEN)
    confidence *= rising(-again.spread, -SPREADS[1], -SPREADS[0])
    return LeverOnPipe(lever, own.bar, again, float(confidence), pipe)


def _find_joint(
    bar: Bar, pipe: Bar, tilts: tuple[float, float], noise: float, index: SightIndex, view: View
) -> LeverJoint | None:
    """Return the joint of a bar and a pipe; a bar along its pipe with a grip on one end is held at the other.

    Args:
        noise: standard deviation of the bar's returns along their rays [m].
    """
    joint = joint_of(bar, pipe, tilts, index)
    if joint is None or joint.pivot.confidence >= _SURE_END or not are_parallel(bar, pipe):
        return joint
    ways = (joint, joint.turn_round(bar, pipe, tilts))
    length = abs(joint.pivot.far - joint.pivot.along)
    has_grip = [find_grip(view.obstacles, way.pose(bar), length, bar.half[0], noise, index)[0] > 0.0 for way in ways]
    if has_grip[0] == has_grip[1]:
        return joint
    held = ways[int(has_grip[1])]
    return replace(held, pivot=replace(held.pivot, confidence=_SURE_END))


def _rate_pipes(valves: Sequence[LeverOnPipe], index: SightIndex, floor: FloorPlane | None) -> list[LeverOnPipe]:
    """Return the valves, less sure where a box explains the rays about their pipe better than a round section."""
    ratings: dict[int, float] = {}
    rated = []
    for valve in valves:
        pipe = valve.pipe
        if id(pipe) not in ratings:
            rays = rays_about(index, run_of(pipe.bar), _BEYOND_PIPE, floor)
            better = -rivalry(rays, pipe.bar, _BOXES, "box").share
            ratings[id(pipe)] = rising(-better, -_BETTER_AS_BOX[1], -_BETTER_AS_BOX[0])
        rating = ratings[id(pipe)]
        rated.append(replace(valve, confidence=valve.confidence * rating, pipe=replace(pipe, rating=rating)))
    return rated


def _settle_crank(valve: LeverOnPipe, view: View, index: SightIndex) -> tuple[LeverOnPipe, tuple[float, float]]:
    """Return a lever, and length and distance of the grip at its end; a crank's bar is fitted without its grip's rays.

    Rays that end on the grip would pull the bar towards it.
    """
    grip = _grip_of(valve, view, index)
    if grip[0] == 0.0:
        return valve, grip
    beside = index_of(index.rays.select(~is_about_grip(index.rays.ends, valve.pose, grip, valve.bar.half[0])))
    fitted = fit_again(valve.bar, beside, view.floor)
    again = None if fitted is None else _join(fitted, valve.pipe, beside, view, has_grip=True)
    if again is None:
        return valve, grip
    grip = _grip_of(again, view, index)
    return (again, grip) if grip[0] > 0.0 else (valve, (0.0, valve.length))


def _grip_of(valve: LeverOnPipe, view: View, index: SightIndex) -> tuple[float, float]:
    """Return length and distance of the grip at a lever's end, as ``find_grip`` does."""
    noise = valve.fitted.evidence.rms
    return find_grip(view.obstacles, valve.pose, valve.length, valve.bar.half[0], noise, index)


def _as_detection(valve: LeverOnPipe, grip: tuple[float, float], *, is_hinted: bool) -> Detection:
    """Return the valve as a detection: pose at the pivot, sizes, residuals and points of the lever.

    Args:
        grip: length of a crank's grip, 0 without one, and distance of its axis from the pivot [m].
    """
    bar, pivot, pose, length = valve.bar, valve.joint.pivot, valve.pose, valve.length
    sizes = {"lever_length": length, "lever_radius": bar.half[0]}
    if grip[0] > 0.0:
        sizes = {"lever_length": grip[1], "lever_radius": bar.half[0], "grip_length": grip[0]}
    residuals = {
        "rms": valve.fitted.evidence.rms,
        "solid_share": valve.fitted.evidence.solid,
        "air_share": valve.fitted.evidence.air,
        "pivot_score": pivot.confidence,
        "n_hits": float(valve.fitted.evidence.n_hits),
        "axis_rad": valve.joint.spread,
    }
    confidence = float(np.sqrt(valve.confidence)) if is_hinted else valve.confidence
    model = LeverDetection(
        pose[:3, 3], pose[:3, 2], pose[:3, 0], sizes["lever_length"], bar.half[0], confidence,
        valve.fitted.evidence.rms, int(valve.fitted.evidence.n_hits), grip_length=grip[0],
    )  # fmt: skip
    return Detection("valve", pose, sizes, confidence, residuals, bar.places(0.01), model)


def detect_turnable(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find valves that a plan can turn, best first; levers are looked for only where no wheel is sure."""
    wheels = detect_wheels(view, hint)
    if wheels and wheels[0].confidence >= (CONFIDENT if hint is None else _SURE):
        return wheels
    return detect_valve(view, hint)


def detect_valve(
    view: View, hint: Float[np.ndarray, "3"] | None = None, index: SightIndex | None = None
) -> list[Detection]:
    """Find valves, best first: those with ``outer_radius`` are wheels, those with ``lever_length`` are levers.

    Args:
        hint: (3,) a point near the valve [m].
        index: of the view's rays; None: they are indexed anew.
    """
    if not len(view.obstacles):
        return []
    foreground = Foreground.of(view, index)
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
