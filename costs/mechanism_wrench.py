"""Wrenches of a load that moves with a mechanism: corners of a polytope that contains all of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

# Longest arc that one corner beside the ends covers. The corner is 15 % beyond the arc's middle at 60 degrees.
_LONGEST_ARC = np.pi / 3.0


def list_arc_wrenches(
    force: Float[np.ndarray, "3"],
    point: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    origin: Float[np.ndarray, "3"],
    first_rad: float,
    last_rad: float,
) -> Float[np.ndarray, "W 6"]:
    """Return wrenches whose convex hull contains those of a load that turns with a link, at every angle of an arc.

    The load is a force at a point, both fixed to the link and given at angle zero. Its wrench about the world origin is
    ``const + cos(angle) A + sin(angle) B``, an arc of an ellipse: it lies within its tangents, which meet at
    ``const + (cos(mid) A + sin(mid) B) / cos(half)``. Both ends come first. The region of a load that may be absent
    needs the zero wrench besides.

    Args:
        force: on the robot, in the world at angle zero [N].
        point: where it acts, in the world at angle zero [m].
        axis: of the joint, in the world; need not be of unit length.
        origin: a point on the axis [m].
        first_rad, last_rad: ends of the arc, in either sequence.

    Returns:
        (W, 6) force and moment about the world origin [N, Nm]; one row where both ends are equal.

    Raises:
        ValueError: a value is not finite, or the axis has no length.
    """
    force, point, axis, origin = (np.asarray(value, dtype=float) for value in (force, point, axis, origin))
    _check_finite(force=force, point=point, axis=axis, origin=origin, angles=np.array([first_rad, last_rad]))
    axis = _unit(axis)
    constant, cosine, sine = np.zeros(6), np.zeros(6), np.zeros(6)
    # Rodrigues: R = a a^T + cos (1 - a a^T) + sin [a]x. The force is R f, its moment o x R f + R ((p - o) x f).
    for place, vector in ((0, force), (3, np.cross(point - origin, force))):
        along = (axis @ vector) * axis
        constant[place : place + 3], cosine[place : place + 3] = along, vector - along
        sine[place : place + 3] = np.cross(axis, vector)
    for part in (constant, cosine, sine):
        part[3:] += np.cross(origin, part[:3])
    span = last_rad - first_rad
    ends = np.array([first_rad]) if span == 0.0 else np.array([first_rad, last_rad])
    count = int(np.ceil(abs(span) / _LONGEST_ARC - 1e-12))
    middles = first_rad + span * (np.arange(count) + 0.5) / max(count, 1)
    angles = np.concatenate([ends, middles])
    # Where two arcs meet, both tangents are one line: the corners beside it contain the point.
    stretch = np.concatenate([np.ones(len(ends)), np.full(count, 1.0 / np.cos(0.5 * span / max(count, 1)))])
    turning = np.cos(angles)[:, None] * cosine + np.sin(angles)[:, None] * sine
    return np.asarray(constant + stretch[:, None] * turning)


def list_slide_wrenches(
    force: Float[np.ndarray, "3"],
    point: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    first_m: float,
    last_m: float,
) -> Float[np.ndarray, "W 6"]:
    """Return the wrenches at both ends of a slide, whose convex hull contains those between.

    Args:
        force: on the robot, in the world; it keeps its direction [N].
        point: where it acts, in the world at travel zero [m].
        axis: direction of the travel in the world; need not be of unit length.
        first_m, last_m: ends of the travel.

    Returns:
        (W, 6) force and moment about the world origin [N, Nm]; one row where both ends are equal.

    Raises:
        ValueError: a value is not finite, or the axis has no length.
    """
    force, point, axis = (np.asarray(value, dtype=float) for value in (force, point, axis))
    _check_finite(force=force, point=point, axis=axis, travel=np.array([first_m, last_m]))
    travel = np.array([first_m] if first_m == last_m else [first_m, last_m])
    places = point + travel[:, None] * _unit(axis)
    return np.concatenate([np.broadcast_to(force, places.shape), np.cross(places, force)], axis=1)


def _check_finite(**values: Float[np.ndarray, "..."]) -> None:
    for name, value in values.items():
        if not np.isfinite(value).all():
            raise ValueError(f"{name} must be finite, got {value.tolist()}")


def _unit(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise ValueError(f"axis must have a length, got {axis.tolist()}")
    return axis / length
