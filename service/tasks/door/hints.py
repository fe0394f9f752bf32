"""How the planner goes about the phases of a door."""

from __future__ import annotations

from service.demands.phase import TaskPhase
from service.tasks.hints import FREE_WAYPOINTS, Hints, PhaseHints

LEAF = 0  # index of the leaf among a door's joints
TORQUE_SHARE = 0.9  # of the joints before the hand; the rest is for the motion [-]


def make_door_hints(free_waypoints: int | None = None) -> Hints:
    """Return the hints of a door's phases: those that open the leaf are tried straight to a pose at their end."""

    def hint(phase: TaskPhase) -> PhaseHints:
        return PhaseHints(
            pose_name="pose on the leaf" if phase.name.startswith("push") else "pose at the handle",
            free_waypoints=free_waypoints or FREE_WAYPOINTS,
            aims_at_end=LEAF in phase.moving,
            torque_share=TORQUE_SHARE,
        )

    return hint
