"""Detection of sawn beams (2x4 and the like) in debris: cuboids fitted to the rays about straight runs of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from perception.cleaning.clean import voxel_downsample
from perception.detect.beam.strips import Strip, find_strips, straight_parts
from perception.detect.shared.arithmetic import cross, rising
from perception.detect.shared.bar_ends import LikelyEnds, likely_ends
from perception.detect.shared.bar_evidence import BarEvidence, weigh_bar
from perception.detect.shared.bar_fit import BarFit, spread_between_edges
from perception.detect.shared.bar_search import Choice, Rivalry, Stock, choose_bar, rays_about, rivalry
from perception.detect.shared.bar_starts import Run, run_of
from perception.detect.shared.bars import Bar, SurroundingRays
from perception.detect.shared.detection import Detection
from perception.ground.floor import FloorPlane, on_floors
from perception.sightlines import SightIndex, sight_index
from perception.view import View

# Half sizes [m]: 2x4, 4x4, 2x6 and 2x2 inches as planed.  Fits begin at these, and reach metric sizes as well: 40x60,
# 100x100 and 22x140 mm.
_TIMBER = Stock("box", ((0.0445, 0.019), (0.0445, 0.0445), (0.07, 0.019), (0.019, 0.019)), rarity=(0.0, 4.0, 4.0, 12.0))
_METRIC = ((0.03, 0.02), (0.05, 0.05), (0.07, 0.011))
_PIPES = ((0.02, 0.02), (0.03, 0.03), (0.045, 0.045))
_VOXEL = 0.015
_LEAST_LENGTH, _LEAST_HALF = 0.25, 0.0065
_TUBE = 0.1
_BEHIND, _BEYOND = 0.015, 0.15
_HIDDEN_STRETCH, _MOST_LOOKS = 0.6, 3
_LEAST_AIR, _LEAST_KNOWN = 0.1, 0.15
# Air beside the first bar fitted to a strip, and its misfit, with which no later fit was ever a beam.
_SOME_AIR, _MISFIT = 0.15, 7.5
_HALF_A_FACE, _WIDER = 0.06, 0.025
_LEAST_SOLID, _KNOWN, _VISIBLE, _HITS = 0.55, (0.2, 0.5), (0.25, 0.6), (20.0, 80.0)
_SHORT = 0.7
_END_UNSEEN = 0.85  # factor per unseen end; a short bar may continue out of sight
_MOST_FITS, _STAYS, _FITTED_TO = 3, 0.04, 400
_NEAR_BAR = 0.02
_IN_LINE, _OFF_LINE, _APART = 0.995, 0.04, 0.3
_SAME_PLACE = 0.03
_STRIPS = (28, 14)  # in each round
_HINT_RADIUS = 0.7
_REPORTED = 0.05
_EXPLAINS, _SURE = 0.25, 0.5
_LARGEST_STEP = 1.0  # [m^2]
_OVER_FLOOR = 0.03
_IN_FLOOR = (0.02, 0.035)
_DOUBTFUL = 0.55  # lowered by this share where the place of the centre is doubtful by 3 cm: never enough to act on
# A bar this near to the vertical is a post or a table's leg: loose timber does not stand.
_UPRIGHT, _POST = np.radians((4.0, 7.0)), 0.4
_MOST_POINTS = 200
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class _Beam:
    """Fitted cuboid and its evidence."""

    fit: BarFit
    ends: LikelyEnds
    doubt: float
    evidence: BarEvidence
    flatter: Rivalry
    confidence: float
    points: Float[np.ndarray, "K 3"]

    @property
    def bar(self) -> Bar:
        """Bar cut at its most likely ends."""
        return self.ends.bar

    @property
    def hidden(self) -> float:
        """Length by which the bar may be longer, both ends together [m]."""
        return sum(self.ends.hidden)


def detect_beam(
    view: View, hint: Float[np.ndarray, "3"] | None = None, index: SightIndex | None = None
) -> list[Detection]:
    """Find beams, best first; origin the centre, x along the length, z along the smallest side.

    Sizes are length, width and thickness.  A beam with one visible face may be thicker than fitted: the residual
    ``doubt`` is the possible error of its centre [m].  Where another object hides its ends, ``hidden_length`` is the
    length by which it may be longer [m], and the confidence is low.  So is that of a bar that stands upright.  An end
    hidden along up to 20 cm is set to the middle of the hidden stretch, so the beam may also be shorter by as much.
    With a longer hidden stretch the length is the visible one, and ``hidden_length`` is 10 cm.

    Args:
        hint: (3,) a point near the beam [m]; only points within 0.7 m of it are searched.
        index: of the view's rays; None: they are indexed anew.
    """
    if not len(view.obstacles):
        return []
    rng = np.random.default_rng(0)
    index = index or sight_index(view.cloud)
    points, _ = voxel_downsample(loose_points(view), _VOXEL)
    if hint is not None:
        points = points[np.linalg.norm(points - hint, axis=1) < _HINT_RADIUS]
    beams: list[_Beam] = []
    # The fits are many and small: with several threads the overhead of BLAS dominates.
    with threadpool_limits(limits=1, user_api="blas"):
        known: list[Bar] = []
        tried: list[tuple[Strip, int]] = []
        for most in _STRIPS:
            n_known = len(known)
            strips = find_strips(points, view.cloud.starts.mean(axis=0), rng, most=most)
            for strip in (part for whole in strips for part in straight_parts(whole)):
                if _is_explained(strip, known) or any(_is_again(strip, old, known[n:]) for old, n in tried):
                    continue
                tried.append((strip, len(known)))
                beam = _examine(index, strip, view.floor, known)
                if beam is not None and beam.confidence > _REPORTED:
                    beams.append(beam)
                    known += [beam.bar] if beam.confidence > _EXPLAINS else []
            # The points of known beams would hide the strips of beams across them.
            for bar in known[n_known:]:
                points = points[~bar.holds(points, _NEAR_BAR)]
            if len(known) == n_known:
                break
        beams = [_settle_again(index, beam, beams, view.floor) for beam in beams]
    beams.sort(key=lambda beam: -beam.confidence)
    return [_as_detection(beam) for beam in _drop_duplicates(beams)]


def loose_points(view: View) -> Float[np.ndarray, "N 3"]:
    """Return the obstacles' points and those on small raised floor levels, which may be beams side by side."""
    steps = [level for level in view.floors[1:] if level.area < _LARGEST_STEP]
    if view.floor is None or not steps:
        return view.obstacles
    points = view.near.points
    raised = on_floors(points, (view.floor, *steps)) & (view.floor.above(points) > _OVER_FLOOR)
    return np.concatenate([view.obstacles, points[raised]])


def _is_explained(strip: Strip, known: Sequence[Bar]) -> bool:
    return any(bar.holds(strip.members, _NEAR_BAR).mean() > 0.5 for bar in known)


def _is_again(strip: Strip, tried: Strip, since: Sequence[Bar]) -> bool:
    """Return whether the strip was tried before and no bar was found near it since."""
    places = strip.places(9)
    offset = places - tried.place
    along = offset @ tried.axis
    inside = (along > tried.first) & (along < tried.last)
    inside &= np.linalg.norm(offset - along[:, None] * tried.axis, axis=1) < _SAME_PLACE
    return bool(inside.mean() > 0.7) and not any(bar.holds(places, _TUBE).any() for bar in since)


def _examine(index: SightIndex, strip: Strip, floor: FloorPlane | None, known: Sequence[Bar]) -> _Beam | None:
    """Return the best cuboid fitted behind a strip, with its evidence; None if rejected."""
    run = Run(strip.place - _BEHIND * strip.normal, strip.axis, strip.first, strip.last, -strip.normal)
    rays = rays_about(index, run, _BEYOND, floor, known)
    if not _stands_out(rays, strip):
        return None
    choice = choose_bar(rays, run, max(strip.half, 0.045) + 0.025, _TIMBER, floor, 6, 160)
    if choice is None or choice.misfit > _MISFIT or weigh_bar(rays, choice.fit.bar).air < _SOME_AIR:
        return None
    ends = likely_ends(rays, choice.fit.bar, floor)
    for _ in range(_MOST_LOOKS):
        if all(ends.seen):
            break
        # An object over the beam may hide a long stretch of it.
        before = ends.bar
        rays = rays_about(index, run_of(before), _HIDDEN_STRETCH, floor, known)
        ends = likely_ends(rays, before, floor)
        if _end_moves(before, ends.bar) < _HIDDEN_STRETCH - _BEYOND:
            break
    settled = [_settle(rays, ends.bar, choice.fit, floor)]
    if ends.bar.length < _SHORT * (run.last - run.first):
        # The bar may be askew to the strip; also try the strip's whole length.
        settled.append(_settle(rays, _span(ends.bar, run), choice.fit, floor))
    return max(
        (beam for beam in settled if beam is not None), key=lambda beam: beam.confidence * beam.bar.length, default=None
    )


def _settle_again(index: SightIndex, beam: _Beam, beams: Sequence[_Beam], floor: FloorPlane | None) -> _Beam:
    """Refit a beam with the bars found later and the bars it may continue; keep the surer fit."""
    others = [other for other in beams if other is not beam and not _same(other.bar, beam.bar)]
    parts = [other.bar for other in others if _continues(other.bar, beam.bar)]
    if beam.confidence >= _SURE and not parts:
        return beam
    bar = beam.bar
    for part in parts:
        bar = _span(bar, run_of(part))
    sure = [other.bar for other in others if other.confidence > _EXPLAINS]
    known = [other for other in sure if not _continues(other, beam.bar)]
    rays = rays_about(index, run_of(bar), _BEYOND, floor, known)
    new = _settle(rays, bar, beam.fit, floor)
    return beam if new is None or new.confidence < beam.confidence else new


def _continues(bar: Bar, other: Bar) -> bool:
    """Return whether two bars are collinear and end to end with a small gap."""
    offset = bar.middle - other.middle
    along = float(offset @ other.axis)
    off = float(np.linalg.norm(offset - along * other.axis))
    gap = abs(along) - 0.5 * (bar.length + other.length)
    return abs(bar.axis @ other.axis) > _IN_LINE and off < _OFF_LINE and gap < _APART


def _settle(rays: SurroundingRays, bar: Bar, fit: BarFit, floor: FloorPlane | None) -> _Beam | None:
    """Refit the bar and its ends until the ends converge; return it with its evidence, or None if rejected."""
    early = weigh_bar(rays, bar)
    if bar.length < _LEAST_LENGTH or min(bar.half) < _LEAST_HALF or not _is_worth_a_fit(early):
        return None
    if early.air < _LEAST_AIR:
        # The bar may be a part of a wider bar's face.
        width, thickness = bar.half
        wider = [replace(bar, half=half) for half in ((width + _WIDER, thickness), (width, thickness + _WIDER))]
        if all(weigh_bar(rays, wide).air < _LEAST_AIR for wide in wider):
            return None
    fitted = _fit(rays, bar, fit, floor, _MOST_FITS)
    if fitted is None:
        return None
    choice, ends = fitted
    bar = ends.bar
    evidence = weigh_bar(rays, bar)
    spread = spread_between_edges(rays, replace(choice.fit, bar=bar), _FITTED_TO)
    confidence = _confidence(ends, choice, evidence, spread[0]) * _over_floor(bar, floor) * _lies(bar, floor)
    if confidence <= _REPORTED:
        return None
    flatter = rivalry(rays, bar, _PIPES, "round")
    points = rays.ends[evidence.hits]
    return _Beam(
        replace(choice.fit, bar=bar, spread=spread),
        ends,
        choice.doubt,
        evidence,
        flatter,
        confidence * _flatness(flatter),
        points[:: max(1, len(points) // _MOST_POINTS)],
    )


def _is_worth_a_fit(early: BarEvidence) -> bool:
    """Return whether a rough bar has some of the evidence that a beam needs; a better fit adds little to it."""
    is_seen = early.visible >= _VISIBLE[0] and early.n_hits >= _HITS[0]
    return is_seen and early.solid >= _LEAST_SOLID and early.known >= _KNOWN[0]


def _fit(
    rays: SurroundingRays, bar: Bar, fit: BarFit, floor: FloorPlane | None, n_fits: int
) -> tuple[Choice, LikelyEnds] | None:
    """Return the bar fitted between its ends, and its new ends; repeat at most ``n_fits`` times while they move."""
    choice = choose_bar(rays, run_of(bar), _TUBE, _TIMBER, floor, 3, _FITTED_TO, fit)
    if choice is None:
        return None
    ends = likely_ends(rays, choice.fit.bar, floor)
    if ends.bar.length < _LEAST_LENGTH:
        return None
    if n_fits > 1 and _end_moves(bar, ends.bar) > _STAYS:
        return _fit(rays, ends.bar, choice.fit, floor, n_fits - 1)
    return choice, ends


def _end_moves(before: Bar, after: Bar) -> float:
    """Return the larger of the two ends' displacements [m]."""
    shift = float((after.centre - before.centre) @ before.axis)
    return max(abs(after.first + shift - before.first), abs(after.last + shift - before.last))


def _span(bar: Bar, run: Run) -> Bar:
    """Return the bar lengthened to include a run along it."""
    middle, sign = float((run.place - bar.centre) @ bar.axis), float(np.sign(run.axis @ bar.axis))
    first, last = sorted((middle + sign * run.first, middle + sign * run.last))
    return replace(bar, first=min(bar.first, first), last=max(bar.last, last))


def _stands_out(rays: SurroundingRays, strip: Strip) -> bool:
    """Return whether rays pass the strip's edges on both sides or few are near them; else it may be part of a face."""
    frame = np.stack([strip.axis, cross(strip.normal, strip.axis), strip.normal])
    looks = [
        weigh_bar(rays, Bar(frame, strip.place, (strip.half + more, _BEHIND), strip.first, strip.last))
        for more in (0.0, _HALF_A_FACE)
    ]
    return any(look.air >= _LEAST_AIR or look.known <= _LEAST_KNOWN for look in looks)


def _confidence(ends: LikelyEnds, choice: Choice, evidence: BarEvidence, tilt: float) -> float:
    """Return the confidence: product of scores for hits, air beside, visible length, standard sizes, sure ends."""
    bar, ends_seen = ends.bar, sum(ends.seen)
    width, thickness = 2.0 * max(bar.half), 2.0 * min(bar.half)
    return float(
        rising(evidence.solid, 0.915, 0.965)
        * rising(evidence.air, 0.45, 0.75)
        * rising(evidence.known, *_KNOWN)
        * rising(evidence.visible, *_VISIBLE)
        * rising(bar.length / width, 2.5, 4.5)
        * rising(width, 0.042, 0.056)
        * rising(-width, -0.19, -0.155)
        * rising(thickness, 0.014, 0.02)
        * rising(-evidence.rms, -0.02, -0.015)
        * rising(evidence.n_hits, *_HITS)
        * rising(-_off_size(width, thickness), -0.025, -0.012)
        * rising(-tilt, -0.03, -0.012)
        * (1.0 - _DOUBTFUL * rising(choice.doubt, 0.01, 0.03))
        * (1.0 - 0.6 * rising(sum(ends.hidden), 0.025, 0.06))
        * _END_UNSEEN ** (2 - ends_seen)
    )


def _over_floor(bar: Bar, floor: FloorPlane | None) -> float:
    """Return the score, 0 to 1, that a bar's top is above the floor's noise; of a board in it only parts are seen."""
    if floor is None:
        return 1.0
    up = np.abs(bar.frame[1:] @ floor.normal) @ np.array(bar.half)
    return rising(float(floor.above(bar.places(0.1)).max() + up), *_IN_FLOOR)


def _lies(bar: Bar, floor: FloorPlane | None) -> float:
    """Return the score of a bar that lies or leans: lower where it stands upright, as what is built in does."""
    up = _UP if floor is None else floor.normal
    lean = float(np.arccos(min(1.0, abs(float(bar.axis @ up)))))
    return _POST + (1.0 - _POST) * rising(lean, *_UPRIGHT)


def _flatness(flatter: Rivalry) -> float:
    """Return the score, 0 to 1, that a box explains the rays better than a pipe, and with a small misfit."""
    return float(
        rising(flatter.better, -6.0, 10.0) * rising(flatter.share, 0.05, 0.14) * rising(-flatter.misfit, -3.8, -2.6)
    )


def _off_size(width: float, thickness: float) -> float:
    """Return the larger difference of the two sizes from those of the nearest standard timber [m]."""
    halves = np.array([*_TIMBER.halves, *_METRIC])
    nearest = np.abs(2.0 * np.column_stack([halves.max(axis=1), halves.min(axis=1)]) - (width, thickness))
    return float(nearest.max(axis=1).min())


def _drop_duplicates(beams: list[_Beam]) -> list[_Beam]:
    """Drop beams inside a surer beam, or just beside and parallel to it."""
    kept: list[_Beam] = []
    for beam in beams:
        if not any(_same(beam.bar, other.bar) or _same(other.bar, beam.bar) for other in kept):
            kept.append(beam)
    return kept


def _same(bar: Bar, other: Bar) -> bool:
    margin = 0.5 * min(bar.half) if abs(bar.axis @ other.axis) > 0.98 else 0.0
    return bool(other.holds(bar.places(0.02), margin).mean() > 0.5)


def _as_detection(beam: _Beam) -> Detection:
    bar, evidence = beam.bar, beam.evidence
    axes = bar.frame if bar.half[0] >= bar.half[1] else bar.frame[[0, 2, 1]]
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([axes[0], np.cross(axes[2], axes[0]), axes[2]])
    pose[:3, 3] = bar.middle
    sizes = {"length": bar.length, "width": 2.0 * max(bar.half), "thickness": 2.0 * min(bar.half)}
    residuals = {
        "rms": evidence.rms,
        "axis_spread_rad": beam.fit.spread[0],
        "centre_spread": beam.fit.spread[1],
        "doubt": beam.doubt,
        "solid_share": evidence.solid,
        "air_share": evidence.air,
        "visible_share": evidence.visible,
        "misfit_ratio": beam.flatter.misfit,
        "flatter_ratio": beam.flatter.share,
        "hidden_length": beam.hidden,
        "n_ends_seen": float(sum(beam.ends.seen)),
    }
    return Detection("beam", pose, sizes, beam.confidence, residuals, beam.points)
