"""Boxes of a handle's size that stand out of a face, rated by the depths at which rays towards them ended."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from costs.stopping import poll
from perception.detect.door.profile import Rays
from perception.detect.door.upright import Upright

REACH = (0.4, 1.7)
JAMB = 0.025
_CELL = 0.01
_STANDOFFS = (0.04, 0.055, 0.07)
HEIGHTS, LONG_SLACK = (0.75, 1.3), 0.15  # of a handle's middle above the floor; more for a long upright one [m]
_DEEPEST = 0.12
_MOST = 3.0  # bound on the vote of one ray [natural log odds]
_BARS = ((0.05, 0.05), *((length, t) for length in (0.08, 0.11, 0.14, 0.18) for t in (0.02, 0.03, 0.05)))
_PANICS = tuple((share, t) for share in (0.45, 0.6, 0.75) for t in (0.03, 0.05))
_PULLS = tuple((t, length) for length in (0.16, 0.25, 0.35, 0.5) for t in (0.02, 0.03, 0.05))
_WENT_ON = 0.06
_LEAST = 6.0


@dataclass(frozen=True)
class DoorFace:
    """A face that may have a handle.

    Attributes:
        low, high: its side edges along the plane [m].
        sigma: standard deviation of its returns from its plane [m].
    """

    plane: Upright
    low: float
    high: float
    ground: float
    sigma: float

    @property
    def width(self) -> float:
        """Distance between the side edges [m]."""
        return self.high - self.low

    def votes(self, depth: Float[np.ndarray, "K"], out: float) -> Float[np.ndarray, "K"]:
        """Return (K,) log odds that rays ending ``depth`` out of the face met an object of standoff ``out``."""
        likelier = out * (2.0 * np.minimum(depth, out + 0.01) - out) / (2.0 * self.sigma**2)
        return np.asarray(np.clip(likelier, -_MOST, _MOST))


@dataclass(frozen=True)
class Towards:
    """Rays towards a plane in front of a face.

    Attributes:
        at: (R, 2) crossing with that plane, along the face and up [m].
        depth: (R,) distance of the ray's end out of the face [m].
        mine: (R,) rays that count as evidence.
    """

    at: Float[np.ndarray, "R 2"]
    depth: Float[np.ndarray, "R"]
    mine: Bool[np.ndarray, "R"]


@dataclass(frozen=True)
class Bump:
    """Box in which an object may stand out of a face.

    Attributes:
        evidence: log odds against the bare face, minus those that noise alone reaches.
        out: standoff of the object [m].
        low, high: (2,) corners of the box along the face and up [m].
        noise: log odds that noise alone reaches on this face.
    """

    evidence: float
    out: float
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    noise: float = 0.0


def rays_towards(rays: Rays, face: DoorFace, out: float) -> Towards:
    """Return the rays towards the plane ``out`` in front of a face [m]."""
    at, end, heading = rays.crossing(face.plane, out)
    depth = end + out
    inside = heading & (at[:, 0] > face.low) & (at[:, 0] < face.high)
    inside &= (at[:, 1] > face.ground + REACH[0]) & (at[:, 1] < face.ground + REACH[1])
    # Rays that stop far before the face or on a jamb in front of its edges are no evidence; a ray that went on behind
    # an open leaf shows that nothing stood out there.
    end_along = rays.ends @ face.plane.along
    inside &= ((end_along > face.low + JAMB) & (end_along < face.high - JAMB)) | (depth < -_WENT_ON)
    return Towards(at, depth, inside & (depth < _DEEPEST))


def find_bumps(face: DoorFace, rays: Rays, prefer: int) -> list[Bump]:
    """Return the best box near each side edge of a face and the best across it, each if its evidence suffices.

    Args:
        prefer: side edge to search (-1 low, 1 high); 0 both.
    """
    best: dict[str, Bump] = {}
    noise = dict.fromkeys(("side", "across"), 0.0)
    for out in _STANDOFFS:
        seen = rays_towards(rays, face, out)
        grid = _sum_votes(face, seen, face.votes(seen.depth, out))
        # No ray ends behind a face, so boxes found in the mirrored depths measure the noise.
        within = seen.mine & (seen.depth > -_WENT_ON)
        mirrored = _sum_votes(face, Towards(seen.at, -seen.depth, within), face.votes(-seen.depth, out))
        for zone in _zones(prefer):
            bump, dent = _best_box(grid, face, zone, out), _best_box(mirrored, face, zone, out)
            if bump is not None and (zone not in best or bump.evidence > best[zone].evidence):
                best[zone] = bump
            if dent is not None:
                noise[_place(zone)] = max(noise[_place(zone)], dent.evidence)
    left = [
        replace(bump, evidence=bump.evidence - noise[_place(zone)], noise=noise[_place(zone)])
        for zone, bump in best.items()
    ]
    return [bump for bump in left if bump.evidence > _LEAST]


def _zones(prefer: int) -> tuple[str, ...]:
    """Return the zones of a face to search for a handle."""
    sides = {-1: ("low",), 1: ("high",), 0: ("low", "high")}[prefer]
    return (*sides, "across")


def _place(zone: str) -> str:
    return "across" if zone == "across" else "side"


def _sum_votes(face: DoorFace, seen: Towards, votes: Float[np.ndarray, "R"]) -> Float[np.ndarray, "U V"]:
    """Return (U, V) sums of votes in 1 cm cells, counted from the face's lower left corner."""
    shape = np.ceil([face.width / _CELL, (REACH[1] - REACH[0]) / _CELL]).astype(int) + 1
    cell = np.floor((seen.at[seen.mine] - [face.low, face.ground + REACH[0]]) / _CELL).astype(int)
    index = np.ravel_multi_index(tuple(cell.T), tuple(shape))
    return np.bincount(index, votes[seen.mine], int(np.prod(shape))).reshape(shape)


def _best_box(grid: Float[np.ndarray, "U V"], face: DoorFace, zone: str, out: float) -> Bump | None:
    """Return the box with the greatest vote sum in a zone; None when no box of a handle's size fits."""
    poll()
    sums = np.pad(np.cumsum(np.cumsum(grid, 0), 1), ((1, 0), (1, 0)))
    best: tuple[float, Float[np.ndarray, "2"], Float[np.ndarray, "2"]] | None = None
    sizes = [(share * face.width, t) for share, t in _PANICS] if zone == "across" else [*_BARS, *_PULLS]
    for size in sizes:
        a, b = round(size[0] / _CELL), round(size[1] / _CELL)
        if a >= grid.shape[0] or b >= grid.shape[1]:
            continue
        total = sums[a:, b:] - sums[:-a, b:] - sums[a:, :-b] + sums[:-a, :-b]
        along = np.arange(total.shape[0]) * _CELL
        middle = (np.arange(total.shape[1]) + 0.5 * b) * _CELL + REACH[0]
        slack = LONG_SLACK if size[1] > 0.1 else 0.0
        fits = (middle > HEIGHTS[0] - slack) & (middle < HEIGHTS[1] + slack)
        # Its outer end lies 2 to 18 cm from a side edge.
        from_low, from_high = along, face.width - along - size[0]
        if zone == "across":
            fits_along = (from_low > 0.03) & (from_high > 0.03)
        else:
            outer = from_low if zone == "low" else from_high
            fits_along = (outer > 0.02) & (outer < 0.18)
        total = np.where(fits_along[:, None] & fits[None, :], total, -np.inf)
        cell = np.unravel_index(int(np.argmax(total)), total.shape)
        value = float(total[cell])
        if np.isfinite(value) and (best is None or value > best[0]):
            best = (value, np.array(cell) * _CELL, np.array(size))
    if best is None:
        return None
    low = best[1] + [face.low, face.ground + REACH[0]]
    high = low + best[2]
    if zone == "across":
        low[0], high[0] = face.low + JAMB, face.high - JAMB
    return Bump(best[0], out, low, high)
