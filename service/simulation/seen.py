"""What a run in physics shows of the work of a plan: configurations, latches and a fall over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Seen:
    """Samples of a run in physics, from which its verdict follows.

    Attributes:
        times: (S,) on the plan's clock; beyond its duration after its end; never decreasing [s].
        configuration, planned: (S, n) true and planned configurations of the plan's model.
        is_latched: (S, R) whether each release of the motion still holds its joint.
        fell_at_s: when the robot fell, or None.
        objects: (S, 7) true position and quaternion w x y z of each movable object, by name.
    """

    times: Float[np.ndarray, "S"]
    configuration: Float[np.ndarray, "S n"]
    planned: Float[np.ndarray, "S n"]
    is_latched: Bool[np.ndarray, "S R"]
    fell_at_s: float | None
    objects: Mapping[str, Float[np.ndarray, "S 7"]] = field(default_factory=dict, kw_only=True)
