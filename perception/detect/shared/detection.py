"""Detections: the report of every detector, and the interface of an object's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece

CONFIDENT = 0.5
"""Least confidence of a detection to act on."""


class Model(Protocol):
    """Model of a detected object that is removed from the scene's pieces, because a task moves it."""

    def split_off(self, points: Float[np.ndarray, "N 3"], /) -> tuple[Bool[np.ndarray, "N"], tuple[ConvexPiece, ...]]:
        """Return the mask of points (N, 3) on the object, and pieces of its parts that stay in the scene."""
        ...

    def see_past(
        self, starts: Float[np.ndarray, "*R 3"], ends: Float[np.ndarray, "R 3"], /
    ) -> Float[np.ndarray, "R 3"]:
        """Return the ends of rays, moved on through space that is free once the object is away [m]."""
        ...

    def list_sides(self) -> Float[np.ndarray, "F 4"]:
        """Return the half-spaces ``a . x + b <= 0`` of a box in which every point is the object's own; none without.

        Convex pieces of other objects may cut across its corners; ``perceive`` takes the box away from them.
        """
        ...


@dataclass(frozen=True)
class Detection:
    """Detected object.

    Attributes:
        kind: one of ``perception.detect.KINDS``.
        pose_world_object: (4, 4); each detector's docstring defines the object's frame.
        sizes: lengths [m] by name, except ``ajar`` and ``..._rad`` [rad], ``side`` and ``lever_direction`` (+1 or -1)
            and ``n_...``.
        confidence: 0 to 1; act on detections of 0.5 and more.
        residuals: quality of the model's fit, by name: lengths [m], except names that end in ``_rad``,
            ``_share`` (0 to 1), ``_ratio`` or ``_score`` and names that begin with ``n_`` (counts) or ``ray_``
            (evidence of the rays, without a unit).
        points: (K, 3) sample of the points that the detection is based on [m].
        doubts: what speaks against it, in sentences, most weighty first.
        model: of an object that ``perceive`` removes from the pieces; None for all others.
    """

    kind: str
    pose_world_object: Float[np.ndarray, "4 4"]
    sizes: Mapping[str, float]
    confidence: float
    residuals: Mapping[str, float]
    points: Float[np.ndarray, "K 3"]
    model: Model | None = None
    doubts: tuple[str, ...] = ()
