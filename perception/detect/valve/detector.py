"""Detection of valves of either kind: wheels and levers."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.shared.detection import CONFIDENT, Detection
from perception.detect.valve.foreground import Foreground
from perception.detect.valve.lever import detect_lever_valve
from perception.detect.valve.wheel import find_wheels
from perception.view import View

_SURE = 0.8  # with a hint, which makes weak evidence enough
_BESIDE = 0.05


def detect_valve(view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find valves, best first: those with ``outer_radius`` are wheels, those with ``lever_length`` are levers."""
    if not len(view.obstacles):
        return []
    foreground = Foreground.of(view)
    wheels = [valve.as_detection() for valve in find_wheels(view, hint, foreground)]
    sure = [wheel for wheel in wheels if wheel.confidence >= (CONFIDENT if hint is None else _SURE)]
    # Spokes and pieces of a rim are slim bars as well, and what is about a lever has round edges.
    levers = [
        lever
        for lever in detect_lever_valve(view, hint, foreground)
        if not any(_is_part_of(lever, wheel) for wheel in sure)
    ]
    others = [wheel for wheel in wheels if not any(_is_about(wheel, lever) for lever in levers)]
    return sorted([*others, *levers], key=lambda hit: -hit.confidence)


def _is_part_of(lever: Detection, wheel: Detection) -> bool:
    apart = np.linalg.norm(lever.pose_world_object[:3, 3] - wheel.pose_world_object[:3, 3])
    return bool(apart < wheel.sizes["outer_radius"] + _BESIDE)


def _is_about(wheel: Detection, lever: Detection) -> bool:
    """Return whether a wheel less sure than a lever lies over it."""
    pose, length = lever.pose_world_object, lever.sizes["lever_length"]
    offset = wheel.pose_world_object[:3, 3] - pose[:3, 3]
    along = float(np.clip(offset @ pose[:3, 0], 0.0, length))
    apart = float(np.linalg.norm(offset - along * pose[:3, 0]))
    return wheel.confidence < lever.confidence and apart < wheel.sizes["outer_radius"] + _BESIDE
