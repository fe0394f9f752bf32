"""Effort of the optimiser by purpose: the only presets of its settings that the planner has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from typing import Any

from scopt import Settings


class Effort(Enum):
    """How long the optimiser tries before the search goes on to another start."""

    WHOLE = "the settings of the plan"
    QUICK = "a path where another start is faster than more steps"
    PATIENT = "a path after quicker ones have failed, or one that is free of collisions"
    NONE = "the path or the pose as it is"
    REPAIR = "from a motion that was good before something moved: the first iterate that holds is as good"
    RESTORE = "from a local minimum, for the constraints alone"
    POSE = "a pose, which takes some ten steps where it is reachable"
    GOAL_POSE = "a pose at a goal, which other seeds may find"
    QUICK_POSE = "whether a pose exists"
    ANY_POSE = "whether a pose exists, whatever it is like"
    FORCES = "a pose with the forces that hold it"

    def apply(self, settings: Settings) -> Settings:
        """Return the settings with this effort."""
        return replace(settings, **_CHANGES[self])


_CHANGES: Mapping[Effort, Mapping[str, Any]] = {
    Effort.WHOLE: {},
    # Steps of a feasible path that gain less than a tenth of its merit shorten it by half a percent.
    Effort.QUICK: {"max_iterations": 20, "patience": 6, "acceptable_steps": 2, "min_improvement_feasible": 0.1},
    Effort.PATIENT: {"max_iterations": 50, "patience": 8},
    Effort.NONE: {"max_iterations": 0},
    # A high penalty: a constraint that can be met gives way at once.
    Effort.REPAIR: {
        "penalty": 100.0, "max_penalty_raises": 2, "max_iterations": 15, "acceptable_steps": 1, "trust_radius": 0.1,
    },
    Effort.RESTORE: {"penalty": 100.0, "max_penalty_raises": 1, "max_iterations": 30},
    Effort.POSE: {"max_iterations": 40, "max_penalty_raises": 3},
    Effort.GOAL_POSE: {
        "max_iterations": 40, "max_penalty_raises": 3, "patience": 12, "min_improvement_feasible": 0.3,
    },
    Effort.QUICK_POSE: {"max_iterations": 20, "max_penalty_raises": 2},
    # Its first feasible iterate ends it, and steps without progress say that there is none.
    Effort.ANY_POSE: {"max_iterations": 20, "max_penalty_raises": 2, "min_improvement_feasible": 1.0},
    Effort.FORCES: {"max_iterations": 80, "max_penalty_raises": 3, "patience": 25},
}  # fmt: skip

FORCE_SETTINGS = Effort.FORCES.apply(Settings())
