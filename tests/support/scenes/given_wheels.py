"""Request for a wheel with four spokes that Atlas reaches as it stands."""

from __future__ import annotations

from typing import Any


def wheel_request(**changes: Any) -> dict[str, Any]:
    """Return the request to turn the wheel by 60 degrees; ``changes`` are fields of ``task.valve``."""
    valve = {
        "centre": [0.68, 0.12, 1.1],
        "axis": [-1, 0, 0],
        "radius": 0.14,
        "spokes_deg": [45, 135, 225, 315],
        "turn_deg": 60,
    }
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "task": {"valve": {**valve, **changes}},
    }
