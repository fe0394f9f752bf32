"""A piece before it has a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Body:
    """Kind, vertices and plane of an unnamed piece."""

    kind: str
    vertices: Float[np.ndarray, "V 3"]
    plane: Float[np.ndarray, "4"] | None
