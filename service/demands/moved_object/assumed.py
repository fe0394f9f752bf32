"""Masses of parts of mechanisms that nobody states: of the hulls of their shapes, as dense as wood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from costs.robot.elements.inertia import LinkInertia
from service.demands.resistance import ASSUMED_DENSITY


def assume_inertia(parts: Sequence[Float[np.ndarray, "V 3"]]) -> LinkInertia:
    """Return the mass of a link that its shapes let expect, in their frame.

    Args:
        parts: vertices of its convex bodies [m].
    """
    volumes = [measure_volume(part) for part in parts]
    volume = sum(volumes)
    if volume <= 0.0:
        return LinkInertia(0.0, np.zeros(3), np.zeros((3, 3)))
    middle = np.sum([own * part.mean(axis=0) for own, part in zip(volumes, parts, strict=True)], axis=0) / volume
    sides = np.ptp(np.concatenate(list(parts)), axis=0) ** 2
    mass = ASSUMED_DENSITY * volume
    return LinkInertia(mass, middle, np.diag(mass * (sides.sum() - sides) / 12.0))  # of a box that contains them


def measure_volume(vertices: Float[np.ndarray, "V 3"]) -> float:
    """Return the volume of the hull of points [m^3]; 0 where they are on a plane."""
    try:
        return float(ConvexHull(vertices).volume)
    except QhullError:
        return 0.0
