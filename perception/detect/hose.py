"""Detection of hose ends and standpipes: a short round piece that bends off a pipe or stands out and ends free."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from perception.clean import voxel_downsample
from perception.detect.bar_evidence import Evidence, find_ends, weigh_bar
from perception.detect.bar_fit import fit_bars
from perception.detect.bar_search import Stock, choose_bar, likelier, rays_about
from perception.detect.bar_starts import Run, run_of
from perception.detect.bars import Bar, SurroundingRays, cross_bars, sort_rays
from perception.detect.confidence import rising
from perception.detect.detection import Detection
from perception.detect.lines import Line, find_lines
from perception.detect.sightlines import SightIndex, Sightlines, sight_index
from perception.detect.slender import is_slender
from perception.floor import FloorPlane
from perception.view import View

_PIPES = Stock("round", ((0.02, 0.02), (0.03, 0.03), (0.04, 0.04), (0.055, 0.055)), (0.0, 0.0, 0.0, 0.0))
_TIMBER = ((0.0445, 0.019), (0.0445, 0.0445), (0.02, 0.02))
_VOXEL = 0.012
_RADII = (0.03, 0.05)
_LEAST_LINE = 0.12
_PER_ROUND = 10
_HINT_RADIUS = 0.5
_REPORTED = 0.05
_DIRECTIONS = 90
_BRANCH = (0.05, 0.4)
_BACK = (-0.1, -0.06, -0.03, 0.0)
_MOST_BRANCHES = 5
_LEAST_PIECE = 0.05
_LONGEST_PIECE = 0.6
_HIGHEST = 2.1
_DEEP = 0.025
_MOST_POINTS = 200


@dataclass(frozen=True)
class _End:
    """A round piece that ends at its ``last`` place, and what speaks for it."""

    bar: Bar
    evidence: Evidence
    is_free: bool
    is_branch: bool
    hollow: float
    rounder: float
    confidence: float
    points: Float[np.ndarray, "K 3"]

    @property
    def mouth(self) -> Float[np.ndarray, "3"]:
        """Centre of the opening [m]."""
        return np.asarray(self.bar.centre + self.bar.last * self.bar.axis)


def detect_hose(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Hose ends and standpipes, best first; origin the centre of the opening, z out of it, x horizontal.

    The size is the outer radius at the opening.  A pipe that runs on, or that is long and straight up to its end, is
    none; an end that is not looked into stays below a sure hit unless everything else speaks for it.

    Args:
        view: the scan.
        hint: (3,) a point near the opening: only what lies within half a metre of it is looked at, and what cannot be
            seen of it is taken for granted sooner [m].
    """
    if not len(view.obstacles):
        return []
    rng = np.random.default_rng(view.seed)
    index = sight_index(view.cloud)
    points, _ = voxel_downsample(view.obstacles, _VOXEL)
    points = points[is_slender(points)]
    if hint is not None:
        points = points[np.linalg.norm(points - hint, axis=1) < _HINT_RADIUS]
    found: list[_End] = []
    # The fits are many and small: with several threads BLAS spends its time on handing them out.
    with threadpool_limits(limits=1, user_api="blas"):
        for line in find_lines(points, rng, _RADII, _LEAST_LINE)[:_PER_ROUND]:
            found += _ends_of(index, line, view.floor, hint is not None)
    found = [one for one in found if one.confidence > _REPORTED]
    found.sort(key=lambda one: -one.confidence)
    kept: list[_End] = []
    for one in found:
        if all(np.linalg.norm(one.mouth - other.mouth) > 0.1 for other in kept):
            kept.append(one)
    return [_as_detection(one) for one in kept]


def _ends_of(index: SightIndex, line: Line, floor: FloorPlane | None, is_hinted: bool) -> list[_End]:
    """What ends at or near either end of a pipe about a line."""
    run = Run(line.place, line.axis, line.first, line.last)
    rays = rays_about(index, run, 0.1, floor)
    choice = choose_bar(rays, run, 1.4 * line.radius, _PIPES, floor, 4, 200)
    if choice is None:
        return []
    ends = find_ends(rays, choice.fit.bar)
    pipe = ends.bar
    if weigh_bar(rays, pipe).solid < 0.6:
        return []
    found: list[_End] = []
    for sign, is_seen in ((1.0, ends.seen[1]), (-1.0, ends.seen[0])):
        side = pipe if sign > 0 else _reversed(pipe)
        if is_seen and pipe.length < _LONGEST_PIECE:
            found.append(_judged(index, side, floor, False, is_hinted))
        found += [_judged(index, piece, floor, True, is_hinted) for piece in _branches(index, side, floor)]
    return found


def _reversed(bar: Bar) -> Bar:
    """The same bar, running the other way."""
    frame = bar.frame * np.array([[-1.0], [1.0], [-1.0]])
    return Bar(frame, bar.centre, bar.half, -bar.last, -bar.first, bar.section)


def _branches(index: SightIndex, pipe: Bar, floor: FloorPlane | None) -> list[Bar]:
    """Round pieces that bend off near the last end of a pipe."""
    corner = pipe.centre + pipe.last * pipe.axis
    places = corner + np.array(
        [[0.0, 0.0, 0.0], [0.15, 0, 0], [-0.15, 0, 0], [0, 0.15, 0], [0, -0.15, 0], [0, 0, 0.15]]
    )
    near = index.passing(places, 0.2).thinned(600)
    elsewhere = np.zeros(len(near), dtype=bool) if floor is None else floor.above(near.ends) < 0.02
    rays = SurroundingRays(near.start, near.direction, near.length, elsewhere)
    starts = [
        Bar(_frame(way), corner + back * pipe.axis, pipe.half, *_BRANCH, "round")
        for way in _ways(_DIRECTIONS)
        if abs(way @ pipe.axis) < 0.8
        for back in _BACK
    ]
    crossing = cross_bars(rays, starts)
    told = sort_rays(rays, crossing)
    inside = (crossing.outside < -0.2 * pipe.half[0]) & (crossing.along > 1.3 * pipe.half[0]) & (crossing.along < 0.14)
    score = (inside & told.hit).sum(axis=1) - 2.0 * (inside & told.passed).sum(axis=1)
    best = [starts[i] for i in np.argsort(-score, kind="stable")[:_MOST_BRANCHES] if score[i] >= 8]
    pieces: list[Bar] = []
    for start in best:
        bar = find_ends(rays, replace(start, first=1.2 * pipe.half[0], last=0.16)).bar
        bar = replace(bar, first=1.2 * pipe.half[0])
        if bar.last - bar.first < 0.5 * _LEAST_PIECE:
            continue
        fit = fit_bars(rays, [(bar, bar.half)], 300)[0].bar
        fitted = replace(fit, first=fit.first, last=fit.last)
        fitted = _last_end(rays, fitted)
        if fitted.length >= _LEAST_PIECE and not any(_same_mouth(fitted, other) for other in pieces):
            pieces.append(fitted)
    return pieces


def _last_end(rays: SurroundingRays, bar: Bar) -> Bar:
    """With the last end where it is seen to be; the first, at the bend, stays."""
    return replace(bar, last=find_ends(rays, bar).bar.last)


def _same_mouth(one: Bar, other: Bar) -> bool:
    ends = [bar.centre + bar.last * bar.axis for bar in (one, other)]
    return bool(np.linalg.norm(ends[0] - ends[1]) < 0.02 and one.axis @ other.axis > 0.98)


def _ways(n: int) -> Float[np.ndarray, "n 3"]:
    """Unit directions spread evenly over the sphere (Fibonacci's lattice)."""
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), z])


def _frame(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rows: the axis, a direction as horizontal as can be, the third."""
    side = np.cross([0.0, 0.0, 1.0], axis) if abs(axis[2]) < 0.95 else np.cross(axis, [0.0, 1.0, 0.0])
    side = side / np.linalg.norm(side)
    return np.stack([axis, side, np.cross(axis, side)])


def _judged(index: SightIndex, bar: Bar, floor: FloorPlane | None, is_branch: bool, is_hinted: bool) -> _End:
    """Weigh a piece and its free end."""
    rays = rays_about(index, run_of(bar), 0.12, floor)
    fits = fit_bars(rays, [(bar, bar.half)], 400)
    bar = _last_end(rays, replace(fits[0].bar))
    ends = find_ends(rays, bar)
    evidence = weigh_bar(rays, bar)
    rounder = likelier(rays, bar, _TIMBER, "box")
    hollow = _hollow_share(rays, bar)
    free = ends.seen[1]
    points = rays.ends[evidence.hits]
    confidence = _confidence(bar, evidence, free, is_branch, hollow, rounder, is_hinted)
    return _End(
        bar, evidence, free, is_branch, hollow, rounder, confidence, points[:: max(1, len(points) // _MOST_POINTS)]
    )


def _hollow_share(rays: Sightlines, bar: Bar) -> float:
    """How many of the rays into the opening ended well behind it, 0 to 1; NaN when it is not looked into."""
    mouth = bar.centre + bar.last * bar.axis
    slope = rays.direction @ bar.axis
    into = slope < -0.2
    depth = ((mouth - rays.start) @ bar.axis) / np.where(into, slope, -1.0)
    apart = np.linalg.norm(rays.start + depth[:, None] * rays.direction - mouth, axis=1)
    inside = into & (apart < 0.7 * bar.half[0]) & (rays.length > depth - 0.03)
    if inside.sum() < 4:
        return float("nan")
    return float((rays.length[inside] > depth[inside] + _DEEP).mean())


def _confidence(
    bar: Bar, evidence: Evidence, is_free: bool, is_branch: bool, hollow: float, rounder: float, is_hinted: bool
) -> float:
    """Product of: solid, air about it, depths that agree, a hose's radius, a free end within reach, round rather than
    square, an opening that is seen to be one."""
    opening = 0.6 if np.isnan(hollow) else 0.4 + 0.6 * rising(hollow, 0.25, 0.6)
    top = float((bar.centre + bar.last * bar.axis)[2])
    value = (
        rising(evidence.solid, 0.75, 0.92)
        * rising(evidence.air, 0.35, 0.7)
        * rising(-evidence.rms, -0.02, -0.016)
        * rising(evidence.n_hits, 12.0, 40.0)
        * rising(bar.half[0], 0.016, 0.021)
        * rising(-bar.half[0], -0.075, -0.062)
        * rising(rounder, -10.0, 6.0)
        * (1.0 if is_free else 0.3)
        * (1.0 if is_branch else 0.7)
        * rising(-top, -_HIGHEST - 0.2, -_HIGHEST)
        * opening
    )
    return float(value**0.7 if is_hinted else value)


def _as_detection(one: _End) -> Detection:
    z = one.bar.axis
    frame = _frame(z)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([frame[1], frame[2], z])
    pose[:3, 3] = one.mouth
    residuals = {
        "rms": one.evidence.rms,
        "solid_share": one.evidence.solid,
        "air_share": one.evidence.air,
        "hollow_share": -1.0 if np.isnan(one.hollow) else one.hollow,
    }
    return Detection("hose", pose, {"radius": one.bar.half[0]}, one.confidence, residuals, one.points)
