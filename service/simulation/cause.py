"""Why a robot fell: the first unusual event before it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from service.simulation.measures import Frames, list_rows, measure_hand_force
from service.simulation.run import SimulatedRun

SLIP_M = 0.02  # from which a slip is named [m]
LONG_S = 0.05  # for which a torque has to be saturated to be named [s]
BEFORE_FALL_S = 3.0  # in which the cause of a fall is looked for
EARLIER_S = 0.5  # before a fall without an unusual event, when the centre of mass is reported


def find_cause(
    execution: SimulatedRun,
    frames: Frames,
    slips: Mapping[str, tuple[Float[np.ndarray, "S"], Float[np.ndarray, "S"]]],
    saturation: list[dict[str, Any]],
    touches: list[dict[str, Any]],
) -> str:
    """Return a sentence on the fall: when, in which phase or how long after the plan, and the first unusual event."""
    reference, record = execution.reference, execution.record
    fell = record.fell_at_s or 0.0
    phase = reference.find_phase(fell).name
    events: list[tuple[float, str]] = []
    for joint in saturation:
        if joint["seconds"] >= LONG_S and joint["first_s"] < fell:
            events.append((joint["first_s"], f"{joint['joint']} reached its torque limit"))
    for link, (times, slip) in slips.items():
        rows = np.flatnonzero((slip > SLIP_M) & (times < fell))
        if len(rows):
            events.append((float(times[rows[0]]), f"{link} slipped by more than {1e3 * SLIP_M:.0f} mm"))
    for touch in touches:
        if touch["first_s"] < fell:
            events.append((touch["first_s"], f"{touch['link']} pressed {touch['other']}"))
    for span in reference.phases:
        rows = list_rows(record, span)
        for load in span.loads:
            force = measure_hand_force(reference.robot, record, load.tool)
            high = [row for row in rows.tolist() if force[row] > load.abort_n and record.times[row] < fell]
            if high:
                events.append((float(record.times[high[0]]), f"the force of {load.tool} passed {load.abort_n:.0f} N"))
    recent = sorted(event for event in events if event[0] > fell - BEFORE_FALL_S)
    after = fell - reference.duration_s
    words = f"fell at {fell:.2f} s" + (f", {after:.2f} s after the plan" if after > 0.0 else f" in phase '{phase}'")
    if not recent:
        earlier = int(np.abs(record.times - (fell - EARLIER_S)).argmin())
        off = 1e3 * float(np.linalg.norm((frames.com() - frames.com(True))[earlier, :2]))
        return f"{words}; {EARLIER_S:g} s before, the centre of mass was {off:.0f} mm off the plan"
    return f"{words}; before that, at {recent[0][0]:.2f} s, {recent[0][1]}"
