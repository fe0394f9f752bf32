"""Weights and gains of online pose control, with those of the WPI-CMU team's egress controller."""

from __future__ import annotations

from dataclasses import dataclass

from service.errors import ExecutionError


@dataclass(frozen=True)
class TaskGains:
    """Weight and gains of one kind of task.

    Attributes:
        weight: of the squared error of the task's speed.
        kp: speed per position error [1/s].
        kd: speed per speed error [-]; below 1, or the commanded speed swings up from cycle to cycle.
    """

    weight: float
    kp: float
    kd: float

    def __post_init__(self) -> None:
        if self.weight < 0.0 or self.kp < 0.0 or not 0.0 <= self.kd < 1.0:
            raise ExecutionError(
                f"weight {self.weight:g}, kp {self.kp:g}, kd {self.kd:g}; expected a weight and kp of 0 or more, and "
                "kd from 0 to below 1"
            )


@dataclass(frozen=True)
class PoseGains:
    """Weights and gains of all tasks of the pose control.

    Attributes:
        joint: desired joint angles.
        pelvis: position of the floating base's link.
        foot, hand: position and orientation of feet and hands.
        com: position of the centre of mass.
        torso: orientation of the upper torso.
        damping: weight of the squared joint speeds, ``w_d`` of eq. 6.
        feed_forward: share of the reference's speed that tasks (and damping) start from; 0 is eq. 6 as printed, which
            follows a moving reference ``1 / kp`` seconds late, 1 follows without delay.
    """

    joint: TaskGains
    pelvis: TaskGains
    foot: TaskGains
    hand: TaskGains
    com: TaskGains
    torso: TaskGains
    damping: float = 0.005
    feed_forward: float = 0.0

    def __post_init__(self) -> None:
        if not self.damping > 0.0 or not 0.0 <= self.feed_forward <= 1.0:
            raise ExecutionError(
                f"damping {self.damping:g}, feed_forward {self.feed_forward:g}; expected a positive damping and a "
                "feed_forward from 0 to 1"
            )


TABLE_I = PoseGains(
    joint=TaskGains(0.05, 2.0, 0.9),
    pelvis=TaskGains(0.05, 4.0, 0.9),
    foot=TaskGains(500.0, 4.0, 0.9),
    hand=TaskGains(50.0, 4.0, 0.9),
    com=TaskGains(5.0, 2.0, 0.9),
    torso=TaskGains(500.0, 2.0, 0.0),
)
"""Table I of Liu et al., Humanoids 2015, with eq. 6 as printed."""

# In eq. 6 the speed error is that of the earlier command, so that a change of the reference alternates with -kd from
# cycle to cycle until it has faded; with the speed fed forward nothing is left for kd to do.
FOLLOW = PoseGains(
    joint=TaskGains(0.05, 2.0, 0.0),
    pelvis=TaskGains(0.05, 4.0, 0.0),
    foot=TaskGains(500.0, 4.0, 0.0),
    hand=TaskGains(50.0, 4.0, 0.0),
    com=TaskGains(5.0, 2.0, 0.0),
    torso=TaskGains(500.0, 2.0, 0.0),
    feed_forward=1.0,
)
"""Weights and kp of Table I, with the reference's speed fed forward in place of kd."""

PRESETS = {"follow": FOLLOW, "table-1": TABLE_I}
"""Gains by name."""
