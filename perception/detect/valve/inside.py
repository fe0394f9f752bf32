"""Inside of a wheel's rim: openings, spokes and hub, from the rays that ended there and those that went on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.valve.ring import CLOSE, Passage, Ring, cross_plane, depth_error, rim_hits
from perception.sightlines import Sightlines

_DEPTH = 0.06
_SPOKE_DEPTH = 0.04
# Depths of a spoke's returns about their median: standard deviations of the rim's, least and most [m].
_SPREAD, _SPREAD_LIMITS = 2.5, (0.015, _SPOKE_DEPTH)
_MOST_THROUGH = 0.5  # share of the rays along a spoke's middle that do not end on it, such as mixed pixels at its edge
_IN_PLANE = 0.012
_CORRIDOR = 0.005
_BESIDE_SPOKE = 0.002  # [m]
_FEWEST_ON_HUB = 2
_STEP_DEG = 2.0
_RESOLVED = 0.7  # of the greatest half width that a spoke may have: returns that reach farther fill the openings
_MOST_APART, _BETWEEN = 3, 0.25
MIDDLE = 0.45  # of the rim's inner radius
_FEWEST = 5


@dataclass(frozen=True)
class Inside:
    """Openings, spokes and hub inside the rim.

    Attributes:
        spoke_angles: of the spokes about the axis [rad].
        spoke_share: share of the returns between hub and rim that lie on the spokes, 0 to 1; 0 where these are not
            resolved.
        spokes_known: whether rays are dense enough between hub and rim to distinguish spokes from openings.
        widest_spoke: angle of the widest solid sector in the rim's plane [rad].
        hub_radius: radius within which rays between the spokes ended on the wheel [m].
        depth: lowest and highest axial position of the returns inside the rim [m].
        open_share: share of the rays inside the rim that went through.
        n_middle: number of rays that ended on the wheel near its middle.
        middle_share: share of the rays near the middle that ended on the wheel.
    """

    spoke_angles: tuple[float, ...]
    spoke_half_width: float
    spoke_share: float
    spokes_known: bool
    widest_spoke: float
    hub_radius: float
    depth: tuple[float, float]
    open_share: float
    n_middle: int
    middle_share: float


@dataclass(frozen=True)
class _Spokes:
    angles: tuple[float, ...] = ()
    half_width: float = 0.0
    share: float = 0.0
    known: bool = False
    widest: float = 0.0


def look_inside(rays: Sightlines, ring: Ring, passage: Passage) -> Inside:
    """Return openings, spokes and hub, from the rays inside the rim that ended on the wheel or went through."""
    distance = np.linalg.norm(passage.place, axis=1)
    inner = ring.radius - ring.half_width
    behind = rays.length - passage.crossing
    solid, through = np.abs(behind) < _DEPTH, behind >= _DEPTH
    known = (distance < inner - 0.004) & (solid | through)
    if known.sum() < _FEWEST or inner <= 0.02:
        return Inside((), 0.0, 0.0, False, 0.0, max(inner, 0.0), (-ring.half_depth, ring.half_depth), 0.0, 0, 0.0)
    at_wheel = known & solid
    depth = (-ring.half_depth, ring.half_depth)
    if at_wheel.any():
        low, high = np.percentile((rays.ends[at_wheel] - ring.centre) @ ring.axis, [4, 96])
        depth = (float(low), float(high))
    hub = _hub_radius(distance[known], solid[known], inner)
    middle = known & (distance < MIDDLE * inner)
    band = known & (distance > max(1.1 * hub, 0.45 * inner))
    spacing = float(np.sqrt(np.pi * inner**2 / known.sum()))
    spread = _SPREAD * depth_error(rays, passage, rim_hits(rays, ring, passage, CLOSE))
    spread = float(np.clip(spread, *_SPREAD_LIMITS))
    spokes = _spokes(passage.place[band], behind[band], max(_CORRIDOR, 0.8 * spacing), spread)
    if not spokes.known:
        # Scan lines may be further apart than the rays along them.
        spokes = _spokes(passage.place[band], behind[band], max(_CORRIDOR, 1.3 * spacing), spread)
    return Inside(
        spokes.angles,
        spokes.half_width,
        spokes.share,
        spokes.known,
        spokes.widest,
        _settle_hub(rays.select(np.flatnonzero(known)), ring, spokes, spread, hub),
        depth,
        float((known & through).sum() / known.sum()),
        int((middle & solid).sum()),
        float((middle & solid).sum() / max(1, middle.sum())),
    )


def _hub_radius(distance: Float[np.ndarray, "N"], solid: Bool[np.ndarray, "N"], inner: float) -> float:
    """Return the largest radius within which four fifths of the rays ended at the wheel."""
    edges = np.linspace(0.0, inner, 13)[1:]
    radius = 0.0
    for low, high in zip(np.concatenate([[0.0], edges[:-1]]), edges, strict=True):
        ring = (distance >= low) & (distance < high)
        if ring.any() and solid[ring].mean() < 0.8:
            break
        radius = float(high)
    return radius


def _settle_hub(rays: Sightlines, ring: Ring, spokes: _Spokes, spread: float, hub: float) -> float:
    """Return the radius that best divides the rays that ended on the hub from those that went by between the spokes.

    Args:
        rays: that end at the wheel or behind it.
        spread: distance from the hub's face within which a ray ended on it [m].
        hub: roughly its radius [m]; stays where few rays are left between the spokes.
    """
    inner = ring.radius - ring.half_width
    place, crossing = cross_plane(rays, ring.centre, ring.axis)
    middle = (np.hypot(*place.T) < 0.8 * hub) & (np.abs(rays.length - crossing) < _DEPTH)
    if middle.sum() < _FEWEST:
        return hub
    # A hub's face stands before the plane of its rim: seen from aside it lies beside the hub there.
    height = float(np.median((rays.ends[middle] - ring.centre) @ ring.axis))
    place, crossing = cross_plane(rays, ring.centre + height * ring.axis, ring.axis)
    distance = np.hypot(*place.T)
    beside = _in_corridors(place, np.array(spokes.angles), spokes.half_width + _BESIDE_SPOKE).any(axis=1)
    # Rays that go inwards may pass the face and end on the hub's side.
    is_outward = np.einsum("ni,ni->n", place, (rays.direction @ ring.basis.T)[:, :2]) >= 0.0
    free = np.flatnonzero(is_outward & ~beside & (distance < 0.5 * (hub + inner)))
    # What stands behind a wheel near its stem ends rays, too, but deeper than the hub.
    is_on = np.abs(rays.length - crossing)[free] < spread
    order = np.argsort(distance[free])
    radii, is_on = distance[free][order], is_on[order]
    if is_on.all():
        return hub
    n_wrong = np.append(is_on.sum(), is_on.sum() - np.cumsum(np.where(is_on, 1, -1)))
    best = np.flatnonzero(n_wrong == n_wrong.min())
    between = np.concatenate([[0.0], radii, radii[-1:]])
    radius = float(np.mean(0.5 * (between[best] + between[best + 1])))
    return radius if is_on[radii < radius].sum() >= _FEWEST_ON_HUB else hub


def _spokes(
    place: Float[np.ndarray, "N 2"], behind: Float[np.ndarray, "N"], corridor_half: float, spread: float
) -> _Spokes:
    """Return the spokes: the angles at which most rays in a narrow radial corridor ended on the wheel.

    Args:
        place: (N, 2) crossings of rays with the rim's plane between hub and rim [m].
        behind: (N,) distance along the ray from that crossing to its end [m].
        corridor_half: half width of the corridor [m].
        spread: distance from the spokes' depth within which a ray ended on a spoke [m].
    """
    angle = np.radians(np.arange(0.0, 360.0, _STEP_DEG))
    corridor = _in_corridors(place, angle, corridor_half)
    total = corridor.sum(axis=0)
    known = bool((total < 2).mean() <= 0.2)
    near = np.abs(behind) < _SPOKE_DEPTH
    if not known or not near.any():
        return _Spokes(known=known)
    share = corridor[near].sum(axis=0) / np.maximum(total, 1)
    on_some = near & corridor[:, share > 0.4].any(axis=1)
    # Mixed pixels and what stands behind the wheel end at other depths than its spokes.
    middle = float(np.median(behind[on_some])) if on_some.any() else 0.0
    solid = near & (np.abs(behind - middle) < spread)
    hits = corridor[solid].sum(axis=0)
    share = hits / np.maximum(total, 1)
    # One or two mixed pixels are not a spoke.
    is_spoke = (share > 0.4) & (hits >= 3)
    if is_spoke.all() or not is_spoke.any():
        return _Spokes(known=True, widest=2.0 * np.pi * float(is_spoke.all()))
    runs, start = _runs(is_spoke)
    # Solid parts off the rim's plane, such as the end of a stem or the body below it, are not part of the wheel.
    depth = corridor[solid].T @ behind[solid] / np.maximum(hits, 1)
    in_plane, _ = _runs(is_spoke & (np.abs(depth) < _IN_PLANE))
    widest = float(np.radians(_STEP_DEG) * (in_plane[:, 1] - in_plane[:, 0]).max(initial=0))
    angles = []
    for low, high in _rejoin(runs, np.roll(share, -start)):
        mine = (np.arange(low, high) + start) % len(angle)
        mine = mine[is_spoke[mine]]
        centre = np.sum(share[mine] * np.exp(1j * angle[mine]))
        angles.append(float(np.angle(centre) % (2.0 * np.pi)))
    lines = np.array(angles)
    lines = lines[_are_met(_in_corridors(place, lines, corridor_half), solid)]
    if not len(lines):
        return _Spokes(known=True, widest=widest)
    distance = np.abs(place[solid] @ np.stack([-np.sin(lines), np.cos(lines)]))
    distance[place[solid] @ np.stack([np.cos(lines), np.sin(lines)]) <= 0.0] = np.inf
    nearest = distance.min(axis=1)
    widest_half = 2.0 * corridor_half + 0.01
    explained = nearest < widest_half
    half = float(np.percentile(nearest[explained], 90)) if explained.any() else 0.0
    # Returns everywhere between hub and rim resolve no spokes.
    share = float(explained.mean()) if half < _RESOLVED * widest_half else 0.0
    return _Spokes(tuple(sorted(lines.tolist())), half, share, True, widest)


def _in_corridors(
    place: Float[np.ndarray, "N 2"], angle: Float[np.ndarray, "A"], half: float
) -> Bool[np.ndarray, "N A"]:
    """Return which places lie in the radial corridor at each angle."""
    along = place @ np.stack([np.cos(angle), np.sin(angle)])
    return np.asarray((along > 0.0) & (np.abs(place @ np.stack([-np.sin(angle), np.cos(angle)])) < half))


def _are_met(corridor: Bool[np.ndarray, "N A"], solid: Bool[np.ndarray, "N"]) -> Bool[np.ndarray, "A"]:
    """Return at which angles most of the rays along the middle of a spoke ended on it."""
    hits, total = corridor[solid].sum(axis=0), corridor.sum(axis=0)
    return np.asarray((hits >= 3) & (hits > (1.0 - _MOST_THROUGH) * total))


def _runs(these: Bool[np.ndarray, "A"]) -> tuple[Int[np.ndarray, "R 2"], int]:
    """Return (R, 2) begin and end of each run, counted from an index in no run, and that index."""
    start = int(np.flatnonzero(~these)[0])
    turned = np.concatenate([[0], np.roll(these, -start).astype(int), [0]])
    return np.flatnonzero(np.diff(turned)).reshape(-1, 2), start


def _rejoin(runs: Int[np.ndarray, "R 2"], share: Float[np.ndarray, "A"]) -> list[tuple[int, int]]:
    """Return runs of angles, joined across gaps of at most three steps that all hold some hits."""
    joined: list[tuple[int, int]] = []
    for low, high in runs.tolist():
        if joined and low - joined[-1][1] <= _MOST_APART and share[joined[-1][1] : low].min() > _BETWEEN:
            joined[-1] = (joined[-1][0], high)
        else:
            joined.append((low, high))
    return joined
