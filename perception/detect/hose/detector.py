"""Detection of hose ends and standpipes: open ends of tubes fitted to the rays at the ends of slender objects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from perception.cleaning.clean import voxel_downsample
from perception.detect.hose.tips import Tip, find_tips
from perception.detect.hose.tube import (
    STRAIGHT,
    Tube,
    TubeEvidence,
    misfit_of,
    refine_tube,
    settle_mouth,
    settle_tube,
    square_to,
    weigh_tube,
)
from perception.detect.shared.arithmetic import rising
from perception.detect.shared.detection import Detection
from perception.detect.shared.slender import is_flat
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex, Sightlines, sight_index
from perception.view import View

_VOXEL = 0.022
_WIDEST = 0.095
_HINT_RADIUS = 0.5
_REPORTED = 0.05
_RADII = (0.016, 0.021, 0.062, 0.075)
# Noise makes an object look wider and longer [m].
_WIDENED = (0.007, 0.017, 0.027)
_LONGER = 0.01
_BESIDE = 0.05
_DEEP = 0.03
_LEAST_OPEN = 0.4
_MOST_RAYS = 600
_FOR_RANKING = 200
_MOST_FITTED = 12
_MOST_JUDGED = 5
_ROUNDS, _STILL = 2, 0.97  # the most fits more, and the share of its misfit that a fit must save
_SAME = 0.15
_HIGHEST = 2.1
_MOST_POINTS = 200
# Share of the sectors about the axis with wall, from useless to certain: of a mouth that rays enter (relative to the
# share that its number of hits can fill), and of any end.
_ALL_ABOUT, _HALF_ABOUT = (0.6, 0.85), (0.35, 0.6)
_TO_SHOW_ALL = 24.0
# A vessel: least z of its axis, greatest height, and the band about its foot searched for a board [m].
_UPRIGHT = 0.85
_TALLEST = 0.35
_COLLAR = 1.3
_FOOT_ABOUT = (0.02, 0.1)
_NEAR_MOUTH = 0.04
_LAYER = 0.025
_N_SECTORS, _LEAST_SECTORS = 12, 5
_TURNED = np.cos(np.radians(10.0))  # the least cosine between the axes of both fits
_RAYS_INTO = (16.0, 40.0)  # rays into the middle of a mouth that show nothing, and enough to show whether it is open


@dataclass(frozen=True)
class _Candidate:
    """Tube to be fitted.

    Attributes:
        rays: rays that pass near its mouth.
        mine: (N,) rays that ended on the object the tube must explain.
        misfit: mean squared residual of these rays (:func:`misfit_of`).
    """

    tube: Tube
    rays: Sightlines
    mine: Bool[np.ndarray, "N"]
    misfit: float


@dataclass(frozen=True)
class _End:
    """Fitted open end with its evidence and confidence."""

    tube: Tube
    misfit: float
    evidence: TubeEvidence
    confidence: float


def detect_hose(
    view: View, hint: Float[np.ndarray, "3"] | None = None, index: SightIndex | None = None
) -> list[Detection]:
    """Find hose ends and standpipes, best first; origin the centre of the opening, z out of it, x horizontal.

    The size is the outer radius at the opening.  Without a hint, an end that rays do not enter
    gets a low confidence.  A vessel on a board or the floor that opens upwards is not reported.

    Args:
        hint: (3,) a point near the opening: only points within half a metre of it are searched, and hidden parts lower
            the confidence less [m].
        index: of the view's rays; None: they are indexed anew.
    """
    if not len(view.obstacles):
        return []
    index = index or sight_index(view.cloud)
    points, _ = voxel_downsample(view.obstacles, _VOXEL)
    places = points[~is_flat(points)]
    if hint is not None:
        places = places[np.linalg.norm(places - hint, axis=1) < _HINT_RADIUS]
    # Many small products: with several threads BLAS spends its time on distributing them.
    with threadpool_limits(limits=1, user_api="blas"):
        tips = [tip for tip in find_tips(points, places, _WIDEST) if _may_be_open(index, tip)]
        candidates = sorted((_candidate(index, tip) for tip in tips), key=lambda candidate: candidate.misfit)
        fitted = sorted(
            (_fit(candidate) for candidate in _drop_duplicates(candidates)[:_MOST_FITTED]),
            key=lambda candidate: candidate.misfit,
        )
        fitted = [_fit_again(candidate) for candidate in fitted[:_MOST_JUDGED]]
        ends = [
            _judge(index, candidate, hint is not None)
            for candidate in fitted
            if not _stands(points, candidate.tube, view.floor)
        ]
    ends = sorted(
        (end for end in ends if end.confidence > _REPORTED), key=lambda end: end.misfit - 2.0 * end.confidence
    )
    kept: list[_End] = []
    for end in ends:
        if all(np.linalg.norm(end.tube.mouth - other.tube.mouth) > _SAME for other in kept):
            kept.append(end)
    return [_as_detection(end) for end in kept]


def _may_be_open(index: SightIndex, tip: Tip) -> bool:
    """Return whether at least 40 % of the rays into the middle of a tip end behind it rather than at it."""
    rays = index.passing(tip.place[None], _LEAST_OPEN * tip.radius).thin(_FOR_RANKING)
    slope = rays.direction @ tip.axis
    rays, slope = rays.select(slope < -0.1), slope[slope < -0.1]
    excess = rays.length - ((tip.place - rays.start) @ tip.axis) / slope
    n_deeper, n_there = int((excess > _DEEP).sum()), int((np.abs(excess) <= _DEEP).sum())
    return n_deeper >= _LEAST_OPEN * max(1, n_deeper + n_there)


def _candidate(index: SightIndex, tip: Tip) -> _Candidate:
    """Return the tube at a tip with the radius of least misfit among those tried."""
    place = tip.place - _LONGER * tip.axis
    tubes = [Tube(place, tip.axis, max(_RADII[0], tip.radius - by)) for by in _WIDENED]
    rays = index.passing(np.stack([place, place - STRAIGHT * tip.axis]), tip.radius + 0.5 * _BESIDE)
    rays = rays.thin(_MOST_RAYS)
    offset = rays.ends - tip.place
    along = offset @ tip.axis
    across = np.linalg.norm(offset - along[:, None] * tip.axis, axis=1)
    mine = (along > -_BESIDE) & (along < 2.0 * _LONGER) & (across < tip.radius + _LONGER)
    some = np.arange(0, len(rays), max(1, len(rays) // _FOR_RANKING))
    few, of_few = rays.select(some), mine[some]
    misfit, best = min((misfit_of(few, of_few, tube), i) for i, tube in enumerate(tubes))
    return _Candidate(tubes[best], rays, np.asarray(mine), misfit)


def _drop_duplicates(candidates: list[_Candidate]) -> list[_Candidate]:
    """Drop candidates with nearly the mouth and axis of a better one."""
    kept: list[_Candidate] = []
    for candidate in candidates:
        apart = [np.linalg.norm(candidate.tube.mouth - other.tube.mouth) for other in kept]
        turned = [candidate.tube.axis @ other.tube.axis for other in kept]
        if all(a > 0.04 or t < 0.75 for a, t in zip(apart, turned, strict=True)):
            kept.append(candidate)
    return kept


def _fit(candidate: _Candidate) -> _Candidate:
    """Return the candidate with its tube fitted to its rays."""
    tube = refine_tube(candidate.rays, candidate.mine, candidate.tube)
    return replace(candidate, tube=tube, misfit=misfit_of(candidate.rays, candidate.mine, tube))


def _fit_again(candidate: _Candidate) -> _Candidate:
    """Return the candidate fitted again, as long as that lowers its misfit."""
    for _ in range(_ROUNDS):
        before = candidate.misfit
        candidate = _fit(candidate)
        if candidate.misfit > _STILL * before:
            break
    return candidate


def _stands(points: Float[np.ndarray, "N 3"], tube: Tube, floor: FloorPlane | None) -> bool:
    """Return whether the tube opens upwards at most 35 cm above a board or the floor, as pots and buckets do."""
    if tube.axis[2] < _UPRIGHT:
        return False
    if floor is not None and float(floor.above(tube.mouth[None])[0]) < _TALLEST:
        return True
    offset = points - tube.mouth
    across = np.linalg.norm(offset[:, :2], axis=1)
    low, high = _FOOT_ABOUT
    about = (across > _COLLAR * tube.radius + low) & (across < _COLLAR * tube.radius + high)
    about &= (offset[:, 2] > -_TALLEST) & (offset[:, 2] < -_NEAR_MOUTH)
    layer = np.floor(-offset[about, 2] / _LAYER).astype(np.int64)
    sector = np.floor(np.arctan2(offset[about, 1], offset[about, 0]) / np.pi * 0.5 * _N_SECTORS).astype(np.int64)
    filled = np.unique(np.column_stack([layer, sector % _N_SECTORS]), axis=0)[:, 0]
    return bool(len(filled) and np.bincount(filled).max() >= _LEAST_SECTORS)


def _judge(index: SightIndex, candidate: _Candidate, is_hinted: bool) -> _End:
    """Return the tube refined on all rays near it, with the evidence and confidence of the unrefined tube."""
    tube = candidate.tube
    rays = index.passing(np.stack([tube.mouth, tube.mouth - STRAIGHT * tube.axis]), 1.2 * tube.radius + _BESIDE)
    evidence = weigh_tube(rays, tube)
    settled = settle_tube(rays, tube)
    if settled.axis @ tube.axis < _TURNED:
        # Few returns on one side of a wall let it turn; the rays that pass or enter tell which fit is right.
        alternative = settle_mouth(rays, tube)
        misfit, other = (misfit_of(candidate.rays, candidate.mine, one) for one in (settled, alternative))
        settled = settled if misfit <= other else alternative
    return _End(settled, candidate.misfit, evidence, _confidence(tube, candidate.misfit, evidence, is_hinted))


def _confidence(tube: Tube, misfit: float, evidence: TubeEvidence, is_hinted: bool) -> float:
    """Return the product of all ratings, 0 to 1: wall, opening, free sides, depth residuals, usual radius, reach."""
    unseen = 0.8 if is_hinted else 0.4
    sure = rising(float(evidence.n_open), *_RAYS_INTO) * rising(evidence.entering, 0.2, 0.35)
    is_open = 0.0 if np.isnan(evidence.open) else rising(evidence.open, 0.5, 0.75)
    would_show = 1.0 - np.exp(-max(evidence.n_hits, 1) / _TO_SHOW_ALL)
    is_open *= rising(-evidence.stopped, -0.4, -0.2) * rising(evidence.round / would_show, *_ALL_ABOUT)
    value = (
        rising(evidence.solid, 0.6, 0.85)
        * (sure * is_open + (1.0 - sure) * unseen)
        * rising(evidence.round, *_HALF_ABOUT)
        * rising(-evidence.stray, -0.12, -0.05)
        * rising(-misfit, -5.5, -3.0)
        * rising(evidence.air, 0.5, 0.85)
        * rising(evidence.known, 0.0, 0.15)
        * rising(-evidence.rms, -0.02, -0.016)
        * rising(float(evidence.n_hits), 6.0, 20.0)
        * rising(tube.radius, *_RADII[:2])
        * rising(-tube.radius, -_RADII[3], -_RADII[2])
        * rising(-float(tube.mouth[2]), -_HIGHEST - 0.2, -_HIGHEST)
    )
    return float(value**0.7 if is_hinted else value)


def _as_detection(end: _End) -> Detection:
    z, evidence = end.tube.axis, end.evidence
    across, over = square_to(z)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([across, over, z])
    pose[:3, 3] = end.tube.mouth
    residuals = {
        "rms": evidence.rms,
        "solid_share": evidence.solid,
        "round_share": evidence.round,
        "air_share": evidence.air,
    }
    if not np.isnan(evidence.open):
        residuals["open_share"] = evidence.open
    points = evidence.points[:: max(1, len(evidence.points) // _MOST_POINTS)]
    return Detection("hose", pose, {"radius": end.tube.radius}, end.confidence, residuals, points)
