"""Detections: what every detector reports of an object, and what perception needs of a model of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece

CONFIDENT = 0.5
"""Confidence from which on a detection is one to act on."""


class Model(Protocol):
    """Model of a detected object that is taken out of the scene's pieces, because a task moves it."""

    def split_off(self, points: Float[np.ndarray, "N 3"], /) -> tuple[Bool[np.ndarray, "N"], tuple[ConvexPiece, ...]]:
        """Return points (N, 3) that are the object's own, and pieces for those of its parts that stay in the scene."""
        ...


@dataclass(frozen=True)
class Detection:
    """An object as seen.

    Attributes:
        kind: what it is, one of ``perception.detect.KINDS``.
        pose_world_object: (4, 4); each detector's docstring says where the object's frame is.
        sizes: lengths [m] by name, but for ``ajar`` [rad], ``side`` and ``lever_direction`` (+1 or -1) and ``n_...``.
        confidence: 0 to 1; 0.5 and more is one to act on.
        residuals: how well the model explains the scan, by name: lengths [m], but for names that end in ``_rad``,
            ``_share`` (0 to 1), ``_ratio`` or ``_score`` and those that begin with ``n_`` (how many).
        points: (K, 3) some of the points it rests on [m].
        model: of an object that ``perceive`` takes out of the pieces; None for all others.
    """

    kind: str
    pose_world_object: Float[np.ndarray, "4 4"]
    sizes: Mapping[str, float]
    confidence: float
    residuals: Mapping[str, float]
    points: Float[np.ndarray, "K 3"]
    model: Model | None = None
