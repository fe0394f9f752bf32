"""Open ends of round tubes, and how rays meet them: from outside on the wall, through the mouth, or past it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from costs.stopping import poll
from perception.sightlines import Sightlines

# How far behind its mouth an end is taken to be straight and without a collar [m].
STRAIGHT = 0.055
NEAR_WALL = 0.035
_SIGMA_DEPTH = 0.01
_SIGMA_EDGE = 0.005
_WORST = 9.0
# Usual changes of: tilts [rad], place [m], radius [m].
_STEPS = np.array([0.15, 0.15, 0.012, 0.012, 0.012, 0.006])
_LEAST_RADIUS = 0.008
_SLOPE = 1e-4


@dataclass(frozen=True)
class Tube:
    """The open end of a tube with a thin wall.

    Attributes:
        mouth: (3,) centre of the opening [m].
        axis: (3,) unit, out of the opening.
        radius: outer [m].
    """

    mouth: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    radius: float


@dataclass(frozen=True)
class Meeting:
    """How rays meet tubes; leading axis: the tubes.

    Attributes:
        on: the ray meets the outside of the wall.
        into: it goes in through the mouth.
        through: it goes in, and as deep as the end is known to be straight.
        depth: along it to the wall, or to as deep as that, or to where it passes nearest [m].
        plane: along it to the mouth's plane [m].
        outside: how far from the tube it passes; negative: how far inside the outline it meets it [m].
        along: place on the axis of ``depth``, from the mouth outwards [m].
        across: how far from the axis it crosses the mouth's plane [m].
    """

    on: Bool[np.ndarray, "B N"]
    into: Bool[np.ndarray, "B N"]
    through: Bool[np.ndarray, "B N"]
    depth: Float[np.ndarray, "B N"]
    plane: Float[np.ndarray, "B N"]
    outside: Float[np.ndarray, "B N"]
    along: Float[np.ndarray, "B N"]
    across: Float[np.ndarray, "B N"]


def meet_tubes(rays: Sightlines, tubes: Sequence[Tube]) -> Meeting:
    """How each ray meets each tube."""
    poll()
    mouth, axis = np.stack([tube.mouth for tube in tubes]), np.stack([tube.axis for tube in tubes])
    radius = np.array([tube.radius for tube in tubes])[:, None]
    start = rays.start[None] - mouth[:, None]
    rise = np.einsum("bnk,bk->bn", start, axis)
    slope = axis @ rays.direction.T
    square = np.maximum(1.0 - slope**2, _SLOPE)
    lean = np.einsum("bnk,nk->bn", start, rays.direction) - rise * slope
    middle = -lean / square
    side = np.sqrt(np.maximum(np.einsum("bnk,bnk->bn", start, start) - rise**2 - lean**2 / square, 0.0))
    half = np.sqrt(np.maximum(radius**2 - side**2, 0.0) / square)
    first, last = rise + (middle - half) * slope, rise + (middle + half) * slope
    in_line = side < radius
    on = in_line & (first <= 0.0)
    into = in_line & (first > 0.0) & (last <= 0.0)
    steep = np.where(np.abs(slope) < _SLOPE, -_SLOPE, slope)
    plane, bottom = -rise / steep, -(rise + STRAIGHT) / steep
    through = into & (bottom < middle + half)
    depth = np.where(on, middle - half, np.where(through, bottom, np.where(into, middle + half, middle)))
    # A ray before the mouth is as far from it as it would have to be moved along the axis to meet the rim.
    square_root = np.sqrt(square)
    before = np.minimum(np.abs(first), np.abs(last)) * square_root
    outside = np.where(in_line, np.where(on | into, -np.minimum(radius - side, before), before), side - radius)
    across = np.sqrt(square * (plane - middle) ** 2 + side**2)
    return Meeting(on, into, through, depth, plane, outside, rise + depth * slope, across)


def misfits(rays: Sightlines, mine: Bool[np.ndarray, "N"], tubes: Sequence[Tube]) -> Float[np.ndarray, "B"]:
    """How badly each tube explains rays about its mouth: squared residuals, none worse than three deviations, for each
    ray that should meet it.

    What should end on the wall, outside or inside, should end at its depth; what goes in deep may end anywhere deeper.

    Args:
        rays: that pass near the mouth.
        mine: those that ended on what is to be explained: they should meet the tube.
        tubes: which are to explain it.
    """
    met = meet_tubes(rays, tubes)
    gap = rays.length - met.depth
    edge = (met.outside / _SIGMA_EDGE) ** 2
    ends = (np.where(met.through, np.minimum(gap, 0.0), gap) / _SIGMA_DEPTH) ** 2
    radius = np.array([tube.radius for tube in tubes])[:, None]
    to_rim = ((radius - met.across) / _SIGMA_EDGE) ** 2
    explained = np.where(met.through, to_rim, np.where(met.on | met.into, ends, ends + edge))
    other = np.where(met.on | met.into, np.minimum(ends, edge), 0.0)
    each = np.minimum(np.where(mine, explained, other), _WORST)
    counts = mine | ((met.along > -STRAIGHT - 1e-9) & (gap > -2.0 * NEAR_WALL))
    return np.asarray(np.where(counts, each, 0.0).sum(axis=1) / max(1, int(mine.sum())))


def refined(rays: Sightlines, mine: Bool[np.ndarray, "N"], tube: Tube, most_steps: int = 260) -> Tube:
    """The tube of least misfit near one (Nelder and Mead's simplex)."""
    across, over = square_to(tube.axis)

    def moved(change: Float[np.ndarray, "6"]) -> Tube:
        axis = tube.axis + change[0] * across + change[1] * over
        return Tube(tube.mouth + change[2:5], axis / np.linalg.norm(axis), max(tube.radius + change[5], _LEAST_RADIUS))

    def misfit(change: Float[np.ndarray, "6"]) -> float:
        return float(misfits(rays, mine, [moved(change)])[0])

    simplex = np.concatenate([np.zeros((1, 6)), np.diag(_STEPS)])
    best = minimize(
        misfit,
        np.zeros(6),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": most_steps, "xatol": 5e-4, "fatol": 1e-4},
    )
    return moved(best.x)


def square_to(axis: Float[np.ndarray, "3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit directions square to an axis and to each other."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.8 else np.array([0.0, 1.0, 0.0])
    across = np.cross(helper, axis)
    across /= np.linalg.norm(across)
    return across, np.cross(axis, across)
