"""Scenes: convex pieces given by their vertices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.primitive import Primitive


@dataclass(frozen=True)
class ConvexPiece:
    """A convex piece of a scene, the hull of its vertices.

    Attributes:
        name: unique in its scene.
        vertices: (V, 3) world coordinates [m]; at least one, all finite.
        kind: class of object (``obstacle``, ``floor``, ``wall``, ``plane``, ``clutter``, ``rim``, ``hub``).
        exact: the round shape in the world that ``vertices`` contain; None for any other shape.
    """

    name: str
    vertices: Float[np.ndarray, "V 3"]
    kind: str = "obstacle"
    exact: Primitive | None = None

    @cached_property
    def lower(self) -> Float[np.ndarray, "3"]:
        """Lower corner of the axis-aligned bounding box [m]."""
        return np.asarray(self.vertices.min(axis=0))

    @cached_property
    def upper(self) -> Float[np.ndarray, "3"]:
        """Upper corner of the axis-aligned bounding box [m]."""
        return np.asarray(self.vertices.max(axis=0))


@dataclass(frozen=True)
class Scene:
    """Convex pieces with unique names."""

    pieces: tuple[ConvexPiece, ...] = ()

    def __post_init__(self) -> None:
        names = [piece.name for piece in self.pieces]
        if len(set(names)) != len(names):
            repeated = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"piece names must be unique; repeated: {', '.join(repeated)}")
