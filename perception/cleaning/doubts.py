"""Warnings about a cloud's unit and frame, from its coordinates and from the share of points that a crop keeps."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.cleaning.clean import Reach

# A scan of one site spans tens of metres; beyond these limits its unit or frame is wrong [m].
_LARGEST_SPAN = 400.0
_SMALLEST_SPAN = 0.05
_FAR = 50.0
# No scan spans this much in any unit.
_NOWHERE = 1e7
# Share of its height: in a narrower cloud x and y have another unit than z.
_NARROW = 1e-3
_LARGEST_ANGLE = 180.0  # [deg]
# Usual span of a robot's scene, least and most [m].
_SCENE = (0.8, 60.0)
_SMALL_UNITS = {"mm": 0.001, "cm": 0.01, "in": 0.0254, "ft": 0.3048}
_IN_WORDS = {"in": "inches, "}  # "in" alone reads as a preposition
# A crop that keeps less than the first share missed the scene; one that removes more than the second gets a note.
_LEFT_OVER = 0.02
_MOST = 0.5
# Multiples of the reach: a wider cloud may be in a smaller unit; above the second its middle is not the robot.
_WIDE, _TOO_WIDE = 1.5, 10.0
_FEWEST_POINTS = 50
_LAYER = 0.04
# Least height of a sensor above the floor [m].
_SENSOR_ABOVE_FLOOR = 0.05
_FEW = 0.01
# Usual height of a sensor over its floor, least and most, and a height that few have [m].
_SENSOR_HEIGHT, _HIGH = (0.5, 2.5), 3.3


def find_doubts(points: Float[np.ndarray, "N 3"], origin: Float[np.ndarray, "*N 3"]) -> tuple[str, ...]:
    """Return warnings about unit and frame, from the coordinates alone.

    Args:
        points: (N, 3) finite, N >= 1, assumed to be in metres in the world frame.
        origin: (3,) or (N, 3) starts of their rays.
    """
    low, high = np.percentile(points, [1, 99], axis=0)
    span = float((high - low).max())
    notes = []
    if span > _LARGEST_SPAN:
        notes.append(f"the cloud spans {span:.0f} m, as metres are taken as read: {_unit_question(span)}")
    elif 0.0 < span < _SMALLEST_SPAN:
        notes.append(f"the cloud spans only {span:.2g} m: is its unit right?")
    if span <= _LARGEST_SPAN and _are_degrees(low, high):
        flat, height = float((high - low)[:2].max()), float((high - low)[2])
        notes.append(f"x and y span only {flat:.2g} where z spans {height:.2g}: are they degrees? metres are needed")
    elif span <= _LARGEST_SPAN and _is_far(low, high):
        distance = float(np.linalg.norm(np.median(points, axis=0)))
        unit = f", or millimetres (then it is {0.001 * distance:.1f} m)" if distance < 20_000.0 < 1000.0 * span else ""
        notes.append(
            f"the cloud lies {distance:.0f} m from the origin: map coordinates{unit}? give a transform to where the "
            f"robot stands; {shift_to_zero(points)} would bring the cloud's middle over the origin, its floor to zero"
        )
    elif span <= _LARGEST_SPAN:
        notes += _far_sensor(low, high, origin)
    return tuple(notes)


def _far_sensor(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], origin: Float[np.ndarray, "*N 3"]
) -> tuple[str, ...]:
    """Return a note when the rays start farther from the cloud's bounding box than any sensor's range."""
    start = np.median(np.atleast_2d(origin), axis=0)
    distance = float(np.linalg.norm(np.maximum(np.maximum(low - start, start - high), 0.0)))
    if distance < _LARGEST_SPAN:
        return ()
    where = ", ".join(f"{value:g}" for value in np.round(start, 2) + 0.0)
    return (
        f"rays start at ({where}), {distance:.0f} m away from the points: is the sensor's position in their unit and "
        "frame? what counts as free, and what is found, depends on it",
    )


def _are_degrees(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> bool:
    """Return whether a cloud is so narrow for its height that x and y look like longitude and latitude."""
    flat, height = float((high - low)[:2].max()), float((high - low)[2])
    largest = float(np.abs([low[:2], high[:2]]).max())
    return 0.0 < flat < _NARROW * height and height > _SMALLEST_SPAN and largest <= _LARGEST_ANGLE


def crop_doubt(points: Float[np.ndarray, "N 3"], n_left: int, reach: Reach, missing: str) -> tuple[str, ...]:
    """Return a note when a crop removed more than half of the points.

    Args:
        missing: what every scene has but the kept points lack; empty when nothing is missing.
    """
    if n_left >= (1.0 - _MOST) * len(points):
        return ()
    share = f"only {n_left} of {len(points)} points ({100.0 * n_left / len(points):.1f} %) lie in reach"
    if n_left >= _LEFT_OVER * len(points) and not missing:
        return (f"{share}; a larger reach would keep more",)
    return (f"{share}{missing and f', and {missing} among them'}: {_why_so_few(points, reach)}",)


def low_sensor_doubt(starts: Float[np.ndarray, "N 3"], lowest: Float[np.ndarray, "N"]) -> tuple[str, ...]:
    """Return a note when rays start on or under the floor, so that the sensor position must be wrong.

    Args:
        lowest: (N,) height of the lowest floor at each start [m].
    """
    is_low = starts[:, 2] - lowest < _SENSOR_ABOVE_FLOOR
    if np.mean(is_low) < _FEW:
        return ()
    where = ", ".join(f"{value:g}" for value in np.round(np.median(starts[is_low], axis=0), 2) + 0.0)
    return (
        f"rays start at ({where}), no higher than the floor, where hardly a sensor was; what counts as free, and what "
        "is found, depends on it: give the sensor's position",
    )


def high_sensor_doubt(starts: Float[np.ndarray, "N 3"], lowest: Float[np.ndarray, "N"]) -> tuple[str, ...]:
    """Return a note when rays start so high above the floor that a smaller unit than metres would explain it.

    Args:
        lowest: (N,) height of the lowest floor at each start [m].
    """
    height = float(np.median(starts[:, 2] - lowest))
    likely = _likely_units(height, *_SENSOR_HEIGHT) if height > _HIGH else ""
    return (f"rays start {height:.1f} m above the floor: is its unit {likely}?",) if likely else ()


def nothing_left(points: Float[np.ndarray, "N 3"], reach: Reach) -> str:
    """Return the message for a crop that kept no point, without repeating ``find_doubts``."""
    low, high = np.percentile(points, [1, 99], axis=0)
    is_told = (high - low).max() > _LARGEST_SPAN or _is_far(low, high)
    centre = ", ".join(f"{value:.1f}" for value in np.median(points, axis=0))
    return (
        f"none of {len(points)} points lie within {reach.radius:g} m of ({reach.x:g}, {reach.y:g}) and between "
        f"{reach.bottom:g} and {reach.top:g} m of height; their middle is ({centre})"
        f"{'' if is_told else f': {_why_so_few(points, reach)}'}"
    )


def shift_to_zero(points: Float[np.ndarray, "N 3"], x: float = 0.0, y: float = 0.0) -> str:
    """Return the transform, as text, that moves a cloud's median to (x, y) and its lowest layer to height zero."""
    middle = np.median(points[:, :2], axis=0) - (x, y)
    heights = points[:, 2]
    bottom = float(np.percentile(heights, 1, method="nearest"))  # a point's height, so that its layer holds one
    lowest = heights[(heights >= bottom - _LAYER) & (heights <= bottom + _LAYER)]
    numbers = [*(f"{-value:.0f}" for value in middle), f"{-np.median(lowest):.2f}"]
    return " ".join(["0" if float(number) == 0.0 else number for number in numbers] + ["0 0 0"])


def _is_far(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> bool:
    """Return whether the world's origin lies so far outside a cloud that the cloud must be in another frame."""
    gap = float(np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)))
    return gap > max(_FAR, float((high - low).max()))


def _why_so_few(points: Float[np.ndarray, "N 3"], reach: Reach) -> str:
    low, high = np.percentile(points, [1, 99], axis=0)
    span = float((high - low).max())
    question = ""
    if span > _WIDE * reach.radius:
        likely = _likely_units(span, 0.5 * reach.radius, 2.0 * _WIDE * reach.radius)
        question = f"they span {span:.3g} m: is its unit {likely}? Else " if likely else ""
    needed = f"{question}metres in the robot's start frame (z up, floor at 0) are needed"
    if span > _TOO_WIDE * reach.radius:  # the robot is not at the middle of such a cloud
        return needed
    return f"{needed}; the transform {shift_to_zero(points, reach.x, reach.y)} would bring their middle into reach"


def _unit_question(span: float) -> str:
    likely = _likely_units(span, *_SCENE)
    if span > _NOWHERE:
        return "is it damaged, or are its bytes in another order?"
    return f"is its unit {likely}?" if likely else "is its unit right?"


def _likely_units(span: float, least: float, most: float) -> str:
    """Return the units in which a span would lie between ``least`` and ``most`` [m]; empty when none fits."""
    likely = [
        f"{unit} ({_IN_WORDS.get(unit, '')}it would be {metres * span:.1f} m)"
        for unit, metres in _SMALL_UNITS.items()
        if least <= metres * span <= most
    ]
    return " or ".join(likely)
