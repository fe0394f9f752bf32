"""Link shapes of our own for Atlas: hulls of at most 32 vertices, drawn as sections stacked along an axis.

Sizes follow the joint offsets. Links that are not neighbours stay clear of each other over the normal working range.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "V 3"]

Outline = tuple[float, float, float, float, float]

_SQUARE = 4
_OCTAGON = 8


def _section(outline: Outline, corners: int, along: str) -> Points:
    """Make a rectangle (4 corners) or one with its corners cut (8) across the axis ``along``.

    ``outline`` is (at, low_a, high_a, low_b, high_b): place on the axis and extents across it [m]; (a, b) is (x, y)
    along z, (x, z) along y, (y, z) along x.
    """
    at, low_a, high_a, low_b, high_b = outline
    mid_a, mid_b = 0.5 * (low_a + high_a), 0.5 * (low_b + high_b)
    half_a, half_b = 0.5 * (high_a - low_a), 0.5 * (high_b - low_b)
    if corners == _SQUARE:
        corner = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    else:
        cut = 0.45
        corner = np.array([[1, cut], [cut, 1], [-cut, 1], [-1, cut], [-1, -cut], [-cut, -1], [cut, -1], [1, -cut]])
    a, b = mid_a + half_a * corner[:, 0], mid_b + half_b * corner[:, 1]
    height = np.full(len(corner), at)
    return np.column_stack({"z": (a, b, height), "y": (a, height, b), "x": (height, a, b)}[along])


def _stack(along: str, *sections: Outline, corners: int = _OCTAGON) -> Points:
    """Stack sections along an axis and return their vertices."""
    return np.vstack([_section(section, corners, along) for section in sections])


# fmt: off
_CENTRE: Mapping[str, tuple[Points, ...]] = {
    "pelvis": (
        # Waist above the hips, and the block between the thighs.
        _stack("z", (0.055, -0.13, 0.12, -0.150, 0.150), (0.080, -0.15, 0.14, -0.180, 0.180),
               (0.130, -0.14, 0.13, -0.170, 0.170), (0.165, -0.10, 0.09, -0.110, 0.110)),
        _stack("z", (-0.095, -0.10, 0.02, -0.014, 0.014), (-0.02, -0.12, 0.07, -0.020, 0.020),
               (0.08, -0.12, 0.09, -0.025, 0.025), corners=_SQUARE),
    ),
    # Inside the pelvis, up to the pitch axis of the back; pelvis and mtorso overlap around it in every pose.
    "ltorso": (_stack("z", (0.085, -0.080, 0.080, -0.080, 0.080), (0.125, -0.080, 0.080, -0.080, 0.080),
                      (0.165, -0.055, 0.055, -0.060, 0.060)),),
    "mtorso": (_stack("z", (-0.05, -0.075, 0.065, -0.07, 0.07), (0.08, -0.075, 0.065, -0.07, 0.07)),),
    "utorso": (
        # Chest, backpack, neck.
        _stack("z", (0.03, -0.11, 0.09, -0.105, 0.105), (0.14, -0.15, 0.15, -0.165, 0.165),
               (0.42, -0.16, 0.21, -0.180, 0.180), (0.58, -0.14, 0.14, -0.150, 0.150)),
        _stack("z", (0.10, -0.26, -0.14, -0.13, 0.13), (0.17, -0.32, -0.14, -0.18, 0.18),
               (0.58, -0.32, -0.14, -0.18, 0.18), (0.67, -0.27, -0.04, -0.13, 0.13)),
        _stack("z", (0.52, 0.02, 0.17, -0.060, 0.060), (0.60, 0.15, 0.27, -0.045, 0.045), corners=_SQUARE),
    ),
    "head": (
        _stack("x", (-0.115, -0.05, 0.05, -0.02, 0.13), (-0.07, -0.07, 0.07, -0.05, 0.155),
               (0.00, -0.07, 0.07, -0.05, 0.13), (0.035, -0.05, 0.05, -0.03, 0.06)),
    ),
    # The spinning lidar before the head.
    "hokuyo_link": (_stack("z", (-0.035, 0.000, 0.065, -0.032, 0.032), (0.027, 0.000, 0.065, -0.032, 0.032)),),
}

_LEFT: Mapping[str, tuple[Points, ...]] = {
    "lglut": (
        _stack("z", (-0.085, 0.01, 0.09, -0.04, 0.045), (-0.02, -0.05, 0.08, -0.045, 0.055),
               (0.045, -0.05, 0.05, -0.045, 0.045)),
    ),
    "uleg": (
        _stack("z", (-0.385, -0.100, -0.005, -0.052, 0.052), (-0.25, -0.105, 0.048, -0.064, 0.070),
               (-0.05, -0.092, 0.078, -0.066, 0.082), (0.045, -0.055, 0.050, -0.045, 0.062)),
    ),
    "lleg": (
        _stack("z", (-0.40, -0.036, 0.036, -0.037, 0.037), (-0.15, -0.072, 0.055, -0.058, 0.058),
               (-0.02, -0.055, 0.068, -0.060, 0.060), (0.045, -0.030, 0.052, -0.052, 0.052)),
    ),
    "clav": (
        # The yoke down from the collar, and the bearing of the shoulder.
        _stack("z", (-0.20, -0.05, 0.05, -0.050, 0.045), (0.02, -0.058, 0.058, -0.060, 0.050),
               (0.055, -0.035, 0.035, -0.040, 0.030)),
        _stack("y", (-0.05, -0.06, 0.06, -0.295, -0.18), (0.045, -0.065, 0.065, -0.300, -0.190)),
    ),
    "scap": (
        _stack("y", (-0.055, -0.045, 0.045, -0.045, 0.045), (0.00, -0.062, 0.062, -0.062, 0.062),
               (0.09, -0.055, 0.055, -0.062, 0.050), (0.14, -0.045, 0.045, -0.055, 0.035)),
    ),
    "uarm": (
        _stack("y", (-0.05, -0.05, 0.05, -0.050, 0.050), (0.05, -0.058, 0.058, -0.055, 0.055),
               (0.115, -0.05, 0.05, -0.040, 0.055)),
    ),
    "larm": (
        _stack("y", (-0.045, -0.04, 0.04, -0.040, 0.040), (0.00, -0.058, 0.058, -0.052, 0.052),
               (0.095, -0.05, 0.05, -0.055, 0.045)),
    ),
    "ufarm": (
        _stack("y", (-0.205, -0.052, 0.052, -0.052, 0.052), (-0.12, -0.050, 0.050, -0.050, 0.050),
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
}
# fmt: on


def foot(sole: Float[np.ndarray, "4 3"]) -> Points:
    """Make a foot whose lowest face is exactly ``sole`` (4 corners), with a rim, an instep and an ankle above it."""
    rim = sole + np.array([0.0, 0.0, 0.022])
    low, high = sole.min(axis=0), sole.max(axis=0)
    instep = _section((-0.010, -0.06, 0.075, low[1] + 0.018, high[1] - 0.018), _OCTAGON, "z")
    ankle = _section((0.018, -0.04, 0.04, -0.038, 0.038), _SQUARE, "z")
    return np.vstack([sole, rim, instep, ankle])


def link_shapes() -> Mapping[str, tuple[Points, ...]]:
    """Return the convex bodies of each link but the feet in its own frame [m]; right links mirror left ones."""
    mirror = np.array([1.0, -1.0, 1.0])
    shapes = dict(_CENTRE)
    for name, bodies in _LEFT.items():
        shapes[f"l_{name}"] = bodies
        shapes[f"r_{name}"] = tuple(points * mirror for points in bodies)
    return shapes
