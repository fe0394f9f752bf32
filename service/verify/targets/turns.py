"""Bounds of angles along a phase: between a frame and an orientation, and between an axis and a direction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from service.verify.frame_paths import FramePath
from service.verify.phase_proof import Extreme, PhaseProof, values_at_ends
from service.verify.targets.pose_errors import angle_of, chord_of, measure_angle, measure_lean


def bound_turn(
    proof: PhaseProof,
    path: FramePath,
    wanted: Float[np.ndarray, "3 3"],
    free_axis: Float[np.ndarray, "3"] | None,
    limit: float,
    at: float | None = None,
) -> Extreme:
    """Bound the angle between a frame and its wanted orientation, or between the directions of its free axis [rad]."""
    if free_axis is not None:
        return bound_lean(proof, path, free_axis, wanted @ free_axis, limit, at)
    return _bound_angle(proof, path, lambda s: measure_angle(wanted.T @ path.at(s)[1]), limit, at)


def bound_lean(
    proof: PhaseProof,
    path: FramePath,
    frame_axis: Float[np.ndarray, "3"],
    wanted: Float[np.ndarray, "3"],
    limit: float,
    at: float | None,
) -> Extreme:
    """Bound the angle between an axis of a frame and a wanted direction [rad]."""
    return _bound_angle(proof, path, lambda s: measure_lean(path.at(s)[1] @ frame_axis, wanted), limit, at)


def _bound_angle(
    proof: PhaseProof,
    path: FramePath,
    angle: Callable[[np.ndarray], np.ndarray],
    limit: float,
    at: float | None,
) -> Extreme:
    """Bound an angle at one path parameter, or along the phase [rad].

    By its chord, whose bound comes closer with the square of an interval's length; near half a turn, where the chord
    says little of the angle, by how far the frame can turn on its ways from both ends.
    """
    if at is not None:
        return Extreme.at_one_pose(float(angle(np.array([at]))[0]), at, limit)

    def evaluate(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ends = values_at_ends(angle, first, last)
        largest = np.maximum(*ends)
        by_chord = angle_of(chord_of(largest) + path.direction_deviation(first, last))
        by_turning = 0.5 * (ends[0] + ends[1] + path.turning_angle(first, last))
        return np.maximum(np.minimum(by_chord, by_turning), largest), *ends

    return proof.bound(evaluate, limit, largest=np.pi)
