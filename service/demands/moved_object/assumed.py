"""Masses of parts of mechanisms that nobody states: of the hulls of their shapes, as dense as wood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import LinkInertia, spread_mass
from service.demands.resistance import ASSUMED_DENSITY


def assume_inertia(parts: Sequence[Float[np.ndarray, "V 3"]]) -> LinkInertia:
    """Return the mass of a link that its shapes let expect, in their frame.

    Args:
        parts: vertices of its convex bodies [m].
    """
    solid = [(part, volume) for part in parts if (volume := measure_volume(part)) > 0.0]
    if not solid:
        return LinkInertia(0.0, np.zeros(3), np.zeros((3, 3)))
    return spread_mass([part for part, _ in solid], ASSUMED_DENSITY * sum(volume for _, volume in solid))


def measure_volume(vertices: Float[np.ndarray, "V 3"]) -> float:
    """Return the volume of the hull of points [m^3]; 0 where they are on a plane."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    try:
        return float(ConvexHull(vertices).volume)
    except QhullError:
        return 0.0
