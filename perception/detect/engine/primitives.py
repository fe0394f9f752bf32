"""Primitives that templates are made of: signed distance of many points to many instances at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

_TINY = 1e-12


class Primitive(Protocol):
    """A solid in the frame of each of B objects."""

    def distance(self, at: Float[np.ndarray, "B N 3"]) -> Float[np.ndarray, "B N"]:
        """Return the distance of each place to the surface, negative inside [m]."""
        ...

    def take(self, rows: Int[np.ndarray, "K"]) -> Primitive:
        """Return the primitive of some of the objects, which may repeat."""
        ...


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment.

    Attributes:
        first, last: (B, 3) ends of the segment [m].
        radius: (B,) [m].
    """

    first: Float[np.ndarray, "B 3"]
    last: Float[np.ndarray, "B 3"]
    radius: Float[np.ndarray, "B"]

    def distance(self, at: Float[np.ndarray, "B N 3"]) -> Float[np.ndarray, "B N"]:
        """Return the distance of each place to the surface, negative inside [m]."""
        way = self.last - self.first
        offset = at - self.first[:, None]
        square = np.maximum((way * way).sum(axis=1), _TINY)
        share = np.clip((offset @ way[:, :, None])[..., 0] / square[:, None], 0.0, 1.0)
        offset -= share[..., None] * way[:, None]
        return np.asarray(np.sqrt(np.einsum("bni,bni->bn", offset, offset)) - self.radius[:, None])

    def take(self, rows: Int[np.ndarray, "K"]) -> Capsule:
        """Return the primitive of some of the objects, which may repeat."""
        return Capsule(self.first[rows], self.last[rows], self.radius[rows])


@dataclass(frozen=True)
class Box:
    """A box with rounded edges, its sides along the object's axes.

    Attributes:
        centre, half: (B, 3) middle and half extents, rounding included [m].
        rounding: radius of its edges [m].
    """

    centre: Float[np.ndarray, "B 3"]
    half: Float[np.ndarray, "B 3"]
    rounding: float = 0.0

    def distance(self, at: Float[np.ndarray, "B N 3"]) -> Float[np.ndarray, "B N"]:
        """Return the distance of each place to the surface, negative inside [m]."""
        beyond = np.abs(at - self.centre[:, None]) - (self.half - self.rounding)[:, None]
        outside = np.maximum(beyond, 0.0)
        return np.asarray(
            np.sqrt(np.einsum("bni,bni->bn", outside, outside)) + np.minimum(beyond.max(axis=2), 0.0) - self.rounding
        )

    def take(self, rows: Int[np.ndarray, "K"]) -> Box:
        """Return the primitive of some of the objects, which may repeat."""
        return Box(self.centre[rows], self.half[rows], self.rounding)


@dataclass(frozen=True)
class Cylinder:
    """A round bar or disc with flat ends.

    Attributes:
        first, last: (B, 3) middles of its ends [m].
        radius: (B,) [m].
    """

    first: Float[np.ndarray, "B 3"]
    last: Float[np.ndarray, "B 3"]
    radius: Float[np.ndarray, "B"]

    def distance(self, at: Float[np.ndarray, "B N 3"]) -> Float[np.ndarray, "B N"]:
        """Return the distance of each place to the surface, negative inside [m]."""
        way = self.last - self.first
        length = np.maximum(np.linalg.norm(way, axis=1), _TINY)
        axis = way / length[:, None]
        offset = at - 0.5 * (self.first + self.last)[:, None]
        along = (offset @ axis[:, :, None])[..., 0]
        offset -= along[..., None] * axis[:, None]
        aside = np.sqrt(np.einsum("bni,bni->bn", offset, offset)) - self.radius[:, None]
        along = np.abs(along) - 0.5 * length[:, None]
        return np.asarray(
            np.hypot(np.maximum(aside, 0.0), np.maximum(along, 0.0)) + np.minimum(np.maximum(aside, along), 0.0)
        )

    def take(self, rows: Int[np.ndarray, "K"]) -> Cylinder:
        """Return the primitive of some of the objects, which may repeat."""
        return Cylinder(self.first[rows], self.last[rows], self.radius[rows])


@dataclass(frozen=True)
class Torus:
    """A ring about the object's z axis.

    Attributes:
        height: (B,) of its plane along z [m].
        radius, tube: (B,) radius of its centre line, and of its tube [m].
    """

    height: Float[np.ndarray, "B"]
    radius: Float[np.ndarray, "B"]
    tube: Float[np.ndarray, "B"]

    def distance(self, at: Float[np.ndarray, "B N 3"]) -> Float[np.ndarray, "B N"]:
        """Return the distance of each place to the surface, negative inside [m]."""
        aside = np.hypot(at[..., 0], at[..., 1]) - self.radius[:, None]
        return np.asarray(np.hypot(aside, at[..., 2] - self.height[:, None]) - self.tube[:, None])

    def take(self, rows: Int[np.ndarray, "K"]) -> Torus:
        """Return the primitive of some of the objects, which may repeat."""
        return Torus(self.height[rows], self.radius[rows], self.tube[rows])


def nearest(parts: Sequence[Primitive], at: Float[np.ndarray, "B N 3"]) -> Float[np.ndarray, "B N"]:
    """Return the distance of each place to the nearest of the parts [m]."""
    least = parts[0].distance(at)
    for part in parts[1:]:
        np.minimum(least, part.distance(at), out=least)
    return least


def nearest_part(
    parts: Sequence[Primitive], at: Float[np.ndarray, "B N 3"]
) -> tuple[Float[np.ndarray, "B N"], Int[np.ndarray, "B N"]]:
    """Return the distance of each place to the nearest of the parts [m], and that part's number."""
    least = parts[0].distance(at)
    number = np.zeros(least.shape, dtype=np.int64)
    for i, part in enumerate(parts[1:], 1):
        there = part.distance(at)
        nearer = there < least
        least[nearer], number[nearer] = there[nearer], i
    return least, number
