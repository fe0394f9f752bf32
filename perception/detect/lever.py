"""Detection of levers on walls, boxes and door leaves: a slim bar in front of a face, held at one end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage
from threadpoolctl import threadpool_limits

from perception.detect.shared.arithmetic import rising
from perception.detect.shared.bar_ends import LikelyEnds, likely_ends
from perception.detect.shared.bar_evidence import BarEvidence, weigh_bar
from perception.detect.shared.bar_fit import fit_bars
from perception.detect.shared.bar_pivot import Pivot, face_behind, find_pivot, free_end
from perception.detect.shared.bar_starts import Run, misfits, sample_about, starts_about
from perception.detect.shared.bars import Bar, SurroundingRays
from perception.detect.shared.detection import Detection
from perception.detect.shared.faces import Face, FaceRays, FacesInSight, face_rays
from perception.sightlines import SightIndex
from perception.view import View

_STAND_OFF = (0.028, 0.13)
_LENGTHS = (0.06, 0.45)
_CELL = 0.015
_BEYOND = 0.12
_ALL_RAYS = 100_000  # about a bar
_SLIM = 0.5
_RADII = ((0.008, 0.008), (0.013, 0.013), (0.02, 0.02))
_TUBE = 0.04
_FEWEST = 8
_REPORTED = 0.05
_HINT_RADIUS = 0.5
_PIVOT = (0.3, 0.85)
_GOES_ON = 0.4  # factor for a bar with an unseen end: perhaps an edge, a rail, or cut off by the field of view


@dataclass(frozen=True)
class _Found:
    """Bar in front of a face and its evidence; ``confidence`` does not include the pivot's."""

    face: Face
    ends: LikelyEnds
    evidence: BarEvidence
    pivot: Pivot
    confidence: float


def detect_lever(view: View, hint: Float[np.ndarray, "3"] | None, seen: FacesInSight) -> list[Detection]:
    """Find levers, best first; origin the pivot, z the pivot's axis to the sensor, x along the lever.

    The pivot is at the end where rays end between bar and face, if they pass at the other.  The confidence is high
    only where rays passed both ends of the bar.

    Args:
        hint: (3,) a point near the lever [m]; with it weaker evidence is enough.
    """
    if not len(view.obstacles):
        return []
    levers: list[_Found] = []
    with threadpool_limits(limits=1, user_api="blas"):
        for face in seen.faces:
            rays = face_rays(face, seen.index, _BEYOND)
            for run in _runs(face, rays, hint):
                lever = _examine(face, rays, run, seen.index)
                if lever is not None:
                    levers.append(lever)
    levers.sort(key=lambda lever: -lever.confidence * lever.pivot.confidence)
    apart: list[_Found] = []
    for lever in levers:
        if all(np.linalg.norm(lever.ends.bar.middle - other.ends.bar.middle) > 0.08 for other in apart):
            apart.append(lever)
    detections = [_as_detection(lever, hint is not None) for lever in apart]
    return [lever for lever in detections if lever.confidence >= _REPORTED]


def _runs(face: Face, seen: FaceRays, hint: Float[np.ndarray, "3"] | None) -> list[Run]:
    """Return the axes of slim connected clusters of points in front of a face."""
    height = seen.ends[:, 2]
    proud = (height > max(_STAND_OFF[0], 2.8 * face.sigma)) & (height < _STAND_OFF[1])
    points = seen.ends[proud]
    if hint is not None and len(points):
        points = points[np.linalg.norm(face.world(points) - hint, axis=1) < _HINT_RADIUS]
    if len(points) < _FEWEST:
        return []
    runs = []
    for members in _connect(points[:, :2]):
        flat = points[members, :2]
        centre = flat.mean(axis=0)
        _, vectors = np.linalg.eigh(np.cov((flat - centre).T))
        local = (flat - centre) @ vectors
        low, high = np.percentile(local, [3, 97], axis=0)
        width, length = high - low
        if not (_LENGTHS[0] < length < 1.2 * _LENGTHS[1] and width < _SLIM * length + 0.02):
            continue
        axis = np.append(vectors[:, 1], 0.0) @ face.frame
        place = face.world(np.append(centre, np.median(points[members, 2]))[None])[0]
        runs.append(Run(place, axis, float(low[1]), float(high[1])))
    return runs


def _connect(flat: Float[np.ndarray, "N 2"]) -> list[Int[np.ndarray, "K"]]:
    """Return indices of the points of the six largest connected patches, largest first."""
    cells = np.floor((flat - flat.min(axis=0)) / _CELL).astype(int)
    grid = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    grid[tuple(cells.T)] = True
    labels, n_labels = ndimage.label(
        ndimage.binary_dilation(grid, np.ones((3, 3), dtype=bool)), structure=np.ones((3, 3))
    )
    of_point = labels[tuple(cells.T)]
    patches = [np.flatnonzero(of_point == k) for k in range(1, n_labels + 1)]
    return sorted((patch for patch in patches if len(patch) >= _FEWEST), key=lambda patch: -len(patch))[:6]


def _examine(face: Face, seen: FaceRays, run: Run, index: SightIndex) -> _Found | None:
    """Return the round bar fitted about a run, with its ends, pivot and confidence; None if rejected.

    Args:
        seen: rays to the face, thinned.
        index: of all rays: which end is held shows in few of them, so that a thinned sample would decide by chance.
    """
    rays = SurroundingRays(
        seen.rays.start, seen.rays.direction, seen.rays.length, np.abs(seen.ends[:, 2]) < 2.0 * face.sigma
    )
    bar = _fit(rays, run)
    if bar is None:
        return None
    ends = likely_ends(rays, bar, None)
    again = _fit(rays, Run(ends.bar.centre, ends.bar.axis, ends.bar.first, ends.bar.last))
    if again is not None:
        ends = likely_ends(rays, again, None)
    bar = ends.bar
    if not _LENGTHS[0] < bar.length < _LENGTHS[1]:
        return None
    evidence = weigh_bar(rays, bar)
    about = _rays_about(face, bar, index)
    pivot = find_pivot(face, about, bar)
    length = abs(pivot.far - pivot.along)
    level = abs(float(bar.axis @ face.frame[2]))
    confidence = (
        rising(evidence.solid, 0.55, 0.85)
        * rising(evidence.air, 0.35, 0.65)
        * rising(evidence.visible, 0.5, 0.8)
        * rising(-evidence.rms, -0.02, -0.015)
        * rising(float(evidence.n_hits), 8.0, 30.0)
        * rising(-level, -0.4, -0.25)
        * rising(length / bar.half[0], 4.0, 7.0)
        * rising(-bar.half[0], -0.03, -0.024)
        * rising(pivot.stand_off - bar.half[0], 0.008, 0.02)
        * (1.0 if all(ends.seen) else _GOES_ON)
        * free_end(face, about, bar, pivot)
        * face_behind(face, about, bar.centre + pivot.along * bar.axis)
    )
    return _Found(face, ends, evidence, pivot, float(confidence))


def _rays_about(face: Face, bar: Bar, index: SightIndex) -> FaceRays:
    """Return all rays to a face about a bar."""
    ends = face.local(bar.centre + np.array([[bar.first], [bar.last]]) * bar.axis)[:, :2]
    return face_rays(replace(face, low=ends.min(axis=0), high=ends.max(axis=0)), index, _BEYOND, _ALL_RAYS)


def _fit(rays: SurroundingRays, run: Run) -> Bar | None:
    """Return the round bar of least misfit to the rays about a run; None: too few points."""
    sample = sample_about(rays, run, _TUBE, 400)
    if sample is None:
        return None
    starts = starts_about(sample, run, _RADII, "round", 4)
    fits = fit_bars(rays, starts, 400)
    return fits[int(np.argmin(misfits(sample, [fit.bar for fit in fits])))].bar


def _as_detection(lever: _Found, is_hinted: bool) -> Detection:
    """Return the lever as a :class:`Detection`."""
    bar, pivot, face = lever.ends.bar, lever.pivot, lever.face
    z = face.frame[2]
    x = np.sign(pivot.far - pivot.along) * bar.axis
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    pose[:3, 3] = bar.centre + pivot.along * bar.axis
    sizes = {"length": abs(pivot.far - pivot.along), "radius": bar.half[0]}
    residuals = {
        "rms": lever.evidence.rms,
        "solid_share": lever.evidence.solid,
        "air_share": lever.evidence.air,
        "visible_share": lever.evidence.visible,
        "pivot_score": pivot.confidence,
        "stand_off": pivot.stand_off,
        "n_hits": float(lever.evidence.n_hits),
    }
    sure = (
        np.sqrt(lever.confidence * pivot.confidence)
        if is_hinted
        else lever.confidence * rising(pivot.confidence, *_PIVOT)
    )
    return Detection("lever", pose, sizes, float(sure), residuals, bar.places(0.01))
