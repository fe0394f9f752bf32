"""Speeds of hands that press: what the planner keeps to without being asked, and what a jam makes of the others."""

from __future__ import annotations

import numpy as np

from service.verify import (
    FrameSpeed,
    Motion,
    limit_loads,
    list_press_speeds,
    measure_rates,
    split_motion,
    trace_frame,
)

LONGEST_PUSH_S = 7.0  # that a push may take at the speed at which a jam stays below its cap
SAMPLES = 100  # of a way
RELATIVE_TOLERANCE = 0.02  # excess of a force over its cap that is not worth a note


def list_cheap_speeds(motion: Motion) -> tuple[FrameSpeed, ...]:
    """Return the largest speeds of a motion without a pace: of all hands that come to what they press, and of pushes.

    A hand is slow where it begins to press, and throughout a push that then takes no longer than ``LONGEST_PUSH_S``.
    """
    if motion.pace is not None or all(not phase.loads for phase in motion.phases):
        return ()
    return tuple(
        speed
        for speed in list_press_speeds(motion, motion.phases)
        if np.isfinite(speed.near_m) or _measure_way(motion, speed) <= LONGEST_PUSH_S * speed.most
    )


def list_jam_notes(motion: Motion) -> tuple[str, ...]:
    """Return a sentence on the push whose jam would exceed its cap most; none with a pace, which rules that out."""
    law = motion.law
    if motion.pace is not None or law is None:
        return ()
    notes = {}
    for part, phase in zip(split_motion(motion), motion.phases, strict=True):
        for limit in limit_loads(part, phase):
            s = np.linspace(phase.first, phase.last, SAMPLES + 1)
            _, places = trace_frame(part.robot.model, limit.tool, motion.curve(s))
            rates = measure_rates(law, s)
            steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(s)
            fastest = float((steps * np.minimum(rates[:-1], rates[1:])).max())
            approach = motion.approach
            force = limit.expected_n + approach.stiffness_n_m * approach.reaction_s * fastest
            if force + approach.noise_n > limit.cap_n * (1.0 + RELATIVE_TOLERANCE):
                notes[force / limit.cap_n] = (
                    f"{limit.tool} moves at up to {fastest:.2f} m/s in phase '{phase.name}': if what it pushes jams, "
                    f"it presses with about {force:.0f} N before it stops, and robot and ground hold "
                    f"{limit.cap_n:.0f} N; options.pace keeps such a force below"
                )
    return (notes[max(notes)],) if notes else ()


def _measure_way(motion: Motion, speed: FrameSpeed) -> float:
    """Return how far a frame goes while a speed holds [m]."""
    s = np.linspace(speed.first, speed.last, SAMPLES + 1)
    _, places = trace_frame(motion.robot.model, speed.frame, motion.curve(s))
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
