"""How far hands are from an earlier motion that is kept, measured phase by phase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from service.demands.phase import TaskPhase
from service.demands.rest.earlier_motion import read_earlier_motion
from service.request.resume import NominalRequest
from service.verify import Motion, trace_frame

DISPLACED_MM, DISPLACED_DEG = "hand_displaced_mm", "hand_displaced_deg"
PER_INTERVAL = 8  # samples between two knots


def measure_displacement(motion: Motion, specs: Sequence[TaskPhase], earlier: NominalRequest) -> dict[str, float]:
    """Measure the largest displacement of a hand that handles the mechanism from an earlier motion.

    Both are compared phase by phase, at equal shares of the phase.  Without the same joints and phases the result is
    empty.

    Args:
        motion: the motion that keeps the earlier one.
        specs: phases of the task, each with its hand.
        earlier: the earlier motion, with knots and tangents.
    """
    curves = read_earlier_motion(motion.robot, earlier, np.zeros(motion.robot.n)).curves
    distance, turn = 0.0, 0.0
    for spec in specs:
        phase = next((phase for phase in motion.phases if phase.name == spec.name), None)
        curve = curves.get(spec.name)
        if spec.hand is None:
            continue
        if phase is None or curve is None:
            return {}
        s = _sample(motion.curve.knots[motion.curve.find_knots(phase.first, phase.last)])
        share = (s - phase.first) / (phase.last - phase.first)
        at = curve.knots[0] + share * (curve.knots[-1] - curve.knots[0])
        paths = [trace_frame(motion.robot.model, spec.hand.tool, q) for q in (motion.curve(s), curve(at))]
        (r0, p0), (r1, p1) = paths
        cosine = 0.5 * (np.einsum("tij,tij->t", r0, r1) - 1.0)
        distance = max(distance, float(np.linalg.norm(p1 - p0, axis=1).max()))
        turn = max(turn, float(np.arccos(np.clip(cosine, -1.0, 1.0)).max()))
    return {DISPLACED_MM: 1e3 * distance, DISPLACED_DEG: float(np.rad2deg(turn))}


def _sample(knots: Float[np.ndarray, "K"]) -> Float[np.ndarray, "S"]:
    """Return path parameters at the knots and between them."""
    share = np.arange(PER_INTERVAL) / PER_INTERVAL
    return np.append((knots[:-1, None] + share * np.diff(knots)[:, None]).ravel(), knots[-1])
