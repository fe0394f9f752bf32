"""How the planner goes about phases: waypoints, first guesses and reserves.  No demand depends on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from costs.allowance import Allowance
from costs.robot import Mechanism
from service.demands.phase import DEPTH_RESERVE, TaskPhase, list_work

FREE_WAYPOINTS, LINE_WAYPOINTS = 14, 5  # of a free phase, and of a line
LED_WAYPOINTS = 4  # of a phase in which only joints of the hand move, and at least of one that moves a mechanism
NOTHING = Mechanism("nothing", ())
"""The mechanism of a task that moves none."""
TURN_STEP, SLIDE_STEP = float(np.deg2rad(10.0)), 0.05  # between waypoints of a mechanism that moves [rad, m]
RESTORABLE = 20.0
ALONG_SAMPLES = 9  # of a hand's way with the mechanism


@dataclass(frozen=True)
class PhaseHints:
    """How to go about one phase.

    Attributes:
        pose_name: of the pose that it is begun from, in messages.
        free_waypoints, line_waypoints: of a phase that leads nothing, and of a line.
        turn_step: of a mechanism's joint between waypoints [rad].
        aims_at_end: whether it is first tried straight to a pose at its end.
        rates: rate of a joint in the first guess, per unit of the mechanism's only moving joint.
        passes: pairs that may overlap in the first guess, which is solved beforehand.
        torque_share: of the torque limits that the joints before the hand may use under the loads; None for any.
        depth_reserve_m: of the depths of what may touch, for the curve between the waypoints [m].
        settles: whether only its last waypoint has to be in balance.
        restorable: largest violation, relative to its tolerance, from which a solution is sought for constraints alone.
    """

    pose_name: str = ""
    free_waypoints: int = FREE_WAYPOINTS
    line_waypoints: int = LINE_WAYPOINTS
    turn_step: float = TURN_STEP
    aims_at_end: bool = False
    rates: Mapping[str, float] = field(default_factory=dict)
    passes: tuple[Allowance, ...] = ()
    torque_share: float | None = None
    depth_reserve_m: float = DEPTH_RESERVE
    restorable: float = RESTORABLE
    settles: bool = False


Hints = Callable[[TaskPhase], PhaseHints]
"""The hints of each phase of a task."""


def give_no_hints(phase: TaskPhase) -> PhaseHints:
    """Return hints that any phase can do with."""
    return PhaseHints()


def count_waypoints(phase: TaskPhase, mechanism: Mechanism, hints: PhaseHints) -> int:
    """Return the number of waypoints of a phase."""
    if phase.hand is None:
        return hints.free_waypoints
    if phase.hand.is_line:
        return hints.line_waypoints
    steps = [
        abs(float(phase.last[k] - phase.first[k]))
        / (SLIDE_STEP if mechanism.joints[k].kind == "prismatic" else hints.turn_step)
        for k in phase.moving
    ]
    return max(int(np.ceil(max(steps, default=0.0))) + 1, LED_WAYPOINTS)


def find_anchor(held: Sequence[TaskPhase], mechanism: Mechanism) -> int:
    """Return the index of the phase of one hold that is solved first: the others are solved from its ends.

    Of those that do the work it is the one in which the hand goes farthest; where nothing moves, the first that holds.
    """
    work = list_work(held)
    if work:
        return max(work, key=lambda k: measure_way(held[k], mechanism))
    return next((k for k, phase in enumerate(held) if phase.hand is not None and not phase.hand.is_line), 0)


def measure_way(phase: TaskPhase, mechanism: Mechanism) -> float:
    """Return how far a mechanism carries a hand in a phase [m]; nothing where the hand holds no link of it."""
    hand = phase.hand
    if hand is None or hand.link is None:
        return 0.0
    poses = np.array([mechanism.locate(hand.link, values) for values in phase.values(ALONG_SAMPLES)])
    places = poses[:, :3, :3] @ hand.place + poses[:, :3, 3]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
