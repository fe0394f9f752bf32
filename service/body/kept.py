"""Poses and regions that a request keeps, as the planner keeps them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from costs.kinematics import locate_frame
from costs.robot import RobotModel
from service.body.holds import REGION_SHARE, START_SHARE, KeptPose, relative_pose
from service.body.regions import KeptRegion
from service.demands.regions import find_axis, make_kept_region
from service.demands.targets import make_kept_pose
from service.errors import RequestError
from service.request.keep import KeepRequest

Kept = KeptPose | KeptRegion


def make_kept_poses(robot: RobotModel, start: Float[np.ndarray, "n"], keep: Sequence[KeepRequest]) -> tuple[Kept, ...]:
    """Return what a request keeps from the configuration ``start`` on.

    Raises:
        RequestError: a pair is named twice or cannot move, or is not at its wanted pose at the start.
    """
    kept = tuple(_make_kept(robot, start, entry, index) for index, entry in enumerate(keep))
    problems = [line for index in range(len(keep)) for line in _find_problems(robot, start, kept, index)]
    if problems:
        raise RequestError(problems)
    return kept


def _make_kept(robot: RobotModel, start: Float[np.ndarray, "n"], keep: KeepRequest, index: int) -> Kept:
    held = relative_pose(robot, start, keep.link, keep.relative_to)
    wanted = make_kept_pose(keep, held)
    if not keep.is_plain:
        return KeptRegion(make_kept_region(keep, wanted), f" (keep[{index}])")
    return KeptPose(
        keep.link,
        keep.relative_to,
        held,
        wanted,
        keep.position_tolerance_m,
        float(np.deg2rad(keep.rotation_tolerance_deg)),
        find_axis(keep.free_axis),
    )


def _find_problems(robot: RobotModel, start: Float[np.ndarray, "n"], kept: Sequence[Kept], index: int) -> Iterator[str]:
    """Yield reasons why a kept pose or region cannot be kept."""
    pose, field = kept[index], f"keep[{index}]"
    if isinstance(pose, KeptRegion):
        if not pose.moves(robot):
            yield f"{field}: no joint moves {pose.name}; leave it out"
        else:
            yield from (f"{field}: {problem}" for problem in pose.find_start_problems(robot, start))
        return
    pairs = [{other.link, other.reference} for other in kept[:index] if isinstance(other, KeptPose)]
    if {pose.link, pose.reference} in pairs:
        yield f"{field}: {pose.name} is kept by keep[{pairs.index({pose.link, pose.reference})}] already; leave one out"
    joint = locate_frame(robot, pose.link)[0]
    if joint == (0 if pose.reference is None else locate_frame(robot, pose.reference)[0]):
        yield f"{field}: no joint moves {pose.name}; leave it out"
    distance, angle = pose.errors(pose.held)
    shares = [START_SHARE if is_held else REGION_SHARE for is_held in pose.is_held]
    if distance > shares[0] * pose.position_tolerance_m:
        most = 1e3 * shares[0] * pose.position_tolerance_m
        yield (
            f"{field}: at the start {pose.name} is {1e3 * distance:.1f} mm off the requested position; "
            f"expected at most {most:.2g} mm, {_describe_share(shares[0])} of position_tolerance_m"
        )
    if angle > shares[1] * pose.rotation_tolerance_rad:
        most = np.rad2deg(shares[1] * pose.rotation_tolerance_rad)
        yield (
            f"{field}: at the start {pose.name} is {np.rad2deg(angle):.1f} deg off the requested orientation; "
            f"expected at most {most:.2g} deg, {_describe_share(shares[1])} of rotation_tolerance_deg"
        )


def _describe_share(share: float) -> str:
    return "half" if share == START_SHARE else f"{100.0 * share:.0f} %"
