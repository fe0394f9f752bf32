"""Regions that a request demands, as targets of the verifier: of a goal's pose, and of a kept one on a part."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from costs.rotation import quaternion_matrix
from service.request.keep import KeepRequest
from service.request.tasks.reach import PoseGoalRequest
from service.verify import RegionTarget

SMALLEST_SHIFT, SMALLEST_TURN = 1e-4, 1e-3  # tolerances below these are beyond the optimiser's [m, rad]
WHOLE = np.array([0.0, 1.0])
_AXES = {sign + name: (-1.0 if sign else 1.0) * np.eye(3)[k] for k, name in enumerate("xyz") for sign in ("", "-")}


def find_axis(name: str) -> Float[np.ndarray, "3"] | None:
    """Return the unit axis of a link that a request names; None for ``none``."""
    return None if name == "none" else _AXES[name].copy()


def make_goal_region(pose: PoseGoalRequest) -> RegionTarget:
    """Return the region of a goal's pose; its path parameter is set by the phase."""
    axes = np.eye(3)
    if pose.quaternion_wxyz is not None:
        axes = quaternion_matrix(pose.quaternion_wxyz)
    has_place, is_turned = pose.position is not None, pose.quaternion_wxyz is not None
    return _make_region(pose, pose.relative_to, np.array(pose.origin), axes, WHOLE, has_place, is_turned)


def make_kept_region(keep: KeepRequest, pose: Float[np.ndarray, "4 4"]) -> RegionTarget:
    """Return the region of a kept pose about ``pose_reference_link``.

    With a region or a place to look at, position and orientation are limited where the request gives them.
    """
    during, is_pose = np.array([keep.after, keep.until]), keep.region is None and keep.look_at is None
    has_place = is_pose or keep.position is not None
    is_turned = is_pose or keep.quaternion_wxyz is not None or keep.free_axis != "none"
    return _make_region(keep, keep.relative_to, pose[:3, 3], pose[:3, :3], during, has_place, is_turned)


def _make_region(
    pose: PoseGoalRequest | KeepRequest,
    reference: str | None,
    position: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"],
    during: Float[np.ndarray, "2"],
    has_place: bool,
    is_turned: bool,
) -> RegionTarget:
    """Return a region of a pose.

    Args:
        pose: the request's tolerances.
        reference: frame of the region.
        position, rotation: origin and axes of the region in the reference.
        during: shares of the path.
        has_place: whether a distance from the position is demanded where no bounds are.
        is_turned: whether an angle from the orientation is demanded where no other angles are.
    """
    region = pose.region
    is_bounded = region is not None and any(region.limits_position)
    distance = max(pose.position_tolerance_m, SMALLEST_SHIFT) if has_place and not is_bounded else np.inf
    angle = max(float(np.deg2rad(pose.rotation_tolerance_deg)), SMALLEST_TURN)
    angle = np.inf if angle >= np.pi else angle
    turns, axis, lean, turn, look = np.full(3, np.inf), None, np.inf, np.inf, None
    if pose.look_at is not None:
        # The place is the request's, in the reference; a region has it in its own axes.
        look = (np.array(pose.look_at) - position) @ rotation
        axis, lean = find_axis(pose.look_axis), angle
    elif region is not None and region.limits_rotation:
        turns = _fill(region.turns_deg, np.inf, np.pi / 180.0)
    elif is_turned and pose.free_axis != "none":
        axis, lean = find_axis(pose.free_axis), angle
    elif is_turned:
        turn = angle
    return RegionTarget(
        frame=pose.link,
        reference=reference,
        position=position,
        rotation=rotation,
        lower=np.full(3, -np.inf) if region is None else _fill(region.lower, -np.inf),
        upper=np.full(3, np.inf) if region is None else _fill(region.upper, np.inf),
        radius_m=np.inf if region is None or region.radius_m is None else region.radius_m,
        distance_m=distance,
        turn_rad=turn,
        turns_rad=turns,
        axis=axis,
        look=look,
        lean_rad=lean,
        during=during,
    )


def _fill(limits: tuple[float | None, ...], free: float, unit: float = 1.0) -> Float[np.ndarray, "3"]:
    """Return limits in SI units, those that are not given as ``free``."""
    return np.array([free if limit is None else unit * limit for limit in limits])
