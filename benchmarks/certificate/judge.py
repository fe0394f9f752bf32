"""Judge of the attacks on the certificate: dense sampling with independent kinematics and distances.

Shares nothing with the verifier: placements by Rodrigues' formula, distances by non-negative least squares over convex
combinations.  Between two samples no joint moves by more than 0.005 rad (or 5 mm).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from costs.curve import Curve
from service.verify import Motion

STEP = 0.005
# Accuracy of distances [m]: a distance below the claim by more than this refutes it.
JUDGE_M = 2e-6
# Hulls closer than this count as touching.
_MEETING_M = 1e-7
_ZOOM, _ZOOMS = 40, 2


@dataclass(frozen=True)
class Mechanism:
    """A tree of joints, as plain numbers.

    Attributes:
        parents: (J,) 0-based joint that carries each, -1 for the world.
        rotations, origins: (J, 3, 3) and (J, 3) where each joint sits in its parent's frame [m].
        axes: (J, 3) unit axis of each in its own frame.
        slides: (J,) whether it slides along its axis instead of turning about it.
        is_floating: whether six coordinates of a base (translation, z-y-x angles) come before the joints.
    """

    parents: tuple[int, ...]
    rotations: np.ndarray
    origins: np.ndarray
    axes: np.ndarray
    slides: tuple[bool, ...]
    is_floating: bool

    def model(self) -> pin.Model:
        """Return the same mechanism for pinocchio; joint 1 is the base if there is one."""
        model, shift = pin.Model(), 1
        if self.is_floating:
            base = pin.JointModelComposite()
            base.addJoint(pin.JointModelTranslation())
            base.addJoint(pin.JointModelSphericalZYX())
            model.addJoint(0, base, pin.SE3.Identity(), "base")
            shift = 2
        for k, parent in enumerate(self.parents):
            kind = pin.JointModelPrismaticUnaligned if self.slides[k] else pin.JointModelRevoluteUnaligned
            where = pin.SE3(self.rotations[k], self.origins[k])
            at = parent + shift if parent >= 0 else int(self.is_floating)
            model.addJoint(at, kind(self.axes[k]), where, f"j{k}")
        return model

    def place(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotations (S, L, 3, 3) and origins (S, L, 3) in the world of the base (if any) and every joint."""
        n, base = len(q), int(self.is_floating)
        turned, moved = np.empty((n, base + len(self.parents), 3, 3)), np.empty((n, base + len(self.parents), 3))
        if base:
            moved[:, 0] = q[:, :3]
            angles = zip(np.eye(3)[::-1], q[:, 3:6].T, strict=True)
            z, y, x = (_turns(axis, angle) for axis, angle in angles)
            turned[:, 0] = z @ y @ x
        for k, parent in enumerate(self.parents):
            value = q[:, 6 * base + k]
            above = parent + base
            frame, origin = np.eye(3), np.zeros(3)
            if above >= 0:
                frame, origin = turned[:, above], moved[:, above]
            here = frame @ self.rotations[k]
            moved[:, base + k] = frame @ self.origins[k] + origin
            if self.slides[k]:
                turned[:, base + k] = here
                moved[:, base + k] += value[:, None] * (here @ self.axes[k])
            else:
                turned[:, base + k] = here @ _turns(self.axes[k], value)
        return turned, moved


def _turns(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return rotations (S, 3, 3) about a unit axis."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angle)[:, None, None], 1.0 - np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def read(motion: Motion, s: np.ndarray) -> np.ndarray:
    """Return configurations of the curve, or of its exported samples interpolated linearly."""
    if motion.samples is None:
        return np.asarray(motion.curve(s))
    exported = motion.curve(motion.samples)
    return np.column_stack([np.interp(s, motion.samples, column) for column in exported.T])


def least_gap(mechanism: Mechanism, motion: Motion, claim: float) -> float:
    """Return the smallest distance that refutes a claimed clearance [m]: negative for overlap, infinity if none."""
    s = dense(motion.curve)
    gap, at = _least(mechanism, motion, s, claim)
    for _ in range(_ZOOMS if np.isfinite(at) else 0):
        k = int(np.searchsorted(s, at))
        s = np.linspace(s[max(k - 1, 0)], s[min(k + 1, len(s) - 1)], _ZOOM)
        closer, at = _least(mechanism, motion, s, min(claim, gap))
        gap = min(gap, closer)
        if not np.isfinite(at):
            break
    return gap if gap < claim - JUDGE_M else np.inf


def dense(curve: Curve) -> np.ndarray:
    """Return path parameters between which no coordinate moves by more than the step."""
    parts = []
    for first, last in zip(curve.knots[:-1], curve.knots[1:], strict=True):
        speed = np.abs(curve(np.linspace(first, last, 50), 1)).max()
        parts.append(np.linspace(first, last, 2 + int(np.ceil(1.1 * speed * (last - first) / STEP)))[:-1])
    return np.concatenate([*parts, curve.knots[-1:]])


def _least(mechanism: Mechanism, motion: Motion, s: np.ndarray, claim: float) -> tuple[float, float]:
    """Return the smallest distance near or below the claim, and its place."""
    best, where = np.inf, np.nan
    for mover, holder in _pairs(mechanism, motion, s):
        for k, gap in _near(mover, holder, claim):
            if gap < best:
                best, where = gap, float(s[k])
    return best, where


def _pairs(mechanism: Mechanism, motion: Motion, s: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield every checked pair: points (S, V, 3) of the first in the frame of the second, and points of the second."""
    turned, moved = mechanism.place(read(motion, s))
    bodies = motion.robot.bodies
    for i, body in enumerate(bodies):
        k = body.joint - 1
        world = body.vertices @ np.swapaxes(turned[:, k], -1, -2) + moved[:, k, None]
        for piece in motion.scene.pieces:
            yield world, piece.vertices
        for other in bodies[:i]:
            pair = (min(body.link, other.link), max(body.link, other.link))
            if pair not in motion.robot.ignored_pairs:
                yield (world - moved[:, other.joint - 1, None]) @ turned[:, other.joint - 1], other.vertices


def _near(mover: np.ndarray, holder: np.ndarray, claim: float) -> Iterator[tuple[int, float]]:
    """Yield the poses whose distance is needed to judge the claim, and that distance.

    The direction found for one pose settles most of the others: along it they are farther apart than claimed.
    """
    low, high = holder.min(axis=0), holder.max(axis=0)
    apart = np.maximum(mover.min(axis=1) - high, low - mover.max(axis=1))
    gap = np.linalg.norm(np.maximum(apart, 0.0), axis=1)
    open_poses = np.flatnonzero(gap < claim + 1e-4)
    while len(open_poses):
        k = int(open_poses[gap[open_poses].argmin()])
        distance, direction = signed_distance(mover[k], holder)
        yield k, distance
        along = (holder @ direction).min() - (mover[open_poses] @ direction).max(axis=1)
        gap[open_poses] = np.maximum(gap[open_poses], along)
        open_poses = open_poses[(along < claim + 1e-4) & (open_poses != k)]


def signed_distance(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray]:
    """Distance and direction from the first hull to the second; when they meet, minus a bound of the depth.

    Overlapping hulls are moved apart by small steps along a few directions: if they still meet after a shift by d in
    all of them, they are at least partly that deep.
    """
    distance, direction = _distance(a, b)
    if distance > _MEETING_M:
        return distance, direction
    directions = np.vstack([np.eye(3), -np.eye(3), a.mean(axis=0) - b.mean(axis=0)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for depth in (1e-3, 1e-4, 1e-5):
        if all(_distance(a + depth * way, b)[0] <= _MEETING_M for way in directions):
            return -depth, direction
    return 0.0, direction


def _distance(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray]:
    weight = 1e3
    matrix = np.zeros((5, len(a) + len(b)))
    matrix[:3, : len(a)], matrix[:3, len(a) :] = a.T, -b.T
    matrix[3, : len(a)], matrix[4, len(a) :] = weight, weight
    shares, _ = nnls(matrix, np.array([0.0, 0.0, 0.0, weight, weight]))
    first, second = shares[: len(a)], shares[len(a) :]
    gap = second @ b / second.sum() - first @ a / first.sum()
    distance = float(np.linalg.norm(gap))
    return distance, gap / distance if distance > _MEETING_M else np.array([0.0, 0.0, 1.0])
