"""A valve that a request gives by numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from perception import LeverDetection, ValveDetection, has_clear_spokes
from service.errors import RequestError
from service.request.tasks.valve import ValveRequest
from service.scan.scene_file import lever_from_sizes, wheel_from_circle

TUBE_RADIUS = 0.015  # when the request gives only the rim circle [m]


def read_given_valve(request: ValveRequest) -> ValveDetection | LeverDetection | None:
    """Return the valve that a request gives by its rim circle or its lever; None where the scan must show it.

    Raises:
        RequestError: some of centre, axis and radius (or lever) are missing.
    """
    lever = request.lever
    if all(value is None for value in (request.centre, request.axis, request.radius, lever)):
        return None
    if request.centre is None or request.axis is None or (request.radius is None and lever is None):
        raise RequestError("task.valve: centre, axis and radius (or lever) come together; give all three or none")
    if lever is not None:
        ends = np.array(request.centre), np.array(request.axis), np.array(lever.direction)
        return lever_from_sizes(*ends, lever.length_m, lever.radius_m, lever.grip_m)
    if request.radius is None:
        return None
    if request.radius < 2.0 * TUBE_RADIUS:
        raise RequestError(
            f"task.valve.radius: {request.radius:g} m leaves no opening inside a rim {2e3 * TUBE_RADIUS:g} mm thick; "
            f"expected at least {2.0 * TUBE_RADIUS:g} m"
        )
    bare = wheel_from_circle(np.array(request.centre), np.array(request.axis), request.radius, TUBE_RADIUS)
    if not request.spokes_deg:
        return bare
    angles = tuple(np.deg2rad(request.spokes_deg).tolist())
    valve = replace(bare, spoke_angles=angles, spoke_half_width=0.5 * request.spoke_width_m, spoke_share=1.0)
    if not has_clear_spokes(valve):
        raise RequestError(
            f"task.valve.spokes_deg: {len(angles)} spokes of {request.spoke_width_m} m; expected 2 to 8 that leave at "
            "least half of the wheel open"
        )
    return valve
