"""Detection of wheel valves: circle hypotheses, rims fitted to the rays and rated; steering wheels rated down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from perception.cleaning.clean import voxel_downsample
from perception.cloud import Cloud
from perception.detect.shared.detection import Detection
from perception.detect.valve.bodies import ValveDetection
from perception.detect.valve.circles import Circle, find_circles
from perception.detect.valve.evidence import WheelEvidence, weigh_wheel
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.inside import Inside, look_inside
from perception.detect.valve.ring import (
    CLOSE,
    Ring,
    depth_error,
    fit_ring,
    pass_ring,
    rim_hits,
    rough_gate,
)
from perception.detect.vehicle.seat import Seat, find_seats
from perception.ground.floor import FloorPlane
from perception.sightlines import SightIndex, Sightlines, index_of
from perception.view import View, make_view

_VOXEL = 0.015
_HINT_RADIUS = 0.5
_BEHIND = 0.05
_REPORTED = 0.05
_EXAMINED = 12
_SURE = 0.8
_SOLID = 0.8
_STEERING = 0.2
_HOPELESS = 0.005
_MOST_RAYS = 4000
_WIDER, _BESIDE, _JUST_BESIDE = 1.15, 0.07, 0.03
_MOST_COARSE = 60_000
_RADII = (0.13, 0.28)
# Region of a steering wheel from the middle of the cushion's top: forward, to either side, up [m].
_AHEAD, _ASIDE, _UP = (0.2, 0.75), 0.25, (0.1, 0.65)
_FACING, _SIDEWAYS = 0.3, 0.35
_SURE_SEAT = 0.5


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
    return find_wheels(make_view(cloud), hint)


def find_wheels(
    view: View, hint: Float[np.ndarray, "3"] | None = None, foreground: Foreground | None = None
) -> list[ValveDetection]:
    """Find wheel valves as :func:`detect_valves` does; the foreground is computed when none is given."""
    if not len(view.obstacles):
        return []
    foreground = foreground or Foreground.of(view)
    index, rng = foreground.index, foreground.generator()
    candidates, _ = voxel_downsample(foreground.near(hint, _HINT_RADIUS), _VOXEL)
    # Many small fits: with several threads BLAS spends seven times as long on distributing them.
    with threadpool_limits(limits=1, user_api="blas"):
        circles = find_circles(candidates, rng)
        some = index_of(index.rays.thin(_MOST_COARSE))
        # Hubs are circles too: of two equally good circles, the larger one comes first.
        circles.sort(key=lambda circle: -circle.score * _promise(circle, some) * np.sqrt(circle.radius))
        detections = _examine_circles(circles, index, view.floor, hint is not None)
    if hint is None:
        detections = _doubt_steering(detections, view)
    detections = [d for d in detections if d.confidence >= _REPORTED]
    detections.sort(key=lambda d: -d.confidence)
    return _drop_duplicates(detections)


def _examine_circles(
    circles: list[Circle], index: SightIndex, floor: FloorPlane | None, is_hinted: bool
) -> list[ValveDetection]:
    """Return wheels fitted to the first circles, without circles centred in the disc of a sure wheel."""
    valves: list[ValveDetection] = []
    n_examined = 0
    for circle in circles:
        if n_examined == _EXAMINED:
            break
        sure = [valve for valve in valves if valve.confidence > _SURE]
        if any(np.linalg.norm(circle.centre - valve.centre) < valve.outer_radius for valve in sure):
            continue
        valves.append(_examine(circle, index, floor, is_hinted))
        n_examined += 1
    return valves


def _doubt_steering(detections: list[ValveDetection], view: View) -> list[ValveDetection]:
    """Return the detections, with lower confidence for steering wheels of vehicles."""
    if not any(valve.confidence > _STEERING and could_steer(valve.ring) for valve in detections):
        return detections
    seats = find_seats(view)
    return [
        replace(valve, confidence=_STEERING * valve.confidence)
        if could_steer(valve.ring) and steers(valve.ring, seats)
        else valve
        for valve in detections
    ]


def _promise(circle: Circle, index: SightIndex) -> float:
    """Return the share of rays that end on the circle, less the share just outside, 0 to 1; a rough circle is fine."""
    near = index.passing(circle.centre[None], circle.radius + 0.09).thin(_MOST_RAYS)
    passage = pass_ring(near, Ring(circle.centre, circle.axis, circle.radius, 0.02, 0.02))
    behind = near.length - passage.crossing
    known = behind > -_BEHIND
    solid = np.abs(behind) < _BEHIND
    distance = np.linalg.norm(passage.place, axis=1) - circle.radius
    band = float(np.clip(0.12 * circle.radius, 0.01, 0.02))
    rim, around = known & (np.abs(distance) < band), known & (distance > 0.045) & (distance < 0.08)
    if not rim.any() or not around.any():
        return 0.0
    return float(max(0.0, solid[rim].mean() - solid[around].mean()))


def _drop_duplicates(detections: list[ValveDetection]) -> list[ValveDetection]:
    """Drop wheels centred in the disc of a surer one: rings about its hub or spokes are the same wheel."""
    kept: list[ValveDetection] = []
    for valve in detections:
        if all(np.linalg.norm(valve.centre - other.centre) > other.outer_radius for other in kept):
            kept.append(valve)
    return kept


@dataclass(frozen=True)
class _Weighed:
    """Ring with its inside, its evidence, and the depth error and number of its hits."""

    ring: Ring
    inside: Inside
    evidence: WheelEvidence
    rms: float
    n_hits: int


def _examine(circle: Circle, index: SightIndex, floor: FloorPlane | None, is_hinted: bool) -> ValveDetection:
    """Return the valve at a circle: its rim fitted to the rays and rated."""
    start = Ring(circle.centre, circle.axis, circle.radius, 0.015, 0.012)
    ring = fit_ring(_rays_about(index, start), start, rough_gate(start), n_rounds=1)
    first = _weigh(index, ring, floor)
    # The openings of a small wheel show only when its rim is fitted closely.
    if first.evidence.solid_confidence < _HOPELESS:
        return _as_valve(first, is_hinted)
    # Without the rays further outside, thinning keeps more rays on a small rim.
    ring = fit_ring(_rays_about(index, ring, _JUST_BESIDE), ring, CLOSE, n_rounds=2)
    return _as_valve(_weigh(index, ring, floor), is_hinted)


def _rays_about(index: SightIndex, ring: Ring, beside: float = _BESIDE) -> Sightlines:
    """Return rays through and beside a ring, with space for the ring to move."""
    return index.passing(ring.centre[None], _WIDER * ring.radius + beside).thin(_MOST_RAYS)


def _weigh(index: SightIndex, ring: Ring, floor: FloorPlane | None) -> _Weighed:
    near = _rays_about(index, ring)
    ring = _turn_to_sensor(near, ring)
    passage = pass_ring(near, ring)
    hit = rim_hits(near, ring, passage)
    inside = look_inside(near, ring, passage)
    evidence = weigh_wheel(near, ring, passage, hit, inside, floor)
    return _Weighed(ring, inside, evidence, depth_error(near, passage, hit), int(hit.sum()))


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
        weighed.rms,
        weighed.n_hits,
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
