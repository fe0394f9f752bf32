"""Rule of the trust region: which trial steps are taken, and how large the box of the next one is."""

from __future__ import annotations

from dataclasses import dataclass

FILLED = 0.9  # a step of this share of the radius shows that the box held it
REOPENED = 0.1  # of the first radius: least box after the penalty rises


@dataclass(frozen=True)
class TrustRegion:
    """Trust region with a box of one radius, which is the rule's whole state.

    Attributes:
        first_radius: box of the first trial step [variable units times ``Problem.step_scale``].
        min_radius: a smaller box is not searched.
        accept_ratio: least fall of the exact merit for a step to be taken, as a fraction of what the model promised.
        shrink, expand: factors of the radius after a rejected and an accepted step.
    """

    first_radius: float
    min_radius: float
    accept_ratio: float
    shrink: float
    expand: float

    def init(self) -> float:
        """Return the radius of the first trial step."""
        return self.first_radius

    def accept(self, promised: float, actual: float) -> bool:
        """Return whether a step is taken, given the fall of the merit in the model and the exact one."""
        return actual >= self.accept_ratio * promised

    def step(self, radius: float, travel: float, *, is_accepted: bool) -> float:
        """Return the next radius.

        Args:
            radius: box of the trial step.
            travel: least radius of a box that holds the trial step; ``radius`` where no step was found.
        """
        if is_accepted:
            return radius * self.expand if travel > FILLED * radius else radius
        # A box that the step did not fill would give the same step again.
        return self.shrink * min(radius, travel)

    def reopen(self, radius: float) -> float:
        """Return the radius after the penalty rose: a box that has shrunk becomes worth searching again."""
        return max(radius, REOPENED * self.first_radius)

    def terminate(self, radius: float) -> bool:
        """Return whether the box is too small to be searched."""
        return radius < self.min_radius
