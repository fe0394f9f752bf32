"""Detection of wheel valves: circle hypotheses, rims fitted to the rays and rated; steering wheels rated down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from heapq import heapify, heappop, heappush

import numpy as np
from jaxtyping import Bool, Float, Int
from threadpoolctl import threadpool_limits

from perception.cleaning.clean import voxel_downsample
from perception.cloud import Cloud
from perception.detect.shared.arithmetic import rising
from perception.detect.shared.detection import Detection
from perception.detect.valve.bodies import ValveDetection
from perception.detect.valve.circle_fit import Circle
from perception.detect.valve.circles import find_circles, find_discs
from perception.detect.valve.evidence import RimEvidence, WheelEvidence, weigh_rim, weigh_wheel
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.inside import Inside, look_inside
from perception.detect.valve.ring import (
    CLOSE,
    FINE,
    ROUGH,
    Ring,
    cross_plane,
    fit_ring,
    pass_ring,
    rough_gate,
)
from perception.detect.vehicle.seat import Seat, find_seats
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex, Sightlines, index_of
from perception.view import View, make_view, widen

_VOXEL = 0.015
_HINT_RADIUS = 0.5
_BEHIND = 0.05
_REPORTED = 0.05
_EXAMINED_HERE, _PLACE = 4, 0.3
_HINTED_SEEDS, _HINTED_EXAMINED = 4, 16
_LEAST_PROMISE, _LEAST_QUALITY = 0.25, 0.06
_SECTORS, _COMPLETE = 24, (0.35, 0.75)
# Band of a rim: bins of its edges, how far its edges are searched from a circle, and its greatest half width [m].
_BAND_BIN, _BAND_WITHIN, _WIDEST = 0.006, 0.07, 0.055
_SOLID_INSIDE, _EDGE_BINS = 0.2, 4
_LEFT_OUT = 6  # bins before an edge that are compared with those behind it
_INNER, _NARROW = 0.4, 0.001  # weights of the inner edge's contrast and of each bin of width
_SURE = 0.8
_SOLID = 0.8
_STEERING = 0.2
_HOPELESS = 0.005
_MOST_RAYS, _FEW_RAYS = 4000, 1500
_WIDER, _BESIDE, _JUST_BESIDE = 1.15, 0.07, 0.03
_MOST_COARSE = 50_000
_RADII = (0.13, 0.28)
# Region of a steering wheel from the middle of the cushion's top: forward, to either side, up [m].
_AHEAD, _ASIDE, _UP = (0.2, 0.75), 0.25, (0.1, 0.65)
_FACING, _SIDEWAYS = 0.3, 0.35
_SURE_SEAT = 0.5
# A steering wheel's hub by rim radius, half width of its spokes [m], their number, and its axis over the horizon.
_LARGE_HUB, _BROAD, _STEERING_SPOKES, _STEERING_TILT_DEG = 0.26, 0.014, 4, (10.0, 65.0)


def detect_wheels(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find wheel valves, best first; each with its ``ValveDetection`` as model.

    Frame of a hit: origin the rim's centre, z the axis, x horizontal.
    """
    return [valve.as_detection() for valve in find_wheels(view, hint)]


def detect_valves(
    cloud: Cloud,
    hint: Float[np.ndarray, "3"] | None = None,
) -> list[ValveDetection]:
    """Find wheel valves, best first; act only on a confidence of 0.5 or more.

    Args:
        cloud: the scan; its points within 3 m of the origin are searched.
        hint: (3,) a point near the wheel: only points within half a metre of it are searched, and weaker evidence
            is enough [m].
    """
    return find_wheels(widen(make_view(cloud)), hint)


def find_wheels(
    view: View, hint: Float[np.ndarray, "3"] | None = None, foreground: Foreground | None = None
) -> list[ValveDetection]:
    """Find wheel valves as :func:`detect_valves` does; the foreground is computed when none is given."""
    if not len(view.obstacles):
        return []
    foreground = foreground or Foreground.of(view)
    index = foreground.index
    candidates, _ = voxel_downsample(foreground.near(hint, _HINT_RADIUS), _VOXEL)
    # Many small fits: with several threads BLAS spends seven times as long on distributing them.
    with threadpool_limits(limits=1, user_api="blas"):
        some = index_of(index.rays.thin(_MOST_COARSE))
        circles = find_circles(candidates) if hint is None else find_circles(candidates, _HINTED_SEEDS)
        circles += [] if hint is None else find_discs(candidates, hint)
        detections = _examine_circles(circles, some, index, view.floor, hint is not None)
    if hint is None:
        detections = _doubt_steering(detections, view)
    detections = [d for d in detections if d.confidence >= _REPORTED]
    detections.sort(key=lambda d: -d.confidence)
    return _drop_duplicates(detections)


@dataclass(frozen=True)
class _Start:
    """Rough ring at a circle, to be fitted.

    Attributes:
        promise: share of the rays that end on it less the share of those just outside, 0 to 1.
        score: the circle's score by the points.
    """

    ring: Ring
    promise: float
    score: float

    @property
    def rank(self) -> float:
        """Order of examination; hubs are circles too: of two equally good circles, the larger one comes first."""
        return self.score * self.promise * float(np.sqrt(self.ring.radius))

    @property
    def is_promising(self) -> bool:
        """Whether the ring is worth a fit."""
        return self.promise > _LEAST_PROMISE and self.promise * self.score > _LEAST_QUALITY


def _examine_circles(
    circles: list[Circle], some: SightIndex, index: SightIndex, floor: FloorPlane | None, is_hinted: bool
) -> list[ValveDetection]:
    """Return wheels fitted at the best circles about each place, without those centred in the disc of a sure wheel.

    A ring begins at a circle only when no circle that may rank higher is left: most circles are in places examined by
    then.

    Args:
        some: index of a part of the rays, enough to begin rings.
    """
    valves: list[ValveDetection] = []
    taken = np.zeros(len(circles), dtype=bool)
    n_examined = np.zeros(len(circles), dtype=np.int64)
    centres = np.array([circle.centre for circle in circles]).reshape(-1, 3)
    queue: list[tuple[float, int, _Start | None]] = [(-_most_rank(circle), i, None) for i, circle in enumerate(circles)]
    heapify(queue)
    while queue:
        _, i, start = heappop(queue)
        if taken[i]:
            continue
        if start is None:
            start = _start_at(circles[i], some)
            if start.is_promising:
                heappush(queue, (-start.rank, i, start))
            continue
        valve = _examine(start.ring, index, floor, is_hinted)
        n_examined += ((centres - centres[i]) ** 2).sum(axis=1) < _PLACE**2
        taken |= n_examined >= (_HINTED_EXAMINED if is_hinted else _EXAMINED_HERE)
        if valve is None:
            continue
        valves.append(valve)
        if valve.confidence > _SURE:
            taken |= ((centres - valve.centre) ** 2).sum(axis=1) < valve.outer_radius**2
    return valves


def _most_rank(circle: Circle) -> float:
    """Return a bound on the rank of the ring that begins at a circle."""
    return circle.score * float(np.sqrt(circle.radius + _BAND_WITHIN + _BAND_BIN))


def _doubt_steering(detections: list[ValveDetection], view: View) -> list[ValveDetection]:
    """Return the detections, with lower confidence for steering wheels of vehicles."""
    if not any(valve.confidence > _STEERING and could_steer(valve.ring) for valve in detections):
        return detections
    seats = find_seats(view)
    return [
        replace(valve, confidence=_STEERING * valve.confidence)
        if could_steer(valve.ring) and (steers(valve.ring, seats) or is_shaped_to_steer(valve))
        else valve
        for valve in detections
    ]


def _start_at(circle: Circle, index: SightIndex) -> _Start:
    """Return the band near a circle in whose rays end, while those just outside go on.

    The circle of a flat rim may lie anywhere between its edges; the rays tell where these are.
    """
    near = index.passing(circle.centre[None], circle.radius + _BAND_WITHIN + 0.09, _FEW_RAYS)
    place, crossing = cross_plane(near, circle.centre, circle.axis)
    behind = near.length - crossing
    known = behind > -_BEHIND
    solid = known & (np.abs(behind) < _BEHIND)
    distance = np.sqrt(place[:, 0] ** 2 + place[:, 1] ** 2)
    n_bins = int((circle.radius + _BAND_WITHIN + 0.09) / _BAND_BIN) + 1
    inside = distance < n_bins * _BAND_BIN
    of_ray = (distance[inside] / _BAND_BIN).astype(np.int64)
    # Bins left of the first are empty, so that edges need no limit.
    total, hits = np.zeros(_LEFT_OUT + n_bins + 1), np.zeros(_LEFT_OUT + n_bins + 1)
    np.cumsum(np.bincount(of_ray, known[inside], n_bins), out=total[_LEFT_OUT + 1 :])
    np.cumsum(np.bincount(of_ray, solid[inside], n_bins), out=hits[_LEFT_OUT + 1 :])

    def share(first: Int[np.ndarray, "K"], last: Int[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
        """Return the share of the rays between two edges that end there; NaN without rays."""
        first, last = first + _LEFT_OUT, last + _LEFT_OUT
        n = total[last] - total[first]
        return np.where(n > 0, (hits[last] - hits[first]) / np.maximum(n, 1), np.nan)

    middle = circle.radius / _BAND_BIN
    reach = _BAND_WITHIN / _BAND_BIN
    edges = np.arange(max(0, int(middle - reach)), int(middle + reach) + 2)
    inner, outer = (grid.ravel() for grid in np.meshgrid(edges, edges, indexing="ij"))
    width = outer - inner
    most = np.clip(0.9 * 0.5 * (inner + outer), 4, 2.0 * _WIDEST / _BAND_BIN)
    fits = (width >= 2) & (width <= most) & (inner < middle + 2.5) & (outer > middle - 2.5)
    inner, outer = inner[fits], outer[fits]
    if not len(inner):
        return _Start(Ring(circle.centre, circle.axis, circle.radius, 0.015, 0.012), 0.0, circle.score)
    on = share(inner, outer)
    contrast = np.nan_to_num(on - share(outer + 1, outer + _LEFT_OUT))
    # The inner edge shows by the openings; a solid wheel has none, and any narrow band at its outer edge will do.
    edge = np.nan_to_num(on - share(inner - _LEFT_OUT, inner - 1))
    best = int(np.argmax(contrast + _INNER * edge - _NARROW * (outer - inner)))
    promise = float(np.clip(contrast[best], 0.0, 1.0))
    if edge[best] < _SOLID_INSIDE:
        inner = np.maximum(inner, outer - _EDGE_BINS)
    band = inside & known & (distance >= inner[best] * _BAND_BIN) & (distance < outer[best] * _BAND_BIN)
    promise *= rising(_complete(place[band], solid[band]), *_COMPLETE)
    radius, half = 0.5 * _BAND_BIN * (inner + outer)[best], 0.5 * _BAND_BIN * (outer - inner)[best]
    return _Start(
        Ring(circle.centre, circle.axis, float(radius), float(max(half, 0.008)), 0.012), promise, circle.score
    )


def _complete(place: Float[np.ndarray, "K 2"], solid: Bool[np.ndarray, "K"]) -> float:
    """Return the share of the sectors with rays in which most rays end on the band; half of them must have rays."""
    sector = np.floor(np.arctan2(place[:, 1], place[:, 0]) / (2.0 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS
    total, hits = np.bincount(sector, minlength=_SECTORS), np.bincount(sector, solid, _SECTORS)
    n_seen = max(float(np.count_nonzero(total)), 0.5 * _SECTORS)
    return float(np.count_nonzero(hits > 0.5 * total)) / n_seen


def _drop_duplicates(detections: list[ValveDetection]) -> list[ValveDetection]:
    """Drop wheels centred in the disc of a surer one: rings about its hub or spokes are the same wheel."""
    kept: list[ValveDetection] = []
    for valve in detections:
        if all(np.linalg.norm(valve.centre - other.centre) > other.outer_radius for other in kept):
            kept.append(valve)
    return kept


@dataclass(frozen=True)
class _Weighed:
    """Ring with its inside and its evidence."""

    ring: Ring
    inside: Inside
    rim: RimEvidence
    evidence: WheelEvidence


def _examine(start: Ring, index: SightIndex, floor: FloorPlane | None, is_hinted: bool) -> ValveDetection | None:
    """Return the valve at a rough ring, its rim fitted to the rays and rated; None: no rim there."""
    ring = fit_ring(_rays_about(index, start), start, rough_gate(start), ROUGH)
    first = _weigh(index, ring, floor)
    if first is None:
        return None
    # The openings of a small wheel show only when its rim is fitted closely.
    if first.evidence.solid_confidence < _HOPELESS:
        return _as_valve(first, is_hinted)
    # Without the rays further outside, thinning keeps more rays on a small rim.
    ring = fit_ring(_rays_about(index, ring, _JUST_BESIDE), ring, CLOSE, FINE)
    second = _weigh(index, ring, floor)
    return None if second is None else _as_valve(second, is_hinted)


def _rays_about(index: SightIndex, ring: Ring, beside: float = _BESIDE) -> Sightlines:
    """Return rays through and beside a ring, with space for the ring to move."""
    return index.passing(ring.centre[None], _WIDER * ring.radius + beside, _MOST_RAYS)


def _weigh(index: SightIndex, ring: Ring, floor: FloorPlane | None) -> _Weighed | None:
    """Return the ring's inside and evidence; None: without evidence for a rim, nothing else counts."""
    near = _rays_about(index, ring)
    ring = _turn_to_sensor(near, ring)
    passage = pass_ring(near, ring)
    rim = weigh_rim(near, ring, passage)
    if rim.rating == 0.0:
        return None
    inside = look_inside(near, ring, passage)
    return _Weighed(ring, inside, rim, weigh_wheel(near, ring, passage, rim, inside, floor))


def _as_valve(weighed: _Weighed, is_hinted: bool) -> ValveDetection:
    ring, inside = weighed.ring, weighed.inside
    return ValveDetection(
        ring.centre,
        ring.axis,
        ring.radius,
        ring.radius + ring.half_width,
        ring.half_width,
        ring.half_depth,
        inside.spoke_angles,
        inside.hub_radius,
        inside.depth,
        _hinted_confidence(weighed.evidence) if is_hinted else weighed.evidence.confidence,
        weighed.rim.rms,
        weighed.rim.n_hits,
        inside.spoke_half_width,
        inside.spoke_share,
    )


def _turn_to_sensor(rays: Sightlines, ring: Ring) -> Ring:
    """Return the ring with its axis towards the starts of most rays."""
    if len(rays) and np.median((rays.start - ring.centre) @ ring.axis) < 0.0:
        return Ring(ring.centre, -ring.axis, ring.radius, ring.half_width, ring.half_depth)
    return ring


def _hinted_confidence(evidence: WheelEvidence) -> float:
    """Return the confidence of a wheel near a hint: higher than without, and solid wheels count too."""
    return float(max(np.sqrt(evidence.confidence), _SOLID * evidence.solid_confidence))


def could_steer(ring: Ring) -> bool:
    """Return whether a ring has the size of a steering wheel."""
    return _RADII[0] < ring.radius + ring.half_width < _RADII[1]


def is_shaped_to_steer(valve: ValveDetection) -> bool:
    """Return whether a ring has the large hub, the few broad spokes and the tilt of a steering wheel.

    The seat before it is often not seen: the sensor's carrier sits on it.
    """
    hub, tilt = valve.hub_radius / valve.rim_radius, float(np.degrees(np.arcsin(np.clip(valve.axis[2], -1.0, 1.0))))
    few = 2 <= len(valve.spoke_angles) <= _STEERING_SPOKES
    broad = valve.spoke_half_width > _BROAD and hub > _LARGE_HUB
    return few and broad and _STEERING_TILT_DEG[0] < tilt < _STEERING_TILT_DEG[1]


def steers(ring: Ring, seats: Sequence[Seat]) -> bool:
    """Return whether a ring lies in front of the chest of a person on one of the seats, and faces that person.

    Only sure seats of vehicles count: a chair in front of a valve is no reason to doubt the valve.
    """
    for seat in seats:
        x, y, z = seat.local(ring.centre[None])[0]
        towards, aside, _ = np.abs(seat.pose[:3, :3].T @ ring.axis)
        is_there = _AHEAD[0] < x < _AHEAD[1] and abs(y) < _ASIDE and _UP[0] < z < _UP[1]
        if seat.confidence >= _SURE_SEAT and is_there and towards > _FACING and aside < _SIDEWAYS:
            return True
    return False
