"""Open ends of round tubes: intersection with rays, evidence for a fitted end, and its refinement on its returns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares, minimize
from scipy.special import ndtr

from costs.stopping import poll
from perception.sightlines import Sightlines

_MOST_EVALUATIONS = 260
# Length behind the mouth over which an end is taken as straight, without a collar [m].
STRAIGHT = 0.055
NEAR_WALL = 0.035
_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.005
_WORST = 9.0
# First simplex steps: tilts [rad], position [m], radius [m].
_STEPS = np.array([0.15, 0.15, 0.012, 0.012, 0.012, 0.006])
_LEAST_RADIUS = 0.008
_SLOPE = 1e-4
_INSIDE = 0.004
_CORE = 0.7
_DEEPER = 0.025
_AIR = (0.01, 0.045)
_STOPPED = 0.02
_STRAY = 0.025
_AHEAD = 0.03
_N_SECTORS = 12
_SIGMA_RANGE = 0.01
_LEAST_SIGMA = 0.003
_WALL = 0.009
_BEHIND, _AHEAD_OF_MOUTH = 0.045, 0.03
_SHIFTS = np.arange(-0.03, 0.0201, 0.001)
_ON_RIM = np.array([0.02, 0.1, 0.2, 0.35, 0.5, 0.7])
_STRAY_RETURN = 0.03
_LEAST_HITS = 15
# Least-squares fit: distance of its returns from the wall in each round; wall thickness; prior deviations [m, rad].
_ROUNDS = (0.014, 0.009, 0.009)
_THICK = 0.003
_LEAST_SIGMA_ACROSS = 0.002
_SCATTERED, _MOST = 1.5, 3.0
_AS_BEFORE = np.array([0.1, 0.1, 0.01, 0.01, 0.006])


@dataclass(frozen=True)
class Tube:
    """Open end of a tube with a thin wall.

    Attributes:
        mouth: (3,) centre of the opening [m].
        axis: (3,) unit, out of the opening.
        radius: outer radius [m].
    """

    mouth: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float


@dataclass(frozen=True)
class Meeting:
    """Intersections of N rays with a tube.

    Attributes:
        on: the ray meets the outside of the wall.
        into: the ray enters through the mouth.
        through: the ray enters and gets ``STRAIGHT`` deep without meeting the wall.
        depth: distance along the ray to the wall; if through, to that depth; if it misses, to its closest approach [m].
        plane: distance along the ray to the mouth's plane [m].
        outside: distance of the ray from the tube; negative: how far inside the outline it meets the tube [m].
        along: axial position of the point at ``depth``, from the mouth outwards [m].
        across: distance from the axis at which the ray crosses the mouth's plane [m].
    """

    on: Bool[np.ndarray, "N"]
    into: Bool[np.ndarray, "N"]
    through: Bool[np.ndarray, "N"]
    depth: Float[np.ndarray, "N"]
    plane: Float[np.ndarray, "N"]
    outside: Float[np.ndarray, "N"]
    along: Float[np.ndarray, "N"]
    across: Float[np.ndarray, "N"]


def meet_tube(rays: Sightlines, tube: Tube) -> Meeting:
    """Return the intersection of each ray with a tube."""
    poll()
    radius = tube.radius
    start = rays.start - tube.mouth
    rise, slope = start @ tube.axis, rays.direction @ tube.axis
    square = np.maximum(1.0 - slope * slope, _SLOPE)
    lean = np.einsum("nk,nk->n", start, rays.direction) - rise * slope
    middle = -lean / square
    side = np.sqrt(np.maximum(np.einsum("nk,nk->n", start, start) - rise * rise + lean * middle, 0.0))
    half = np.sqrt(np.maximum(radius**2 - side * side, 0.0) / square)
    at_middle, by_half = rise + middle * slope, half * slope
    first, last = at_middle - by_half, at_middle + by_half
    in_line = side < radius
    on = in_line & (first <= 0.0)
    into = in_line & (first > 0.0) & (last <= 0.0)
    steep = np.where(np.abs(slope) < _SLOPE, -_SLOPE, slope)
    plane, bottom, exit_ = -rise / steep, -(rise + STRAIGHT) / steep, middle + half
    through = into & (bottom < exit_)
    depth = np.where(on, middle - half, np.where(through, bottom, np.where(into, exit_, middle)))
    # For a ray that passes before the mouth, the distance follows from its shift along the axis to meet the rim.
    before = np.minimum(np.abs(first), np.abs(last)) * np.sqrt(square)
    outside = np.where(in_line, np.where(on | into, -np.minimum(radius - side, before), before), side - radius)
    across = np.sqrt(square * (plane - middle) ** 2 + side * side)
    return Meeting(on, into, through, depth, plane, outside, rise + depth * slope, across)


def misfit_of(rays: Sightlines, mine: Bool[np.ndarray, "N"], tube: Tube) -> float:
    """Return a tube's squared residuals, each bounded at three deviations, summed per ray of ``mine``.

    Rays that meet the wall, outside or inside, should end at its depth; rays through the mouth may end deeper.

    Args:
        mine: (N,) rays that ended on the object to explain: they should meet the tube.
    """
    met = meet_tube(rays, tube)
    gap = rays.length - met.depth
    edge = (met.outside / _SIGMA_EDGE) ** 2
    ends = (np.where(met.through, np.minimum(gap, 0.0), gap) / _SIGMA_DEPTH) ** 2
    to_rim = ((tube.radius - met.across) / _SIGMA_EDGE) ** 2
    meets = met.on | met.into
    explained = np.where(met.through, to_rim, np.where(meets, ends, ends + edge))
    other = np.where(meets, np.minimum(ends, edge), 0.0)
    each = np.minimum(np.where(mine, explained, other), _WORST)
    counts = mine | ((met.along > -STRAIGHT - 1e-9) & (gap > -2.0 * NEAR_WALL))
    return float(each[counts].sum()) / max(1, int(np.count_nonzero(mine)))


def refine_tube(rays: Sightlines, mine: Bool[np.ndarray, "N"], tube: Tube) -> Tube:
    """Return the tube of least misfit near a start tube (Nelder and Mead's simplex)."""
    across, over = square_to(tube.axis)

    def move(change: Float[np.ndarray, "6"]) -> Tube:
        axis = tube.axis + change[0] * across + change[1] * over
        return Tube(tube.mouth + change[2:5], axis / np.sqrt(axis @ axis), max(tube.radius + change[5], _LEAST_RADIUS))

    def misfit(change: Float[np.ndarray, "6"]) -> float:
        return misfit_of(rays, mine, move(change))

    simplex = np.concatenate([np.zeros((1, 6)), np.diag(_STEPS)])
    best = minimize(
        misfit,
        np.zeros(6),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": _MOST_EVALUATIONS, "xatol": 5e-4, "fatol": 1e-4},
    )
    return move(best.x)


def square_to(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return two unit directions perpendicular to an axis and to each other."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.8 else np.array([0.0, 1.0, 0.0])
    across = np.cross(helper, axis)
    across /= np.linalg.norm(across)
    return across, np.cross(axis, across)


@dataclass(frozen=True)
class TubeEvidence:
    """Evidence for a tube's end.

    Attributes:
        n_hits: number of rays that ended on the wall, outside or inside.
        solid: share of hits among the rays that should meet the wall.
        open: share of the rays into the middle of the mouth that ended behind it; NaN without such rays.
        n_open: number of rays into the middle of the mouth.
        round: share of the sectors about the axis in which more rays hit the wall than missed it.
        entering: share of the rays into the mouth among all rays that meet the end.
        stopped: share of the rays into the mouth that ended before the inner wall.
        stray: share of the returns near the end that lie off the wall.
        air: share of the known sectors in which most rays just beside the end went past it.
        known: share of the sectors with rays just beside the end.
        rms: root mean square depth residual of the hits [m].
        points: (K, 3) ends of the hits [m].
    """

    n_hits: int
    solid: float
    open: float
    n_open: int
    round: float
    entering: float
    stopped: float
    stray: float
    air: float
    known: float
    rms: float
    points: Float[np.ndarray, "K 3"]


def weigh_tube(rays: Sightlines, tube: Tube) -> TubeEvidence:
    """Return the evidence from the rays on, into and beside the end."""
    met = meet_tube(rays, tube)
    on, into, through = met.on, met.into, met.through
    gap = rays.length - met.depth
    arrives = gap > -NEAR_WALL
    straight = met.along > -STRAIGHT
    should = (on | (into & ~through)) & arrives & straight
    hits = should & (gap < NEAR_WALL)
    clear = should & (met.outside < -_INSIDE)
    core = into & (met.across < _CORE * tube.radius) & (rays.length > met.plane - NEAR_WALL)
    deeper = rays.length > met.plane + _DEEPER
    inward = into & (rays.length > met.plane - NEAR_WALL)
    beside = ~on & ~into & (met.outside > _AIR[0]) & (met.outside < _AIR[1]) & straight & arrives
    sector = _sectors(rays, tube, met.depth)
    free, full = (
        np.bincount(sector[beside & mask], minlength=_N_SECTORS) for mask in (gap > NEAR_WALL, gap < NEAR_WALL)
    )
    known = free + full > 0
    there, missing = (np.bincount(sector[mask], minlength=_N_SECTORS) for mask in (hits, clear & ~hits))
    return TubeEvidence(
        int(hits.sum()),
        float(hits[clear].mean()) if clear.any() else 0.0,
        float(deeper[core].mean()) if core.any() else float("nan"),
        int(core.sum()),
        float((there > missing).mean()),
        float(inward.sum() / max(1, (inward | should).sum())),
        float((gap < -_STOPPED)[inward].mean()) if inward.any() else 1.0,
        _stray_share(rays, tube),
        float((free > full)[known].mean()) if known.any() else 0.0,
        float(known.mean()),
        float(np.sqrt(np.mean(gap[hits] ** 2))) if hits.any() else float("inf"),
        rays.ends[hits],
    )


def _stray_share(rays: Sightlines, tube: Tube) -> float:
    """Return the share of the returns within 3 cm of the end that lie more than 2.5 cm off its wall."""
    offset = rays.ends - tube.mouth
    along = offset @ tube.axis
    across = np.linalg.norm(offset - along[:, None] * tube.axis, axis=1)
    about = (along > -STRAIGHT) & (along < _AHEAD) & (across < tube.radius + _AHEAD)
    return float((np.abs(across - tube.radius) > _STRAY)[about].mean()) if about.any() else 1.0


def _sectors(rays: Sightlines, tube: Tube, depth: Float[np.ndarray, "N"]) -> np.ndarray:
    """Return (N,) sector about the axis that each ray has reached at its ``depth``."""
    across, over = square_to(tube.axis)
    offset = rays.start + depth[:, None] * rays.direction - tube.mouth
    angle = np.arctan2(offset @ over, offset @ across) / (2.0 * np.pi) % 1.0
    return np.asarray((angle * _N_SECTORS).astype(np.int64) % _N_SECTORS)


def settle_tube(rays: Sightlines, tube: Tube) -> Tube:
    """Return the tube fitted to the returns from its wall by least squares, its mouth at the most likely position."""
    for near in _ROUNDS:
        tube = settle_mouth(rays, _through_returns(rays, tube, near))
    return tube


def _through_returns(rays: Sightlines, tube: Tube, near: float) -> Tube:
    """Return the tube moved, turned and widened to fit the returns from its outer and inner wall."""
    across, over = square_to(tube.axis)
    ends = rays.ends - tube.mouth
    place = ends @ np.column_stack([across, over, tube.axis])
    way = rays.direction @ np.column_stack([across, over, tube.axis])
    reach = np.hypot(place[:, 0], place[:, 1])
    radial = (place[:, :2] * way[:, :2]).sum(axis=1) / np.maximum(reach, 1e-6)
    sigma = np.hypot(_SIGMA_RANGE * radial, _LEAST_SIGMA_ACROSS)
    mine = np.abs(reach - tube.radius) < near + _SCATTERED * sigma
    mine &= (place[:, 2] > -_BEHIND) & (place[:, 2] < 0.5 * _AHEAD_OF_MOUTH)
    if mine.sum() < _LEAST_HITS:
        return tube
    place, radial, sigma = place[mine], radial[mine], sigma[mine]
    depth = np.where(radial > 0.0, _THICK, 0.0)

    def residuals(change: Float[np.ndarray, "5"]) -> Float[np.ndarray, "K"]:
        aside = place[:, :2] - change[2:4] - place[:, 2:] * change[:2]
        return np.asarray((np.hypot(aside[:, 0], aside[:, 1]) - tube.radius - change[4] + depth) / sigma)

    def with_prior(change: Float[np.ndarray, "5"]) -> Float[np.ndarray, "L"]:
        # Returns on one side alone leave some changes undetermined: the prior keeps those small.
        return np.concatenate([residuals(change), change / _AS_BEFORE])

    change = least_squares(with_prior, np.zeros(5), loss="soft_l1", max_nfev=30).x
    if (np.abs(change) > _MOST * _AS_BEFORE).any():
        return tube
    axis = tube.axis + change[0] * across + change[1] * over
    mouth = tube.mouth + change[2] * across + change[3] * over
    return Tube(mouth, axis / np.linalg.norm(axis), tube.radius + float(change[4]))


def settle_mouth(rays: Sightlines, tube: Tube) -> Tube:
    """Return the tube with its mouth moved along the axis to the position of greatest likelihood.

    Range noise carries returns beyond the mouth, so a tube that ends at the outermost return would be too long.
    Returns are modelled as uniform along the wall, with a share on the rim and a few anywhere.
    """
    offset = rays.ends - tube.mouth
    along = offset @ tube.axis
    across = np.linalg.norm(offset - along[:, None] * tube.axis, axis=1)
    mine = (np.abs(across - tube.radius) < _WALL) & (along > -_BEHIND) & (along < _AHEAD_OF_MOUTH)
    if mine.sum() < _LEAST_HITS:
        return tube
    place = along[mine]
    sigma = np.maximum(np.abs(rays.direction[mine] @ tube.axis) * _SIGMA_RANGE, _LEAST_SIGMA)
    z = (_SHIFTS[:, None] - place) / sigma
    wall = ndtr(z) / (_BEHIND + _SHIFTS[:, None])
    rim = np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * sigma)
    stray = _STRAY_RETURN / (_BEHIND + _AHEAD_OF_MOUTH)
    share = _ON_RIM[:, None, None]
    likelihood = np.log((1.0 - _STRAY_RETURN) * (share * rim + (1.0 - share) * wall) + stray).sum(axis=2).max(axis=0)
    return replace(tube, mouth=tube.mouth + float(_SHIFTS[np.argmax(likelihood)]) * tube.axis)
