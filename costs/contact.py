"""Contacts of a robot's links with their surroundings: points, normals, friction, force caps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Contact:
    """Points of a link that touch the surroundings.

    Attributes:
        link: that touches.
        points: (C, 3) in the link's frame [m].
        normals: (C, 3) unit vectors in the link's frame, along which the surroundings push on the link.
        friction: coefficient of friction.
        force_cap_n: largest normal force of a point [N].
        reference: what it touches: a mechanism's link; None for the world.
    """

    link: str
    points: Float[np.ndarray, "C 3"]
    normals: Float[np.ndarray, "C 3"]
    friction: float
    force_cap_n: float
    reference: str | None = None
