"""Evidence that a ring is the rim of a wheel that can be turned by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.shared.arithmetic import rising
from perception.detect.valve.inside import MIDDLE, Inside
from perception.detect.valve.ring import Passage, Ring, axis_error, depth_error, unevenness
from perception.ground.floor import FloorPlane
from perception.sightlines import Sightlines

_SECTORS = 36
_BEHIND = 0.05
_UNKNOWN, _HUB_SEEN, _NO_HUB = 0.4, 0.2, 0.2
# Half width by radius; flat rims have up to 0.3.
_SLENDER = (-0.5, -0.35)
_EVEN = (-0.008, -0.005)
# Depths on true rims disagree by no more than 1.7 cm, by the noisiest of usual sensors.
_AGREE = (-0.023, -0.0175)
_MOST_SPOKES = 12
_MANY_SPOKES = 0.7
_HAND = 0.035
_AT_RIM = (-0.018, -0.005)
# Of the rays inside the rim: how many have to go through it, and how many more for each outer radius by which depths
# disagree beyond a fifth of it.
_OPEN, _SHARPLY, _OPEN_BLURRED = 0.08, 0.2, 1.2
_LEAST_HUB = 0.012
_ASIDE, _WALL, _USUAL_DEPTH = (0.015, 0.1), 0.025, 0.015
_ENCLOSED, _FREE_ASIDE, _LENIENT = 0.05, 0.15, 0.75
# Standard deviation of the axis.
_SHARP, _BLUNT = np.radians([1.0, 2.0])
_BLURRED = 0.3  # where it does not tell the axis: still worth a report


@dataclass(frozen=True)
class WheelEvidence:
    """Evidence of the rays for a ring; each figure from 0 to 1.

    Attributes:
        rim: seen all round, by enough rays whose depths agree with it, each and all about one place.
        air: around it.
        open: there are openings between rim and hub.
        middle: a hub or spokes are in its middle, and not all of it behind the rim, as the far wall of a pipe is.
        spokes: what is between hub and rim is a few narrow spokes.
        free: a hand fits between it and the floor.
        sharp: its axis is known well enough to turn it.
        aside: what goes in through it may leave it sideways; a pipe's mouth and a bucket have walls there.
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
        """That it is a wheel, all evidence taken together."""
        return self.rim * self.air * self.open * self.middle * self.spokes * self.free * self.sharp * self.aside

    @property
    def solid_confidence(self) -> float:
        """Confidence that it is a solid wheel where some wheel is known to be: openings and spokes do not count."""
        return self.rim * self.air * self.free * self.sharp * self.aside


def weigh_wheel(
    rays: Sightlines,
    ring: Ring,
    passage: Passage,
    hit: Bool[np.ndarray, "N"],
    inside: Inside,
    floor: FloorPlane | None,
) -> WheelEvidence:
    """Return what the rays near a ring say of it."""
    through = rays.length > passage.depth + _BEHIND
    distance = np.linalg.norm(passage.place, axis=1)
    sector = (
        np.floor(np.arctan2(passage.place[:, 1], passage.place[:, 0]) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    )
    inside_rim = passage.level < 0.9
    rim = _shares(sector, inside_rim & hit, inside_rim & (hit | through))
    outer = ring.radius + ring.half_width
    around = (distance > outer + 0.012) & (distance < outer + 0.05)
    # Air: rays that went on, or ended well before or behind the rim's plane.
    solid = around & (np.abs(rays.length - passage.crossing) < _BEHIND)
    air = _shares(sector, around & ~solid, around)
    seen = ~np.isnan(rim)
    if seen.mean() < 0.4:
        return WheelEvidence(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    # What is out of sight speaks neither for nor against the rim, but more than half must be seen.
    complete = float(np.mean(rim[seen] > 0.6) * min(1.0, np.sum(rim[seen] > 0.6) / (0.6 * _SECTORS)))
    airy = float(np.mean(air[~np.isnan(air)] > 0.7)) if (~np.isnan(air)).any() else 0.0
    error = depth_error(rays, passage, hit)
    # The hub of a small wheel fills much of its middle.
    hub_share = min(0.4, (_LEAST_HUB / max(MIDDLE * (ring.radius - ring.half_width), _LEAST_HUB)) ** 2)
    return WheelEvidence(
        rising(complete, 0.55, 0.9)
        * rising(-ring.half_width / ring.radius, *_SLENDER)
        # Much deeper along the axis than wide is the wall of a tube that is seen from its end.
        * rising(-ring.half_depth / ring.half_width, -4.0, -2.5)
        * rising(-error, *_AGREE)
        * rising(-unevenness(rays, passage, hit & inside_rim), *_EVEN)
        * rising(float(hit.sum()), 15.0, 60.0),
        rising(airy, 0.45, 0.85),
        _openings(inside, error / outer),
        rising(inside.middle_share, 0.05 + 0.5 * hub_share, 0.15 + hub_share)
        * rising(float(inside.n_middle), 1.0, 5.0)
        * rising(inside.depth[1], *_AT_RIM),
        _spoke_evidence(inside),
        _over_floor(ring, floor),
        max(_BLURRED, rising(-axis_error(rays, ring, passage), -_BLUNT, -_SHARP)),
        _free_aside(rays, ring),
    )


def _openings(inside: Inside, blur: float) -> float:
    """Return whether there are openings, and the clearer ones the less the depths tell.

    Where depths disagree by a good part of the radius, any lump as large would fit the rim as well: then it is by its
    openings alone that a wheel is told from it.

    Args:
        inside: of the rim.
        blur: disagreement of the depths over the outer radius.
    """
    enough = _OPEN + _OPEN_BLURRED * max(0.0, blur - _SHARPLY)
    return rising(inside.open_share, 0.25 * enough, enough)


def _spoke_evidence(inside: Inside) -> float:
    """Weigh narrow spokes between hub and rim; with few rays, a hub with openings about it counts.

    Things close behind the wheel hide openings, so that neither what the spokes leave unexplained nor their number
    speaks against them; one broad solid part does.
    """
    n_spokes = len(inside.spoke_angles)
    narrow = rising(-inside.widest_spoke, -1.8, -1.2)
    if inside.spokes_known and n_spokes >= 2:
        return narrow * (1.0 if n_spokes <= _MOST_SPOKES else _MANY_SPOKES)
    has_hub = rising(float(inside.n_middle), 5.0, 15.0) * rising(inside.open_share, 0.04, 0.12)
    return narrow * (_UNKNOWN + _HUB_SEEN * has_hub if inside.hub_radius > 0.0 else _NO_HUB)


def _over_floor(ring: Ring, floor: FloorPlane | None) -> float:
    """Return whether a hand fits between rim and floor: what stands on the floor rolls, or lies about."""
    if floor is None:
        return 1.0
    droop = np.sqrt(max(0.0, 1.0 - float(ring.axis @ floor.normal) ** 2))
    lowest = float(floor.above(ring.centre)) - (ring.radius + ring.half_width) * droop - ring.half_depth * (1.0 - droop)
    return rising(lowest, _HAND - 0.015, _HAND + 0.035)


def _free_aside(rays: Sightlines, ring: Ring) -> float:
    """Return whether rays through the disc leave behind the rim; too few rays count as free.

    A ray leaves the tube that the rim would be the mouth of where it is as far from the axis as the rim for the
    second time.
    """
    basis = ring.basis
    start, way = (rays.start - ring.centre) @ basis.T, rays.direction @ basis.T
    speed = np.maximum((way[:, :2] ** 2).sum(axis=1), 1e-9)
    nearest = -(start[:, :2] * way[:, :2]).sum(axis=1) / speed
    square = nearest**2 - ((start[:, :2] ** 2).sum(axis=1) - ring.radius**2) / speed
    leaves = nearest + np.sqrt(np.maximum(square, 0.0))
    # A ring fitted to the wall of a tube is deep: where it ends behind does not count.
    deep = min(ring.half_depth, _USUAL_DEPTH)
    behind_there, behind_end = (-(start[:, 2] + t * way[:, 2]) - deep for t in (leaves, rays.length))
    goes_in = (square > 0.0) & (behind_end > _ASIDE[0] - 0.005)
    counted = goes_in & (behind_there > _ASIDE[0]) & (behind_there < _ASIDE[1])
    n_out = float((rays.length[counted] > leaves[counted] + _WALL).sum())
    return rising((n_out + _LENIENT) / (float(counted.sum()) + _LENIENT), _ENCLOSED, _FREE_ASIDE)


def _shares(sector: np.ndarray, these: Bool[np.ndarray, "N"], all_of: Bool[np.ndarray, "N"]) -> Float[np.ndarray, "S"]:
    """Return the share per sector; NaN where there is nothing."""
    total = np.bincount(sector[all_of], minlength=_SECTORS).astype(float)
    total[total == 0.0] = np.nan
    return np.asarray(np.bincount(sector[these], minlength=_SECTORS) / total)
