"""Lever on a pipe as a candidate for a valve, and the ratings of its parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.detect.shared.arithmetic import rising
from perception.detect.shared.bar_pivot import Pivot
from perception.detect.shared.bars import Bar
from perception.detect.valve.lever_bars import LENGTHS, FittedBar
from perception.detect.valve.lever_joint import LeverJoint

_SLIM = (5.5, 8.5)  # length by radius; smaller for a hose coupling on a standpipe
_AIR_ABOUT_A_PIPE = (0.5, 0.7)  # the edge of a box has air on one of two sides
# Share of a pipe's length beside which rays show air or none; of a box fitted as a pipe, only the corners.
_KNOWN_OF_IT = (0.25, 0.5)
_LONG_ENOUGH = (0.3, 0.42)  # length of a pipe; a bottle before which a tool lies is shorter [m]
END_UNSEEN = 0.4
SPREADS = (np.radians(1.8), np.radians(3.2))  # deviation of an axis rated 1, and of one rated 0 [rad]


@dataclass(frozen=True)
class LeverOnPipe:
    """Lever valve: the fitted lever, its joint with the pipe, and the confidence.

    Attributes:
        fitted: the lever as it was found.
        bar: the lever fitted again without its valve's body.
    """

    fitted: FittedBar
    bar: Bar
    joint: LeverJoint
    confidence: float
    pipe: FittedBar

    @property
    def length(self) -> float:
        """Length of the lever from its pivot [m]."""
        return abs(self.joint.pivot.far - self.joint.pivot.along)

    @property
    def pose(self) -> Float[np.ndarray, "4 4"]:
        """(4, 4) pose: origin at the pivot, x along the lever, z the pivot's axis to the sensor."""
        return self.joint.pose(self.bar)


def rate_lever(lever: FittedBar) -> float:
    """Return the rating of a bar as a lever by the rays about it, 0 to 1."""
    return float(
        rising(lever.evidence.solid, 0.6, 0.85)
        * rising(lever.evidence.air, 0.15, 0.4)
        * rising(lever.evidence.visible, 0.6, 0.85)
        * rising(-lever.evidence.rms, -0.02, -0.016)
        * rising(float(lever.evidence.n_hits), 12.0, 40.0)
    )


def rate_pipe(pipe: FittedBar) -> float:
    """Return the rating of a bar as a pipe by the rays about it, 0 to 1."""
    return float(
        rising(pipe.evidence.solid, 0.5, 0.75)
        * rising(pipe.evidence.air, *_AIR_ABOUT_A_PIPE)
        * rising(pipe.evidence.known, *_KNOWN_OF_IT)
        * rising(pipe.bar.length, *_LONG_ENOUGH)
        * pipe.rating
    )


def rate_pivot(pivot: Pivot, radius: float) -> float:
    """Return the rating of a bar as a lever, 0 to 1: long enough, slim, held at one end."""
    length = abs(pivot.far - pivot.along)
    return rising(length, LENGTHS[0], LENGTHS[0] + 0.03) * rising(length / radius, *_SLIM) * pivot.confidence
