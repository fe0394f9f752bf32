"""Rays of a scan at the parts of a valve that a hand presses: rim and spokes of a wheel, bar and grip of a lever."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.shared.bars import Bar
from perception.detect.shared.seen_part import CELL, SeenPart, choose_distance, count_on_bar
from perception.detect.valve.bodies import ValveDetection
from perception.detect.valve.lever_valve import LeverDetection
from perception.sightlines import SightIndex

RIM_CHORDS = 24
_FROM_RIM = 0.01  # of a spoke's end that counts, where rays at the rim are no evidence [m]
_FROM_HUB = 1.1  # hub radii at which a spoke begins
_THINNEST = 1e-3  # half width of a spoke [m]
_ABOUT = 0.04  # along the axis from the rim's plane, where points of a spoke are [m]


def count_on_wheel(wheel: ValveDetection, index: SightIndex) -> tuple[SeenPart, ...]:
    """Count the rays at each spoke, with places along it from the axis, and at the rim, with places in its plane."""
    within = choose_distance(wheel.rms)
    height = _find_height(wheel, index)
    spokes = [
        count_on_bar(f"spoke/{number}", index, _place_spoke(wheel, angle, height), within)
        for number, angle in enumerate(wheel.spoke_angles)
    ]
    return (*spokes, _count_on_rim(wheel, index, within))


def _place_spoke(wheel: ValveDetection, angle: float, height: float) -> Bar:
    """Return the spoke at an angle as a bar, at a height along the axis."""
    first, second, axis = wheel.ring.basis
    along = np.cos(angle) * first + np.sin(angle) * second
    inner, half = wheel.rim_radius - wheel.tube_radius, max(wheel.spoke_half_width, _THINNEST)
    low, high = min(_FROM_HUB * wheel.hub_radius, 0.5 * inner), max(inner - _FROM_RIM, 0.75 * inner)
    frame = np.stack([along, np.cross(axis, along), axis])
    return Bar(frame, wheel.centre + height * axis, (half, half), low, high, "round")


def _find_height(wheel: ValveDetection, index: SightIndex) -> float:
    """Return the height of the spokes' centre lines along the axis, from the rim's centre [m].

    All points on the spokes count together: where one spoke is missing, what stands behind it must not take its place.
    """
    heights = []
    for angle in wheel.spoke_angles:
        bar = _place_spoke(wheel, angle, 0.0)
        near = index.passing(bar.places(CELL), bar.half[0] + _ABOUT)
        local = (near.ends - wheel.centre) @ bar.frame.T
        own = (local[:, 0] > bar.first) & (local[:, 0] < bar.last) & (np.abs(local[:, 1]) < bar.half[0])
        heights.append(local[own & (np.abs(local[:, 2]) < _ABOUT), 2])
    seen = np.concatenate([np.zeros(0), *heights])
    # Points lie on the side of the sensor.
    return float(np.median(seen)) - wheel.spoke_half_width if len(seen) else 0.0


def _count_on_rim(wheel: ValveDetection, index: SightIndex, within: float) -> SeenPart:
    """Count the rays at the rim, chord by chord."""
    parts = []
    for number in range(RIM_CHORDS):
        ends = [wheel.rim_radius * _radial(wheel, 2.0 * np.pi * (number + k) / RIM_CHORDS) for k in (0, 1)]
        way = ends[1] - ends[0]
        frame = np.stack([way / np.linalg.norm(way), np.cross(wheel.axis, way / np.linalg.norm(way)), wheel.axis])
        bar = Bar(
            frame, wheel.centre + ends[0], (wheel.tube_radius, wheel.half_depth), 0.0, float(np.linalg.norm(way)), "box"
        )
        part = count_on_bar("rim", index, bar, within)
        middle = 0.5 * (ends[0] + ends[1]) @ wheel.ring.basis.T
        parts.append(((float(middle[0]), float(middle[1])), sum(part.hits), sum(part.passes)))
    places, hits, passes = zip(*parts, strict=True)
    return SeenPart("rim", places, hits, passes, within)


def _radial(wheel: ValveDetection, angle: float) -> Float[np.ndarray, "3"]:
    first, second, _ = wheel.ring.basis
    return np.asarray(np.cos(angle) * first + np.sin(angle) * second)


def count_on_lever(lever: LeverDetection, index: SightIndex) -> tuple[SeenPart, ...]:
    """Count the rays at a lever's bar, with places from its spindle, and at a crank's grip, from the bar."""
    frame, half = lever.frame, (lever.radius, lever.radius)
    bar = Bar(frame, lever.centre, half, lever.hub_radius, lever.length, "round")
    within = choose_distance(lever.rms)
    parts = [count_on_bar("bar", index, bar, within)]
    if lever.grip_length > 0.0:
        foot = lever.centre + lever.length * lever.direction
        grip = Bar(frame[[2, 0, 1]], foot, (lever.grip_radius,) * 2, lever.radius, lever.grip_length, "round")
        parts.append(count_on_bar("grip", index, grip, within))
    return tuple(parts)
