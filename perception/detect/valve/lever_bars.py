"""Candidates for a valve's lever and pipe: round bars fitted at lines of points with air about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.cleaning.clean import voxel_downsample
from perception.detect.shared.arithmetic import cross
from perception.detect.shared.bar_evidence import BarEvidence, Ends, find_ends, weigh_bar
from perception.detect.shared.bar_fit import BarFit, fit_bars
from perception.detect.shared.bar_search import rays_about
from perception.detect.shared.bar_starts import Run, misfits, run_of, sample_about, starts_about
from perception.detect.shared.bars import Bar, SurroundingRays
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.lines import Line, find_lines
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex

LENGTHS = (0.1, 0.5)
LONGEST_LINE = 1.5 * LENGTHS[1]
_VOXEL = 0.015
_HINT_RADIUS = 0.6
_LEVER_TUBE, _PIPE_TUBES = (0.022,), (0.04, 0.065)
_LEVER_BALL, _LEVER_PAIRS, _PIPE_PAIRS = 0.055, 6, 14
LEVER_RADII = ((0.008, 0.008), (0.013, 0.013), (0.02, 0.02))
PIPE_RADII = ((0.025, 0.025), (0.045, 0.045), (0.07, 0.07))
_LEAST_PIPE = 0.25
_MOST_LEVERS, _MOST_PIPES = 10, 6
TUBES = (0.03, 0.09)
_BEYOND = 0.1
_HOPELESS = 0.15
_MOST_RAYS = 400
_SEEN_SIDE = 0.7


@dataclass(frozen=True)
class FittedBar:
    """Round bar with its ends and evidence.

    Attributes:
        fit: the fitted bar and its uncertainty.
        ends: the bar cut to its ends, and which of them were seen.
        evidence: of the rays about it.
        rating: of its round section against those of boxes, 0 to 1; 1 where they were not compared.
    """

    fit: BarFit
    ends: Ends
    evidence: BarEvidence
    rating: float = 1.0

    @property
    def bar(self) -> Bar:
        """The bar cut to its ends."""
        return self.ends.bar


def find_levers(
    foreground: Foreground, floor: FloorPlane | None, hint: Float[np.ndarray, "3"] | None
) -> list[FittedBar]:
    """Return slim bars with air about them and at least one seen end.

    Args:
        hint: (3,) only lines near it are fitted; its surroundings are searched a second time [m].
    """
    lines = _lines(foreground, hint, _LEVER_TUBE, LENGTHS[0], _LEVER_PAIRS, _LEVER_BALL)
    short = [line for line in lines if line.last - line.first < LONGEST_LINE]
    chosen = in_air(short, foreground.index, floor, LEVER_RADII[1:2])[:_MOST_LEVERS]
    fitted = [fit_line(line, foreground.index, floor, LEVER_RADII, TUBES[0]) for line in chosen]
    return [candidate for candidate in fitted if candidate is not None and is_lever(candidate)]


def is_lever(candidate: FittedBar) -> bool:
    """Return whether size and evidence of a bar allow it to be a lever."""
    return (
        LENGTHS[0] < candidate.bar.length < LENGTHS[1]
        and candidate.bar.half[0] < 0.028
        and candidate.evidence.solid > 0.5
        and any(candidate.ends.seen)
    )


def find_pipes(
    foreground: Foreground, floor: FloorPlane | None, hint: Float[np.ndarray, "3"] | None
) -> list[FittedBar]:
    """Return longer and thicker round bars; arguments as for :func:`find_levers`."""
    lines = _lines(foreground, hint, _PIPE_TUBES, _LEAST_PIPE, _PIPE_PAIRS, None)
    chosen = in_air(lines, foreground.index, floor, PIPE_RADII)[:_MOST_PIPES]
    fitted = [fit_line(line, foreground.index, floor, PIPE_RADII, TUBES[1]) for line in chosen]
    return [
        candidate
        for candidate in fitted
        if candidate is not None and candidate.bar.half[0] > 0.015 and candidate.evidence.rms < 0.025
    ]


def _lines(
    foreground: Foreground,
    hint: Float[np.ndarray, "3"] | None,
    tubes: tuple[float, ...],
    least_length: float,
    n_pairs: int,
    ball: float | None,
) -> list[Line]:
    """Return lines of points; with a hint, the scan's lines near it and the lines of the points near it."""
    points, _ = voxel_downsample(foreground.points, _VOXEL)
    lines = find_lines(points, foreground.generator(), tubes, least_length, n_pairs=n_pairs, slim_ball=ball)
    if hint is None:
        return lines
    near = points[np.linalg.norm(points - hint, axis=1) < _HINT_RADIUS]
    more = find_lines(near, foreground.generator(), tubes, least_length, n_pairs=n_pairs, slim_ball=ball)
    return [line for line in lines if _distance(line, hint) < _HINT_RADIUS] + more


def _distance(line: Line, place: Float[np.ndarray, "3"]) -> float:
    """Return the distance of a point from a line between its ends [m]."""
    offset = place - line.place
    along = float(np.clip(offset @ line.axis, line.first, line.last))
    return float(np.linalg.norm(offset - along * line.axis))


def in_air(
    lines: Sequence[Line],
    index: SightIndex,
    floor: FloorPlane | None,
    radii: Sequence[tuple[float, float]],
    behind: tuple[Bar, float] | None = None,
) -> list[Line]:
    """Return lines that may be bars in air: at one of the radii, most rays end on the bar and most beside it go on.

    Every scan row on a wall is a line too.  This check takes a hundredth of the time of a fit.

    Args:
        behind: as for :func:`fit_line`.
    """
    kept = []
    for line in lines:
        rays = _rays_before(index, Run(line.place, line.axis, line.first, line.last), floor, behind)
        way = rays.direction.sum(axis=0)
        away = way - (way @ line.axis) * line.axis
        away /= max(float(np.linalg.norm(away)), 1e-6)
        frame = np.stack([line.axis, cross(away, line.axis), away])
        for half in radii:
            # Points lie on the visible side of a bar.
            place = line.place + _SEEN_SIDE * half[0] * away
            evidence = weigh_bar(rays, Bar(frame, place, half, line.first, line.last, "round"))
            if evidence.solid * evidence.air * evidence.visible > _HOPELESS:
                kept.append(line)
                break
    return kept


def fit_line(
    line: Line,
    index: SightIndex,
    floor: FloorPlane | None,
    radii: tuple[tuple[float, float], ...],
    tube: float,
    behind: tuple[Bar, float] | None = None,
) -> FittedBar | None:
    """Return the round bar at a line, fitted, cut to its ends and fitted again; None when a fit fails.

    Args:
        behind: a pipe and the distance from its surface below which rays end on it and not on the bar [m].
    """
    first = _fit_once(Run(line.place, line.axis, line.first, line.last), index, floor, radii, tube, behind)
    return None if first is None else _fit_once(run_of(first.bar), index, floor, radii, tube, behind)


def fit_again(bar: Bar, index: SightIndex, floor: FloorPlane | None) -> FittedBar | None:
    """Return a lever's bar fitted to other rays; None when a fit fails."""
    first = _fit_once(run_of(bar), index, floor, LEVER_RADII, TUBES[0])
    return None if first is None else _fit_once(run_of(first.bar), index, floor, LEVER_RADII, TUBES[0])


def _fit_once(
    run: Run,
    index: SightIndex,
    floor: FloorPlane | None,
    radii: tuple[tuple[float, float], ...],
    tube: float,
    behind: tuple[Bar, float] | None = None,
) -> FittedBar | None:
    rays = _rays_before(index, run, floor, behind)
    fit = best_round(rays, run, radii, tube, _MOST_RAYS)
    if fit is None:
        return None
    ends = find_ends(rays, fit.bar)
    return FittedBar(fit, ends, weigh_bar(rays, ends.bar)) if ends.bar.length >= LENGTHS[0] else None


def _rays_before(
    index: SightIndex, run: Run, floor: FloorPlane | None, behind: tuple[Bar, float] | None
) -> SurroundingRays:
    """Return the rays about a run; those that ended on a pipe behind it are marked as ended elsewhere."""
    rays = rays_about(index, run, _BEYOND, floor)
    if behind is None:
        return rays
    pipe, margin = behind
    return replace(rays, elsewhere=rays.elsewhere | (distances_from(pipe, rays.ends)[1] < pipe.half[0] + margin))


def distances_from(bar: Bar, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Return (N,) positions of points along a bar's axis and (N,) distances from the axis [m]."""
    offset = points - bar.centre
    along = offset @ bar.axis
    return along, np.sqrt(np.maximum(np.einsum("ni,ni->n", offset, offset) - along**2, 0.0))


def best_round(
    rays: SurroundingRays, run: Run, radii: tuple[tuple[float, float], ...], tube: float, most: int
) -> BarFit | None:
    """Return the round bar of least misfit to the rays about a run; None with too few rays.

    Args:
        radii: start values, each as a pair of equal half sizes [m].
        tube: radius about the run within which the bar must explain the points [m].
    """
    sample = sample_about(rays, run, tube, most)
    if sample is None:
        return None
    fits = fit_bars(rays, starts_about(sample, run, radii, "round", len(radii)), most)
    return fits[int(np.argmin(misfits(sample, [fit.bar for fit in fits])))]
