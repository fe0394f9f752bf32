"""What a file's reader hands over: rows as they stand in the file, in its unit and frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # the process that parses files is quicker to start without it
    from jaxtyping import Float


@dataclass(frozen=True)
class Scan:
    """One file's content.

    Attributes:
        points: (N, 3) coordinates in the file's unit; a row with NaN is no point.
        viewpoint: x y z qw qx qy qz of the sensor; None when the file does not say.
        misses: (M, 3) places up to which rays met nothing.
        starts: (3,) where all rays started, or (N, 3) where that of each point did; None: at the viewpoint.
        miss_starts: (M, 3) where each of the others started; None: as the points' (3,), or at the viewpoint.
        notes: sentences a user should read.
        unit: of its lengths, where the file says so; empty where it does not.
    """

    points: Float[np.ndarray, "N 3"]
    viewpoint: tuple[float, ...] | None = None
    misses: Float[np.ndarray, "M 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    starts: Float[np.ndarray, "*N 3"] | None = None
    miss_starts: Float[np.ndarray, "M 3"] | None = None
    notes: tuple[str, ...] = ()
    unit: str = ""
