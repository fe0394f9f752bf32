"""Link shapes of our own for Atlas: hulls of at most 32 vertices, drawn as sections stacked along an axis.

Sizes follow the joint offsets. Links that are not neighbours stay clear of each other over the normal working range.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "V 3"]

_SQUARE = 4
_OCTAGON = 8


def _section(at: float, low_a: float, high_a: float, low_b: float, high_b: float, corners: int, along: str) -> Points:
    """A rectangle (4 corners) or one with its corners cut (8) across the axis ``along``, at height ``at`` on it."""
    mid_a, mid_b = 0.5 * (low_a + high_a), 0.5 * (low_b + high_b)
    half_a, half_b = 0.5 * (high_a - low_a), 0.5 * (high_b - low_b)
    if corners == _SQUARE:
        outline = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    else:
        cut = 0.45
        outline = np.array([[1, cut], [cut, 1], [-cut, 1], [-1, cut], [-1, -cut], [-cut, -1], [cut, -1], [1, -cut]])
    a, b = mid_a + half_a * outline[:, 0], mid_b + half_b * outline[:, 1]
    height = np.full(len(outline), at)
    return np.column_stack({"z": (a, b, height), "y": (a, height, b), "x": (height, a, b)}[along])


def _stack(along: str, *sections: tuple[float, ...], corners: int = _OCTAGON) -> Points:
    """Sections (at, low_a, high_a, low_b, high_b); (a, b) is (x, y) along z, (x, z) along y, (y, z) along x."""
    return np.vstack([_section(*section, corners, along) for section in sections])  # type: ignore[arg-type]


_CENTRE: Mapping[str, tuple[Points, ...]] = {
    "pelvis": (
        _stack(
            "z",
            (0.055, -0.12, 0.12, -0.15, 0.15),
            (0.085, -0.15, 0.15, -0.185, 0.185),
            (0.130, -0.15, 0.15, -0.185, 0.185),
            (0.165, -0.10, 0.10, -0.12, 0.12),
        ),
        _stack(
            "z",
            (-0.10, -0.11, 0.03, -0.02, 0.02),
            (0.00, -0.13, 0.09, -0.030, 0.030),
            (0.08, -0.13, 0.10, -0.035, 0.035),
            corners=_SQUARE,
        ),
    ),
    "mtorso": (_stack("z", (-0.05, -0.075, 0.065, -0.07, 0.07), (0.08, -0.075, 0.065, -0.07, 0.07)),),
    "utorso": (
        _stack(
            "z",
            (0.03, -0.10, 0.08, -0.10, 0.10),
            (0.16, -0.15, 0.15, -0.165, 0.165),
            (0.44, -0.16, 0.20, -0.175, 0.175),
            (0.56, -0.14, 0.13, -0.13, 0.13),
        ),
        _stack(
            "z",
            (0.10, -0.25, -0.14, -0.13, 0.13),
            (0.17, -0.31, -0.14, -0.17, 0.17),
            (0.56, -0.31, -0.14, -0.17, 0.17),
            (0.65, -0.26, -0.02, -0.12, 0.12),
        ),
    ),
    "head": (
        _stack(
            "x",
            (-0.115, -0.05, 0.05, -0.02, 0.13),
            (-0.07, -0.07, 0.07, -0.05, 0.155),
            (0.00, -0.07, 0.07, -0.05, 0.13),
            (0.035, -0.05, 0.05, -0.03, 0.06),
        ),
    ),
}

_LEFT: Mapping[str, tuple[Points, ...]] = {
    "lglut": (
        _stack("z", (-0.085, 0.01, 0.09, -0.04, 0.045), (-0.02, -0.045, 0.075, -0.04, 0.05),
               (0.045, -0.045, 0.045, -0.04, 0.04)),
    ),
    "uleg": (
        _stack("z", (-0.385, -0.095, -0.01, -0.05, 0.05), (-0.25, -0.095, 0.045, -0.062, 0.066),
               (-0.04, -0.085, 0.07, -0.066, 0.075), (0.045, -0.055, 0.05, -0.045, 0.06)),
    ),
    "lleg": (
        _stack("z", (-0.40, -0.035, 0.035, -0.036, 0.036), (-0.15, -0.065, 0.055, -0.055, 0.055),
               (-0.02, -0.05, 0.065, -0.058, 0.058), (0.045, -0.03, 0.05, -0.05, 0.05)),
    ),
    "clav": (
        _stack("z", (-0.20, -0.05, 0.05, -0.05, 0.045), (0.02, -0.055, 0.055, -0.060, 0.050),
               (0.05, -0.035, 0.035, -0.04, 0.03)),
        _stack("y", (-0.05, -0.06, 0.06, -0.295, -0.18), (0.045, -0.065, 0.065, -0.30, -0.19)),
    ),
    "scap": (
        _stack("y", (-0.055, -0.045, 0.045, -0.045, 0.045), (0.00, -0.06, 0.06, -0.06, 0.06),
               (0.09, -0.055, 0.055, -0.062, 0.05), (0.14, -0.045, 0.045, -0.055, 0.035)),
    ),
    "uarm": (
        _stack("y", (-0.05, -0.05, 0.05, -0.05, 0.05), (0.05, -0.058, 0.058, -0.055, 0.055),
               (0.115, -0.05, 0.05, -0.04, 0.055)),
    ),
    "larm": (
        _stack("y", (-0.045, -0.04, 0.04, -0.04, 0.04), (0.00, -0.058, 0.058, -0.052, 0.052),
               (0.095, -0.05, 0.05, -0.055, 0.045)),
    ),
    "ufarm": (
        _stack("y", (-0.205, -0.052, 0.052, -0.052, 0.052), (-0.12, -0.05, 0.05, -0.05, 0.05),
               (-0.055, -0.036, 0.036, -0.036, 0.036)),
    ),
    "lfarm": (
        _stack("y", (-0.045, -0.028, 0.028, -0.028, 0.028), (0.00, -0.042, 0.042, -0.042, 0.042),
               (0.025, -0.036, 0.036, -0.036, 0.036)),
    ),
    "hand": (
        _stack("y", (0.015, -0.036, 0.036, -0.036, 0.036), (0.035, -0.042, 0.042, -0.034, 0.034),
               (0.055, -0.026, 0.026, -0.022, 0.022)),
    ),
}  # fmt: skip


def foot(sole: Points) -> Points:
    """A foot whose lowest face is exactly ``sole`` (4 corners), with a rim, an instep and an ankle above it."""
    rim = sole + np.array([0.0, 0.0, 0.022])
    low, high = sole.min(axis=0), sole.max(axis=0)
    instep = _section(-0.010, -0.06, 0.075, low[1] + 0.018, high[1] - 0.018, _OCTAGON, "z")
    ankle = _section(0.018, -0.04, 0.04, -0.038, 0.038, _SQUARE, "z")
    return np.vstack([sole, rim, instep, ankle])


def link_shapes() -> Mapping[str, tuple[Points, ...]]:
    """Vertices of each link's convex bodies in its own frame [m]; right links mirror left ones; feet apart."""
    mirror = np.array([1.0, -1.0, 1.0])
    shapes = dict(_CENTRE)
    for name, bodies in _LEFT.items():
        shapes[f"l_{name}"] = bodies
        shapes[f"r_{name}"] = tuple(points * mirror for points in bodies)
    return shapes
