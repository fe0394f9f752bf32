"""Detection of lever valves: a slim bar with a free end, held before a pipe at its other end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from perception.clean import voxel_downsample
from perception.detect.bar_evidence import Ends, Evidence, find_ends, weigh_bar
from perception.detect.bar_fit import fit_bars
from perception.detect.bar_search import rays_about
from perception.detect.bar_starts import Run, misfits, run_of, sample_about, starts_about
from perception.detect.bars import Bar, SurroundingRays
from perception.detect.confidence import rising
from perception.detect.detection import Detection
from perception.detect.faces import Face, face_rays
from perception.detect.foreground import Foreground
from perception.detect.lever_pivot import Pivot, find_pivot
from perception.detect.lines import Line, find_lines
from perception.detect.sightlines import SightIndex
from perception.detect.vectors import cross
from perception.floor import FloorPlane
from perception.view import View

_VOXEL = 0.015
_HINT_RADIUS = 0.6
_LEVER_TUBE, _PIPE_TUBES = (0.022,), (0.04, 0.065)
_LEVER_RADII = ((0.008, 0.008), (0.013, 0.013), (0.02, 0.02))
_PIPE_RADII = ((0.025, 0.025), (0.045, 0.045), (0.07, 0.07))
_LENGTHS = (0.1, 0.5)
_LEAST_PIPE = 0.25
_MOST_LEVERS, _MOST_PIPES = 14, 6
_APART = (0.04, 0.25)
_PARALLEL_DEG = 20.0
_PIVOT_FROM_END = 0.06
_REPORTED = 0.05
_SLIM = (5.5, 8.5)  # length by radius; a hose's coupling on its standpipe is stouter
# A lever along its pipe: the body hides the gap behind it, and the axis was found to be up to 6 degrees off.
_ALONG = 0.45


@dataclass(frozen=True)
class _Fitted:
    """A round bar with its ends and what speaks for it."""

    ends: Ends
    evidence: Evidence

    @property
    def bar(self) -> Bar:
        return self.ends.bar


@dataclass(frozen=True)
class _Lever:
    """A lever on a pipe."""

    fitted: _Fitted
    axis: Float[np.ndarray, "3"]
    pivot: Pivot
    confidence: float


def detect_lever_valve(
    view: View, hint: Float[np.ndarray, "3"] | None = None, foreground: Foreground | None = None
) -> list[Detection]:
    """Lever valves, best first; origin the pivot, z the pivot's axis to the sensor, x along the lever.

    The pivot's axis is square to lever and pipe; where these cross, the pivot lies where they come nearest to each
    other, and otherwise at the end behind which rays do not pass.

    Args:
        view: the scan, made ready.
        hint: (3,) a point near the valve: only what lies within 0.6 m of it is looked at [m].
        foreground: of the view, where it is at hand.
    """
    if not len(view.obstacles):
        return []
    foreground = foreground or Foreground.of(view)
    index, rng = foreground.index, foreground.generator()
    points, _ = voxel_downsample(foreground.near(hint, _HINT_RADIUS), _VOXEL)
    found: list[_Lever] = []
    with threadpool_limits(limits=1, user_api="blas"):
        levers = _levers(points, index, view.floor, rng)
        pipes = _pipes(points, index, view.floor, rng) if levers else []
        for lever in levers:
            found += [one for pipe in pipes if (one := _joined(lever, pipe, index)) is not None]
    found.sort(key=lambda one: -one.confidence)
    apart: list[_Lever] = []
    for one in found:
        if all(np.linalg.norm(one.fitted.bar.middle - other.fitted.bar.middle) > 0.1 for other in apart):
            apart.append(one)
    detections = [_as_detection(one, hint is not None) for one in apart]
    return [one for one in detections if one.confidence >= _REPORTED]


def _levers(
    points: Float[np.ndarray, "N 3"], index: SightIndex, floor: FloorPlane | None, rng: np.random.Generator
) -> list[_Fitted]:
    """Slim bars with air about them and at least one end that was seen."""
    lines = find_lines(points, rng, _LEVER_TUBE, _LENGTHS[0])
    short = [line for line in lines if line.last - line.first < 1.5 * _LENGTHS[1]]
    fitted = [_fitted(line, index, floor, _LEVER_RADII, 0.03) for line in short[:_MOST_LEVERS]]
    return [
        one
        for one in fitted
        if one is not None
        and _LENGTHS[0] < one.bar.length < _LENGTHS[1]
        and one.bar.half[0] < 0.028
        and one.evidence.solid > 0.5
        and any(one.ends.seen)
    ]


def _pipes(
    points: Float[np.ndarray, "N 3"], index: SightIndex, floor: FloorPlane | None, rng: np.random.Generator
) -> list[_Fitted]:
    """Longer and thicker round bars."""
    lines = find_lines(points, rng, _PIPE_TUBES, _LEAST_PIPE)
    fitted = [_fitted(line, index, floor, _PIPE_RADII, 0.09) for line in lines[:_MOST_PIPES]]
    return [one for one in fitted if one is not None and one.bar.half[0] > 0.015 and one.evidence.rms < 0.025]


def _fitted(
    line: Line, index: SightIndex, floor: FloorPlane | None, radii: tuple[tuple[float, float], ...], tube: float
) -> _Fitted | None:
    """A round bar about a line, fitted, cut to its ends and fitted again."""
    run = Run(line.place, line.axis, line.first, line.last)
    for _ in range(2):
        rays = rays_about(index, run, 0.1, floor)
        bar = _best(rays, run, radii, tube)
        if bar is None:
            return None
        ends = find_ends(rays, bar)
        if ends.bar.length < _LENGTHS[0]:
            return None
        run = run_of(ends.bar)
    return _Fitted(ends, weigh_bar(rays, ends.bar))


def _best(rays: SurroundingRays, run: Run, radii: tuple[tuple[float, float], ...], tube: float) -> Bar | None:
    """The round bar that explains best what is seen about a run."""
    sample = sample_about(rays, run, tube, 400)
    if sample is None:
        return None
    fits = fit_bars(rays, starts_about(sample, run, radii, "round", len(radii)), 400)
    return fits[int(np.argmin(misfits(sample, [fit.bar for fit in fits])))].bar


def _joined(lever: _Fitted, pipe: _Fitted, index: SightIndex) -> _Lever | None:
    """A bar and a pipe as a valve; None when they do not lie as lever and pipe do."""
    bar, other = lever.bar, pipe.bar
    if other.half[0] < 1.2 * bar.half[0] or other.length < bar.length:
        return None
    cosine = float(bar.axis @ other.axis)
    is_parallel = abs(cosine) > np.cos(np.radians(_PARALLEL_DEG))
    between = bar.middle - other.centre
    if is_parallel:
        axis = between - (between @ bar.axis) * bar.axis
        nearest = 0.0
    else:
        axis = cross(bar.axis, other.axis)
        axis *= np.sign(axis @ between) or 1.0
        # Where the bar's line comes nearest to the pipe's.
        offset = bar.centre - other.centre
        nearest = float((cosine * (offset @ other.axis) - offset @ bar.axis) / (1.0 - cosine**2))
    apart = float(np.linalg.norm(axis)) if is_parallel else abs(float(between @ axis) / float(np.linalg.norm(axis)))
    axis = axis / np.linalg.norm(axis)
    along_pipe = float((bar.centre + nearest * bar.axis - other.centre) @ other.axis)
    if not _APART[0] + other.half[0] < apart + 0.02 or apart > _APART[1]:
        return None
    if not other.first - 0.1 < along_pipe < other.last + 0.1:
        return None
    pivot = _pivot(bar, axis, apart - 0.8 * other.half[0], index)
    if not is_parallel:
        ends = np.array([bar.first, bar.last])
        k = int(np.argmin(np.abs(ends - nearest)))
        if abs(ends[k] - nearest) > _PIVOT_FROM_END or (nearest - ends[k]) * (1 - 2 * k) < -0.02:
            return None
        # Where they cross tells the pivot better than what is seen behind the bar.
        clear = pivot.confidence if pivot.far == ends[1 - k] else 0.0
        pivot = replace(pivot, along=nearest, far=float(ends[1 - k]), confidence=clear)
    far_seen = lever.ends.seen[1 if pivot.far == bar.last else 0]
    confidence = (
        rising(lever.evidence.solid, 0.6, 0.85)
        * rising(lever.evidence.air, 0.15, 0.4)
        * rising(lever.evidence.visible, 0.6, 0.85)
        * rising(-lever.evidence.rms, -0.02, -0.016)
        * rising(float(lever.evidence.n_hits), 12.0, 40.0)
        * rising(pipe.evidence.solid, 0.5, 0.75)
        * rising(pipe.evidence.air, 0.3, 0.6)
        * rising(abs(pivot.far - pivot.along), _LENGTHS[0], _LENGTHS[0] + 0.03)
        * rising(abs(pivot.far - pivot.along) / bar.half[0], *_SLIM)
        * (1.0 if far_seen else 0.4)
        * (_ALONG if is_parallel else 1.0)
        * pivot.confidence
    )
    return _Lever(lever, axis, pivot, float(confidence))


def _pivot(bar: Bar, axis: Float[np.ndarray, "3"], gap: float, index: SightIndex) -> Pivot:
    """Where the bar is held over the pipe's near side, as if that were a face."""
    z = axis - (axis @ bar.axis) * bar.axis
    z /= np.linalg.norm(z)
    half = 0.5 * bar.length
    face = Face(
        np.stack([bar.axis, cross(z, bar.axis), z]),
        bar.middle - gap * z,
        np.array([-half, -0.04]),
        np.array([half, 0.04]),
        0.008,
    )
    return find_pivot(face, face_rays(face, index, 0.06), bar)


def _as_detection(one: _Lever, is_hinted: bool) -> Detection:
    """The valve in the words all detectors share."""
    bar, pivot = one.fitted.bar, one.pivot
    x = np.sign(pivot.far - pivot.along) * bar.axis
    z = one.axis - (one.axis @ x) * x
    z /= np.linalg.norm(z)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, cross(z, x), z])
    pose[:3, 3] = bar.centre + pivot.along * bar.axis
    sizes = {"lever_length": abs(pivot.far - pivot.along), "lever_radius": bar.half[0]}
    residuals = {
        "rms": one.fitted.evidence.rms,
        "solid_share": one.fitted.evidence.solid,
        "air_share": one.fitted.evidence.air,
        "pivot_score": pivot.confidence,
        "n_hits": float(one.fitted.evidence.n_hits),
    }
    confidence = float(np.sqrt(one.confidence)) if is_hinted else one.confidence
    return Detection("valve", pose, sizes, confidence, residuals, bar.places(0.01))
