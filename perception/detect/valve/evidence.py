"""Evidence that a ring is the rim of a handwheel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.shared.arithmetic import rising
from perception.detect.valve.inside import MIDDLE, Inside
from perception.detect.valve.ring import Passage, Ring, axis_error, depth_error, rim_hits, unevenness
from perception.ground.floor import FloorPlane
from perception.sightlines import Sightlines

_SECTORS = 36
_BEHIND = 0.05
_UNKNOWN, _HUB_SEEN, _NO_HUB = 0.4, 0.2, 0.2
# Half width by radius; flat rims have up to 0.3.
_SLENDER = (-0.5, -0.35)
_EVEN = (-0.008, -0.005)
# The depth error of true rims is at most 1.74 cm with the noisiest of usual sensors, of large ones 1.56 cm [m].
_AGREE = (-0.02, -0.0175)
_MOST_SPOKES = 12
_MANY_SPOKES, _NO_SPOKES = 0.7, 0.4
_HAND = 0.035
_AT_RIM = (-0.018, -0.005)
# Required share of the rays inside the rim that pass through: _OPEN, plus _OPEN_BLURRED times the depth error, in outer
# radii, beyond _SHARPLY.
_OPEN, _SHARPLY, _OPEN_BLURRED = 0.08, 0.2, 1.2
_LEAST_HUB = 0.012
# Stretches behind the rim in which rays leave sideways: one for tubes, a short one for the drums of fans [m].
_ASIDE, _WALL, _USUAL_DEPTH = ((0.015, 0.1), (0.015, 0.045)), 0.025, 0.015
_ENCLOSED, _FREE_ASIDE, _LENIENT = 0.05, 0.15, 0.75
# Standard deviation of the axis [rad].
_SHARP, _BLUNT = np.radians([1.0, 2.0])
_BLURRED = 0.3  # rating of an uncertain axis: still worth a report


@dataclass(frozen=True)
class WheelEvidence:
    """Ratings of a ring by the rays, each from 0 to 1.

    Attributes:
        rim: as in :class:`RimEvidence`.
        air: rays just outside the rim pass it.
        open: rays pass between rim and hub.
        middle: hub or spokes in the middle, not all of them behind the rim, as the far wall of a pipe is.
        spokes: the solid parts between hub and rim are a few narrow spokes.
        free: a hand fits between rim and floor.
        sharp: the axis is known well enough to turn the wheel.
        aside: rays through the disc leave sideways behind it; the wall of a pipe or bucket would stop them.
    """

    rim: float
    air: float
    open: float
    middle: float
    spokes: float
    free: float
    sharp: float
    aside: float

    @property
    def confidence(self) -> float:
        """Confidence that the ring is a wheel: the product of all ratings."""
        return self.rim * self.air * self.open * self.middle * self.spokes * self.free * self.sharp * self.aside

    @property
    def solid_confidence(self) -> float:
        """Confidence that the ring is a solid wheel, for use near a hint: openings and spokes do not count."""
        return self.rim * self.air * self.free * self.sharp * self.aside


def weigh_wheel(
    rays: Sightlines,
    ring: Ring,
    passage: Passage,
    rim: RimEvidence,
    inside: Inside,
    floor: FloorPlane | None,
) -> WheelEvidence:
    """Return the ratings of a ring by the rays near it and the evidence for its rim."""
    distance = np.linalg.norm(passage.place, axis=1)
    outer = ring.radius + ring.half_width
    around = (distance > outer + 0.012) & (distance < outer + 0.05)
    # Air: rays that went on, or ended well before or behind the rim's plane.
    solid = around & (np.abs(rays.length - passage.crossing) < _BEHIND)
    air = _shares(_sectors_of(passage), around & ~solid, around)
    airy = float(np.mean(air[~np.isnan(air)] > 0.7)) if (~np.isnan(air)).any() else 0.0
    # The hub of a small wheel fills much of its middle.
    hub_share = min(0.4, (_LEAST_HUB / max(MIDDLE * (ring.radius - ring.half_width), _LEAST_HUB)) ** 2)
    return WheelEvidence(
        rim.rating,
        rising(airy, 0.45, 0.85),
        _openings(inside, rim.rms / outer),
        rising(inside.middle_share, 0.05 + 0.5 * hub_share, 0.15 + hub_share)
        * rising(float(inside.n_middle), 1.0, 5.0)
        * rising(inside.depth[1], *_AT_RIM),
        _spoke_evidence(inside),
        _over_floor(ring, floor),
        max(_BLURRED, rising(-axis_error(rays, ring, passage), -_BLUNT, -_SHARP)),
        _free_aside(rays, ring),
    )


@dataclass(frozen=True)
class RimEvidence:
    """Evidence for a rim.

    Attributes:
        rating: 0 to 1: hits all round, enough of them, with small and even depth residuals, on a slender section.
        rms: depth error of the hits [m].
        n_hits: number of rays that ended on the rim.
    """

    rating: float
    rms: float
    n_hits: int


def weigh_rim(rays: Sightlines, ring: Ring, passage: Passage) -> RimEvidence:
    """Return the evidence for a ring's rim by the rays near it."""
    hit = rim_hits(rays, ring, passage)
    error, n_hits = depth_error(rays, passage, hit), int(hit.sum())
    inside_rim = passage.level < 0.9
    through = rays.length > passage.depth + _BEHIND
    share = _shares(_sectors_of(passage), inside_rim & hit, inside_rim & (hit | through))
    seen = ~np.isnan(share)
    if seen.mean() < 0.4:
        return RimEvidence(0.0, error, n_hits)
    # Unseen sectors count neither for nor against the rim, but more than half must be seen.
    complete = float(np.mean(share[seen] > 0.6) * min(1.0, np.sum(share[seen] > 0.6) / (0.6 * _SECTORS)))
    rating = (
        rising(complete, 0.55, 0.9)
        * rising(-ring.half_width / ring.radius, *_SLENDER)
        # A section much deeper along the axis than wide is the wall of a tube seen end-on.
        * rising(-ring.half_depth / ring.half_width, -4.0, -2.5)
        * rising(-error, *_AGREE)
        * rising(float(n_hits), 15.0, 60.0)
    )
    if rating > 0.0:
        rating *= rising(-unevenness(rays, passage, hit & inside_rim), *_EVEN)
    return RimEvidence(rating, error, n_hits)


def _sectors_of(passage: Passage) -> Int[np.ndarray, "N"]:
    """Return the sector of the ring that each ray crosses."""
    angle = np.arctan2(passage.place[:, 1], passage.place[:, 0])
    return np.asarray(np.floor(angle / (2.0 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS)


def _openings(inside: Inside, blur: float) -> float:
    """Return the rating of the openings; the larger the depth error, the more open a wheel must be.

    With a depth error that is a large share of the radius, any lump of that size fits the rim: only its openings
    distinguish a wheel.

    Args:
        inside: inside of the rim.
        blur: depth error over the outer radius.
    """
    enough = _OPEN + _OPEN_BLURRED * max(0.0, blur - _SHARPLY)
    return rising(inside.open_share, 0.25 * enough, enough)


def _spoke_evidence(inside: Inside) -> float:
    """Return the rating of narrow spokes between hub and rim; with few rays, of a hub with openings about it.

    Objects close behind the wheel hide openings, so unexplained returns do not lower the rating and many spokes lower
    it little; one broad solid sector does.
    """
    n_spokes = len(inside.spoke_angles)
    narrow = rising(-inside.widest_spoke, -1.8, -1.2)
    if inside.spokes_known and n_spokes >= 2:
        return narrow * (1.0 if n_spokes <= _MOST_SPOKES else _MANY_SPOKES)
    if inside.spokes_known:
        return narrow * _NO_SPOKES
    has_hub = rising(float(inside.n_middle), 5.0, 15.0) * rising(inside.open_share, 0.04, 0.12)
    return narrow * (_UNKNOWN + _HUB_SEEN * has_hub if inside.hub_radius > 0.0 else _NO_HUB)


def _over_floor(ring: Ring, floor: FloorPlane | None) -> float:
    """Return the rating of the gap for a hand between rim and floor; a ring on the floor is a loose object."""
    if floor is None:
        return 1.0
    droop = np.sqrt(max(0.0, 1.0 - float(ring.axis @ floor.normal) ** 2))
    lowest = float(floor.above(ring.centre)) - (ring.radius + ring.half_width) * droop - ring.half_depth * (1.0 - droop)
    return rising(lowest, _HAND - 0.015, _HAND + 0.035)


def _free_aside(rays: Sightlines, ring: Ring) -> float:
    """Return the rating of the share of rays through the disc that leave sideways behind the rim; 1 without such rays.

    A ray leaves the tube whose mouth the rim would be where its distance from the axis is the rim's radius for the
    second time.
    """
    basis = ring.basis
    start, way = (rays.start - ring.centre) @ basis.T, rays.direction @ basis.T
    speed = np.maximum((way[:, :2] ** 2).sum(axis=1), 1e-9)
    nearest = -(start[:, :2] * way[:, :2]).sum(axis=1) / speed
    square = nearest**2 - ((start[:, :2] ** 2).sum(axis=1) - ring.radius**2) / speed
    leaves = nearest + np.sqrt(np.maximum(square, 0.0))
    # A ring fitted to the wall of a tube is deep: its depth is capped so that the wall behind it counts.
    deep = min(ring.half_depth, _USUAL_DEPTH)
    behind_there, behind_end = (-(start[:, 2] + t * way[:, 2]) - deep for t in (leaves, rays.length))
    ratings = []
    for nearest_by, farthest_by in _ASIDE:
        goes_in = (square > 0.0) & (behind_end > nearest_by - 0.005)
        counted = goes_in & (behind_there > nearest_by) & (behind_there < farthest_by)
        n_out = float((rays.length[counted] > leaves[counted] + _WALL).sum())
        ratings.append(rising((n_out + _LENIENT) / (float(counted.sum()) + _LENIENT), _ENCLOSED, _FREE_ASIDE))
    return min(ratings)


def _shares(sector: np.ndarray, these: Bool[np.ndarray, "N"], all_of: Bool[np.ndarray, "N"]) -> Float[np.ndarray, "S"]:
    """Return (S,) share of ``these`` among ``all_of`` in each sector; NaN in sectors without rays."""
    total = np.bincount(sector[all_of], minlength=_SECTORS).astype(float)
    total[total == 0.0] = np.nan
    return np.asarray(np.bincount(sector[these], minlength=_SECTORS) / total)
