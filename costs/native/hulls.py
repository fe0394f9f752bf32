"""Sets of convex hulls, and the distances between them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from costs.native.library import call

# Answers of the library: the distance is not known, is known, is larger than the limit.
TOUCHING, APART, BEYOND = 0, 1, 2


@dataclass(frozen=True)
class HullSet:
    """Hulls in one array, as the library reads them.

    Attributes:
        points: (W, 3) points of all hulls, one hull after the other [m].
        first: (S+1,) where each begins, and the end.
    """

    points: Float[np.ndarray, "W 3"]
    first: Int[np.ndarray, "S+1"]

    @staticmethod
    def of(hulls: Sequence[Float[np.ndarray, "V 3"]]) -> HullSet:
        """Return the set of these hulls.

        Raises:
            ValueError: one has no point.
        """
        if not all(map(len, hulls)):
            raise ValueError("a hull has at least one point")
        points = np.concatenate(hulls, dtype=float) if hulls else np.zeros((0, 3))
        return HullSet(np.ascontiguousarray(points), np.cumsum([0, *(len(hull) for hull in hulls)], dtype=np.int64))

    def measure_pairs(
        self,
        library: ctypes.CDLL,
        mover: Int[np.ndarray, "R"],
        holder: Int[np.ndarray, "R"],
        rotation: Float[np.ndarray, "R 3 3"],
        translation: Float[np.ndarray, "R 3"],
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"], Bool[np.ndarray, "R"]]:
        """Return distances [m] of movers placed in their holders' frames, unit directions to the holders, and which
        rows have neither, since the two touch or are nearer than a micrometre.
        """
        distance, direction = np.empty(len(mover)), np.empty((len(mover), 3))
        is_touching = np.empty(len(mover), dtype=np.uint8)
        call(
            library.scopt_measure_pairs,
            len(mover),
            self.points,
            self.first,
            np.ascontiguousarray(mover),
            np.ascontiguousarray(holder),
            np.ascontiguousarray(rotation),
            np.ascontiguousarray(translation),
            distance,
            direction,
            is_touching,
        )
        return distance, direction, is_touching.view(bool)

    def measure_swept(
        self,
        library: ctypes.CDLL,
        at_first: Float[np.ndarray, "I W 3"],
        at_second: Float[np.ndarray, "I W 3"],
        pose: Int[np.ndarray, "R"],
        count: Int[np.ndarray, "R"],
        other: Int[np.ndarray, "R"],
        limit: Float[np.ndarray, "R"],
    ) -> tuple[Float[np.ndarray, "R"], Float[np.ndarray, "R 3"], Float[np.ndarray, "R 3"], UInt8[np.ndarray, "R"]]:
        """Measure the hulls of ``count`` points at two poses, rows ``pose`` of ``at_first`` and ``at_second``.

        Returns:
            distance [m], unit normal to the other hull, nearest point of the swept hull [m], and answer of each row;
            the first three hold where it is ``APART``.
        """
        n, width = len(pose), at_first.shape[1]
        distance, normal, nearest = np.empty(n), np.empty((n, 3)), np.empty((n, 3))
        answer, scratch = np.empty(n, dtype=np.uint8), np.empty((2 * width, 3))
        call(
            library.scopt_measure_swept,
            n,
            width,
            at_first,
            at_second,
            np.ascontiguousarray(pose),
            np.ascontiguousarray(count),
            self.points,
            self.first,
            np.ascontiguousarray(other),
            np.ascontiguousarray(limit),
            scratch,
            distance,
            normal,
            nearest,
            answer,
        )
        return distance, normal, nearest, answer


def share_swept_gradient(
    library: ctypes.CDLL,
    at_first: Float[np.ndarray, "m V 3"],
    at_second: Float[np.ndarray, "m V 3"],
    normal: Float[np.ndarray, "m 3"],
    witness: Float[np.ndarray, "m 3"],
    band: float,
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Return the weight of the second pose of swept hulls in their gradients and the witness at both poses [m].

    Args:
        normal, witness: of each swept hull, towards it and on it.
        band: vertices within this of the support plane are averaged [m].
    """
    n, width = at_first.shape[:2]
    share, point_first, point_second = np.empty(n), np.empty((n, 3)), np.empty((n, 3))
    call(
        library.scopt_share_gradient,
        n,
        width,
        np.ascontiguousarray(at_first),
        np.ascontiguousarray(at_second),
        np.ascontiguousarray(normal),
        np.ascontiguousarray(witness),
        band,
        share,
        point_first,
        point_second,
    )
    return share, point_first, point_second
