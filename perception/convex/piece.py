"""A convex piece of a scan: its shape, the points it stands for, and what the rays say about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.scene import ConvexPiece
from perception.convex.hulls import Hull


@dataclass(frozen=True)
class Evidence:
    """What the rays of a scan say about a piece.

    Attributes:
        free_cells: cells inside the piece that rays went through.
        free_share: their share of the piece's volume.
        open_share: share of its surface that borders space seen to be free; the rest borders what no ray has seen,
            or other things.
    """

    free_cells: int
    free_share: float
    open_share: float


@dataclass(frozen=True)
class Piece:
    """A convex piece and what it rests on.

    Attributes:
        shape: name, vertices and kind (``plane``, ``wall``, ``clutter``).
        points: indices of the obstacle points within 1 cm of it that no piece before it has.
        evidence: what the rays of the scan it was made from say.
        hull: its half-spaces, each once.
        plane: (4,) unit normal and offset of the plane it is a slab of; None for other shapes.
    """

    shape: ConvexPiece
    points: Int[np.ndarray, "K"]
    evidence: Evidence
    hull: Hull
    plane: Float[np.ndarray, "4"] | None = None

    @property
    def name(self) -> str:
        """Unique in its scene."""
        return self.shape.name

    @property
    def kind(self) -> str:
        """``plane``, ``wall`` or ``clutter``."""
        return self.shape.kind

    def summary(self) -> dict[str, object]:
        """Name, kind, number of points and evidence, JSON-ready."""
        return {
            "name": self.name,
            "kind": self.kind,
            "points": len(self.points),
            "free_cells": self.evidence.free_cells,
            "free_share": round(self.evidence.free_share, 4),
            "open_share": round(self.evidence.open_share, 3),
        }
