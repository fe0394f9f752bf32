"""Times of path parameters, the sequence of phases, and the edges between intervals of the curve."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from costs.curve import TimeLaw
from service.verify.motion import Motion, Phase, VerifyError


def find_time(law: TimeLaw | None, s: float) -> float | None:
    """Return the first time at which the path parameter is reached [s]; None without a law."""
    return None if law is None else float(find_times(law, np.array([s]))[0])


def find_times(law: TimeLaw, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S"]:
    """Return the first times at which path parameters are reached [s]."""
    i = np.minimum(np.maximum(np.searchsorted(law.path, s, side="left") - 1, 0), len(law.path) - 2)
    duration = law.times[i + 1] - law.times[i]
    speed, gain = law.shares[i] * law.speed[i], law.shares[i] * (law.speed[i + 1] - law.speed[i]) / duration
    ahead = np.maximum(s - law.path[i], 0.0)
    mean = 0.5 * (speed + np.sqrt(np.maximum(speed**2 + 2.0 * gain * ahead, 0.0)))
    step = np.divide(ahead, mean, out=np.zeros_like(ahead), where=mean > 0.0)
    return np.asarray(law.times[i] + np.minimum(step, duration))


def list_phases(motion: Motion) -> tuple[Phase, ...]:
    """Return the phases, or a single one without promises; reject phases that do not cover the curve in order.

    Raises:
        VerifyError: when they leave a gap or overlap.
    """
    start, end = float(motion.curve.knots[0]), float(motion.curve.knots[-1])
    if not motion.phases:
        return (Phase("motion", start, end),)
    reached = start
    for phase in motion.phases:
        if abs(phase.first - reached) > 1e-12 * max(1.0, abs(reached)) or phase.last <= phase.first:
            raise VerifyError(f"phase '{phase.name}' must begin at {reached} and have a length, got {phase.first}")
        reached = phase.last
    if abs(reached - end) > 1e-12 * max(1.0, abs(end)):
        raise VerifyError(f"the last phase ends at {reached}, the curve at {end}")
    return motion.phases


def split_at_phases(motion: Motion, phases: tuple[Phase, ...]) -> tuple[Float[np.ndarray, "E"], Int[np.ndarray, "E-1"]]:
    """Return knots and phase boundaries in order, and the phase of each interval between two of them."""
    start, end = motion.curve.knots[0], motion.curve.knots[-1]
    inner = [boundary for phase in phases for boundary in (phase.first, phase.last) if start < boundary < end]
    edges = np.unique(np.concatenate([motion.curve.knots, inner]))
    middle = 0.5 * (edges[:-1] + edges[1:])
    lasts = np.array([phase.last for phase in phases])
    return edges, np.clip(np.searchsorted(lasts, middle), 0, len(phases) - 1)


def edges_within(edges: Float[np.ndarray, "E"], phase: Phase) -> Float[np.ndarray, "F"]:
    """Return the edges within a phase or a part of one, its ends included."""
    tolerance = 1e-9 * max(1.0, abs(phase.last))
    inside = edges[(edges >= phase.first - tolerance) & (edges <= phase.last + tolerance)]
    ends = [end for end in (phase.first, phase.last) if not np.any(np.abs(inside - end) <= tolerance)]
    return np.union1d(inside, ends)
