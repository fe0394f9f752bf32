"""Paths on plane faces: where a tool is on them, how it leans, and whether they stay on what is there."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.scene import ConvexPiece
from service.demands.regions import find_axis
from service.errors import RequestError
from service.request.tasks.hand_steps import FollowStep
from service.verify import CoalSolid

UP = np.array([0.0, 0.0, 1.0])
OFF_PIECE_M = 0.02  # by which a path may be off the pieces of its face
SPACING_M = 0.02  # of the places at which a path is held to its face


def lean_tool(inwards: Float[np.ndarray, "3"], step: FollowStep) -> Float[np.ndarray, "3"]:
    """Return the direction of the tool's axis."""
    if not step.tilt_deg:
        return inwards
    towards = np.asarray(step.tilt_towards, dtype=float)
    across = towards - (towards @ inwards) * inwards
    if np.linalg.norm(across) < 1e-6:
        raise RequestError("follow.tilt_towards: is along the face's normal; expected a direction along the face")
    across /= np.linalg.norm(across)
    tilt = np.deg2rad(step.tilt_deg)
    return np.asarray(np.cos(tilt) * inwards + np.sin(tilt) * across)


def point_axis(name: str, axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return an orientation with an axis of its own (``x``, ``-z``) along a direction."""
    own = find_axis(name)
    assert own is not None
    return np.asarray(_point_along(axis) @ _point_along(own).T)


def _point_along(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return an orientation with its z axis along a direction."""
    side = np.eye(3)[int(np.abs(axis).argmin())]
    x = side - (side @ axis) * axis
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def find_middle(step: FollowStep, normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the middle of a circle, at the depth of the tool's origin [m]."""
    assert step.circle is not None
    return _bring_to_depth(np.asarray(step.circle.centre, dtype=float), step, normal)


def _bring_to_depth(
    point: Float[np.ndarray, "3"], step: FollowStep, normal: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    height = float((point - np.asarray(step.face.point)) @ normal)
    return np.asarray(point - (height + step.depth_m) * normal)


def list_places(step: FollowStep, normal: Float[np.ndarray, "3"]) -> list[Float[np.ndarray, "3"]]:
    """Return the corners of a path, or where a circle begins [m]."""
    if step.circle is None:
        return [_bring_to_depth(np.asarray(corner, dtype=float), step, normal) for corner in step.polyline]
    above = UP - (UP @ normal) * normal
    if np.linalg.norm(above) < 0.1:
        above = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    above /= np.linalg.norm(above)
    arm = step.circle.radius_m * above
    turned = Rotation.from_rotvec(-np.deg2rad(step.circle.begin_deg) * normal).apply(arm)
    return [np.asarray(find_middle(step, normal) + turned)]


def explain_beyond_edge(step: FollowStep, pieces: Sequence[ConvexPiece]) -> str | None:
    """Return a sentence where a tool that is pressed on a face would leave the pieces that it is pressed on.

    Args:
        step: the path; one in front of its face, or without pieces, stays on nothing.
        pieces: those of its face.
    """
    if not pieces or (step.depth_m < 0.0 and not step.thrust_n):
        return None
    normal = np.asarray(step.face.normal, dtype=float)
    normal = normal / np.linalg.norm(normal)
    points = _sample_path(step, normal) + step.depth_m * normal
    off = np.min([CoalSolid.of_piece(piece).distances(points) for piece in pieces], axis=0)
    worst = int(off.argmax())
    if off[worst] <= OFF_PIECE_M:
        return None
    names = ", ".join(piece.name for piece in pieces)
    return (
        f"at {np.round(points[worst], 3).tolist()} the path is {1e3 * off[worst]:.0f} mm beyond {names}; expected a "
        "path on the pieces of its face"
    )


def _sample_path(step: FollowStep, normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "P 3"]:
    """Return places of a tool's origin along a path [m]."""
    places = list_places(step, normal)
    if step.circle is not None:
        count = max(int(np.deg2rad(step.circle.angle_deg) * step.circle.radius_m / SPACING_M), 8)
        sense = -1.0 if step.circle.sense == "clockwise" else 1.0
        angles = sense * np.deg2rad(np.linspace(0.0, step.circle.angle_deg, count + 1))
        middle = find_middle(step, normal)
        return np.asarray(middle + Rotation.from_rotvec(angles[:, None] * normal).apply(places[0] - middle))
    return np.concatenate(
        [
            np.linspace(first, last, max(int(np.linalg.norm(last - first) / SPACING_M), 1) + 1)
            for first, last in pairwise(places)
        ]
    )
