"""Regions of the certificate replayed: bounds along axes, distances, angles, and axes that look at a place.

Positions and directions are convex along chords.  Components of a rotation vector and directions to a place are not:
they are bounded by how far the joints between the frames can turn or move the frame on an interval.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from replayed_motion import Array, Replay

MOST_TURN = 3.1  # angle of a rotation vector beyond which nothing is said of its components [rad]


def region(replay: Replay, phase: dict[str, Any], wanted: dict[str, Any]) -> tuple[bool, str]:
    """Check each limit of a region, at one path parameter or on its part of the phase."""
    model, knots = replay.model, replay.knots
    frame = model.frames[model.getFrameId(wanted["frame"])]
    holder, there = 0, pin.SE3.Identity()
    if wanted["reference"] is not None:
        other = model.frames[model.getFrameId(wanted["reference"])]
        holder, there = int(other.parentJoint), other.placement
    joint, origin, turn = int(frame.parentJoint), frame.placement.translation[None], frame.placement.rotation
    place = there * pin.XYZQUATToSE3(np.array([*wanted["position"], *np.roll(wanted["quaternion_wxyz"], -1)]))
    chain = replay.chain(holder, joint, origin)

    def offset(s: float) -> Array:
        return (replay.points(s, joint, origin, holder)[0] - place.translation) @ place.rotation

    def turned(s: float) -> Array:
        (r, _), (rf, _) = replay.place(s, joint), replay.place(s, holder)
        return place.rotation.T @ rf.T @ r @ turn

    def moved(a: float, b: float) -> tuple[float, float]:
        """Return how far the frame can turn [rad] and its origin move [m] from a to b."""
        piece = int(np.searchsorted(knots, 0.5 * (a + b)) - 1)
        speed, _ = replay.rates(a, b, piece)
        turns = sum(speed[column] for column, _, _ in chain if replay.turns[column])
        return float((b - a) * turns), float((b - a) * sum(speed[column] * reach for column, _, reach in chain))

    first, last = (replay.samples[phase[end]] for end in ("first", "last"))
    begin, end = knots[0] + np.array(wanted["during"]) * (knots[-1] - knots[0])
    if wanted["at"] is None and (end <= first or begin >= last):
        return True, "not in this phase"
    span = max(first, begin), min(last, end)

    def largest(value: Any, leaving: Any) -> float:
        if wanted["at"] is not None:
            return float(value(replay.samples[wanted["at"]]))
        return replay.highest(phase, value, leaving, 0.0, span)

    def by_path(a: float, b: float) -> float:
        return replay.bound(a, b, chain, joint, origin)

    spare = []
    for k in range(3):
        if wanted["lower_m"][k] is not None:
            spare.append(largest(lambda s, k=k: wanted["lower_m"][k] - offset(s)[k], by_path))
        if wanted["upper_m"][k] is not None:
            spare.append(largest(lambda s, k=k: offset(s)[k] - wanted["upper_m"][k], by_path))
    if wanted["radius_m"] is not None:
        spare.append(largest(lambda s: np.linalg.norm(offset(s)[:2]) - wanted["radius_m"], by_path))
    if wanted["distance_m"] is not None:
        spare.append(largest(lambda s: np.linalg.norm(offset(s)) - wanted["distance_m"], by_path))

    def by_turn(a: float, b: float) -> float:
        return 0.5 * moved(a, b)[0]

    if wanted["turn_deg"] is not None:
        most = np.deg2rad(wanted["turn_deg"])
        spare.append(largest(lambda s: np.linalg.norm(pin.log3(turned(s))) - most, by_turn))
    for k, angle in enumerate(wanted["turns_deg"]):
        if angle is not None:

            def by_component(a: float, b: float) -> float:
                turn = moved(a, b)[0]
                far = max(float(np.linalg.norm(pin.log3(turned(s)))) for s in (a, b)) + turn
                return np.inf if far > MOST_TURN else 0.25 * far / np.sin(0.5 * far) * turn if far > 0.0 else 0.0

            spare.append(largest(lambda s, k=k, m=angle: abs(pin.log3(turned(s))[k]) - np.deg2rad(m), by_component))
    if wanted["axis"] is not None and wanted["lean_deg"] is not None:
        axis, most = np.array(wanted["axis"]), np.deg2rad(wanted["lean_deg"])

        def sight(s: float) -> Array:
            return axis if wanted["look"] is None else np.array(wanted["look"]) - offset(s)

        def miss(s: float) -> float:
            towards = sight(s) / np.linalg.norm(sight(s))
            own = turned(s) @ axis
            return float(np.arctan2(np.linalg.norm(np.cross(own, towards)), own @ towards) - most)

        def by_sight(a: float, b: float) -> float:
            turn, far = moved(a, b)
            away = min(np.linalg.norm(sight(a)), np.linalg.norm(sight(b))) - far
            aside = 0.0 if wanted["look"] is None else 0.5 * np.pi * far / away if away > 0.0 else np.inf
            return float(0.5 * (turn + aside))

        spare.append(largest(miss, by_sight))
    worst = max(spare)
    return worst <= 1e-9, f"{-1e3 * worst:.2f} mm or mrad within its region"
