"""Distances of convex sets by projection onto their difference, without coal: a reference for the verifier's tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from costs.curve import Curve
from costs.robot.model import LinkBody
from costs.scene import ConvexPiece


def hull_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two hulls (0 when they meet): least squares over convex combinations, by non-negative least squares.

    The sum-to-one rows are weighted heavily, so the distance is right to about 1e-6.
    """
    weight = 1e3
    matrix = np.zeros((5, len(a) + len(b)))
    matrix[:3, : len(a)], matrix[:3, len(a) :] = a.T, -b.T
    matrix[3, : len(a)], matrix[4, len(a) :] = weight, weight
    shares, _ = nnls(matrix, np.array([0.0, 0.0, 0.0, weight, weight]))
    first, second = shares[: len(a)], shares[len(a) :]
    return float(np.linalg.norm(first @ a / first.sum() - second @ b / second.sum()))


def sampled_gap(
    model: pin.Model, curve: Curve, bodies: Sequence[LinkBody], pieces: Sequence[ConvexPiece], s: np.ndarray
) -> float:
    """Smallest distance of any body from any piece or body of another joint at the sampled poses [m]."""
    data = model.createData()
    gap = np.inf
    for q in curve(s):
        pin.forwardKinematics(model, data, q)
        placed = [b.vertices @ data.oMi[b.joint].rotation.T + data.oMi[b.joint].translation for b in bodies]
        for i, points in enumerate(placed):
            others = [piece.vertices for piece in pieces]
            others += [placed[j] for j in range(i) if bodies[j].joint != bodies[i].joint]
            for other in others:
                apart = np.maximum(points.min(axis=0) - other.max(axis=0), other.min(axis=0) - points.max(axis=0))
                if np.linalg.norm(np.maximum(apart, 0.0)) < gap:
                    gap = min(gap, hull_distance(points, other))
    return float(gap)
