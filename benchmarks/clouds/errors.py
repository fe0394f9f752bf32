"""Comparison of detections with the truth: matching, errors and targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception import CONFIDENT
from perception import Detection as Found
from perception.simulate.scenes import Truth

GATE = 0.3  # [m] a detection further from an object is not of that object
LOOKALIKE_GATE = 0.15  # [m]


@dataclass(frozen=True)
class Measure:
    """One error of a kind.

    Attributes:
        name: with its unit.
        of: returns the error, or None if the truth or the detection does not have it.
        target: the largest error on a dense scan; twice that on a sparse one; None: none is set.
        right: the largest error of a hit that counts as right: one that a person would call the same object.
    """

    name: str
    of: Callable[[Found, Truth], float | None]
    target: float | None = None
    right: float = np.inf


def distance(found: Found, truth: Truth) -> float:
    """Return the distance between the origins [mm]."""
    return 1e3 * float(np.linalg.norm(found.pose_world_object[:3, 3] - truth.pose_world_object[:3, 3]))


def axis(column: int, *, signed: bool) -> Callable[[Found, Truth], float | None]:
    """Return the angle between the same axis of both [deg]; unsigned if a turn by 180 degrees changes nothing."""

    def angle(found: Found, truth: Truth) -> float | None:
        cosine = float(found.pose_world_object[:3, column] @ truth.pose_world_object[:3, column])
        return float(np.degrees(np.arccos(np.clip(cosine if signed else abs(cosine), -1.0, 1.0))))

    return angle


def size(name: str, scale: float = 1e3) -> Callable[[Found, Truth], float | None]:
    """Return the difference of a size, in millimetres unless scaled otherwise."""

    def difference(found: Found, truth: Truth) -> float | None:
        if name not in found.sizes or name not in truth.sizes:
            return None
        return scale * abs(found.sizes[name] - truth.sizes[name])

    return difference


def either(first: str, second: str) -> Callable[[Found, Truth], float | None]:
    """Return the difference of the first size, or of the second if the object has no first [mm]."""

    def difference(found: Found, truth: Truth) -> float | None:
        name = first if first in truth.sizes else second
        return size(name)(found, truth) if name in found.sizes else np.inf

    return difference


def _leaf_offset(found: Found, truth: Truth) -> float | None:
    """Return the distance of the true leaf's middle from the detected leaf's plane [mm]."""
    middle = truth.pose_world_object @ [0.5 * truth.sizes["width"], 0.0, 1.0, 1.0]
    return 1e3 * abs(float((middle[:3] - found.pose_world_object[:3, 3]) @ found.pose_world_object[:3, 1]))


def _handle(found: Found, truth: Truth) -> float | None:
    """Return the distance between the handles in the world [mm]."""
    places = []
    for one in (found, truth):
        if "handle_x" not in one.sizes:
            return np.inf if one is found else None
        places.append(one.pose_world_object @ [*(one.sizes[f"handle_{letter}"] for letter in "xyz"), 1.0])
    return 1e3 * float(np.linalg.norm((places[0] - places[1])[:3]))


def _hinge(found: Found, truth: Truth) -> float | None:
    """Count the wrong ones of hinge side and lever direction."""
    turned = found.pose_world_object[:3, 0] @ truth.pose_world_object[:3, 0] < 0.0
    lever = found.sizes.get("lever_direction") != truth.sizes["lever_direction"]
    return float(turned) + float(lever)


def _buttons(found: Found, truth: Truth) -> float | None:
    """Return the largest distance of a button from the detected ones [mm]; infinite if their number differs."""
    places = [_button_places(one) for one in (found, truth)]
    if len(places[0]) != len(places[1]):
        return np.inf
    apart = np.linalg.norm(places[0][:, None] - places[1][None, :], axis=-1)
    return 1e3 * float(apart.min(axis=0).max())


def _button_places(one: Found | Truth) -> Float[np.ndarray, "B 3"]:
    n = int(one.sizes.get("n_buttons", 0))
    local = [[one.sizes[f"button_{i}_x"], one.sizes[f"button_{i}_y"], 0.0, 1.0] for i in range(n)]
    return np.asarray((np.array(local).reshape(-1, 4) @ one.pose_world_object.T)[:, :3])


MEASURES: Mapping[str, tuple[Measure, ...]] = {
    "valve": (
        Measure("centre mm", distance, 10.0, right=30.0),
        Measure("axis deg", axis(2, signed=False), 2.0, right=8.0),
        Measure("radius mm", either("outer_radius", "lever_length"), 5.0, right=20.0),
    ),
    "door": (
        Measure("normal deg", axis(1, signed=False), 1.0, right=5.0),
        Measure("offset mm", _leaf_offset, 5.0, right=25.0),
        Measure("handle mm", _handle, 20.0, right=80.0),
        Measure("width mm", size("width"), right=80.0),
        Measure("ajar deg", size("ajar", float(np.degrees(1.0))), right=8.0),
        Measure("sides wrong", _hinge, right=0.5),
    ),
    "lever": (
        Measure("pivot mm", distance, right=40.0),
        Measure("axis deg", axis(2, signed=False), right=15.0),
        Measure("along deg", axis(0, signed=True), right=15.0),
        Measure("length mm", size("length"), right=50.0),
    ),
    "panel": (
        Measure("centre mm", distance, right=40.0),
        Measure("normal deg", axis(2, signed=False), right=8.0),
        Measure("width mm", size("width"), right=40.0),
        Measure("height mm", size("height"), right=40.0),
        Measure("buttons mm", _buttons, right=30.0),
    ),
    "drill": (
        Measure("grip mm", distance, right=40.0),
        Measure("up deg", axis(2, signed=True), right=15.0),
        Measure("chuck deg", axis(0, signed=True), right=30.0),
    ),
    "beam": (
        Measure("centre mm", distance, right=100.0),
        Measure("along deg", axis(0, signed=False), 5.0, right=6.0),
        Measure("length mm", size("length"), 50.0, right=200.0),
        Measure("width mm", size("width"), right=30.0),
        Measure("thickness mm", size("thickness"), right=30.0),
    ),
    "hose": (
        Measure("centre mm", distance, right=30.0),
        Measure("axis deg", axis(2, signed=True), right=15.0),
        Measure("radius mm", size("radius"), right=12.0),
    ),
    "seat": (
        Measure("top mm", distance, right=120.0),
        Measure("forward deg", axis(0, signed=True), right=25.0),
        Measure("height mm", size("height"), right=80.0),
        Measure("width mm", size("width"), right=150.0),
        Measure("depth mm", size("depth"), right=150.0),
    ),
    "opening": (
        Measure("sill mm", distance, right=200.0),
        Measure("out deg", axis(0, signed=True), right=20.0),
        Measure("width mm", size("width"), right=200.0),
        Measure("height mm", size("height"), right=200.0),
        Measure("sill height mm", size("sill"), right=120.0),
    ),
}


@dataclass(frozen=True)
class Outcome:
    """Matches of the objects of one kind in one scan.

    Attributes:
        pairs: every true object with its detection, None if there is none.
        false: confident detections without an object.
    """

    pairs: tuple[tuple[Truth, Found | None], ...]
    false: tuple[Found, ...]


def matched(
    kind: str,
    found: Sequence[Found],
    truth: Sequence[Truth],
    lookalikes: Sequence[tuple[str, Float[np.ndarray, "K 3"]]],
) -> Outcome:
    """Match each detection, best first, to the nearest object left within :data:`GATE`.

    A further detection of an object that has one already counts as false when it is confident.
    """
    left = [one for one in truth if one.kind == kind]
    pairs: dict[int, Found] = {}
    false = []
    for one in sorted(found, key=lambda detection: -detection.confidence):
        place = one.pose_world_object[:3, 3]
        apart = [_apart(one, other) for other in left]
        free = [k for k in range(len(left)) if k not in pairs and apart[k] < GATE]
        if free:
            pairs[min(free, key=lambda k: apart[k])] = one
        elif one.confidence >= CONFIDENT and not _is_lookalike(kind, place, lookalikes):
            false.append(one)
    return Outcome(tuple((one, pairs.get(k)) for k, one in enumerate(left)), tuple(false))


def _apart(found: Found, truth: Truth) -> float:
    """Return the distance between the origins [m]; for doors, the smaller one of hinge and free edge."""
    apart = distance(found, truth) / 1e3
    if truth.kind != "door":
        return apart
    ends = [one.pose_world_object @ [one.sizes.get("width", 0.9), 0.0, 0.0, 1.0] for one in (found, truth)]
    origin = [one.pose_world_object[:, 3] for one in (found, truth)]
    swapped = np.linalg.norm(ends[0] - origin[1]) + np.linalg.norm(ends[1] - origin[0])
    return float(min(apart, np.linalg.norm(ends[0] - ends[1]), 0.5 * swapped))


def _is_lookalike(
    kind: str, place: Float[np.ndarray, "3"], lookalikes: Sequence[tuple[str, Float[np.ndarray, "K 3"]]]
) -> bool:
    return any(
        one == kind and bool((np.linalg.norm(places - place, axis=1) < LOOKALIKE_GATE).any())
        for one, places in lookalikes
    )


def errors(kind: str, found: Found, truth: Truth) -> tuple[float | None, ...]:
    """Return the errors named in :data:`MEASURES`."""
    return tuple(measure.of(found, truth) for measure in MEASURES[kind])


def misses_target(kind: str, values: Sequence[float | None], density: str) -> bool:
    """Whether an error is beyond its target, or twice that on a sparse scan."""
    allowed = 2.0 if density == "sparse" else 1.0
    return any(
        value is not None and measure.target is not None and value > allowed * measure.target
        for measure, value in zip(MEASURES[kind], values, strict=True)
    )


def is_right(kind: str, values: Sequence[float | None], truth_mm: float = 0.0) -> bool:
    """Whether all errors of a hit are small enough for it to be the object; unknown errors do not count.

    Args:
        truth_mm: error of the truth itself, by which a hit's place and lengths may be farther off.
    """
    return all(
        value is None or value <= measure.right + truth_mm * measure.name.endswith(" mm")
        for measure, value in zip(MEASURES[kind], values, strict=True)
    )


def is_lookalike(found: Found, lookalikes: Sequence[tuple[str, Float[np.ndarray, "K 3"]]]) -> bool:
    """Whether a hit lies on an object that counts neither as a hit nor as an error of its kind."""
    return _is_lookalike(found.kind, found.pose_world_object[:3, 3], lookalikes)
