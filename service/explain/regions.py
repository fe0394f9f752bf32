"""Regions beyond the length of the robot's chains, or apart from a kept one: reasons why no motion exists."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from service.body.regions import KeptRegion
from service.body.whole_body import WholeBody
from service.explain.distance import FOOT_DRIFT, chain_length, position_slack
from service.verify import PoseTarget, RegionTarget, Target

SAME_AXES = 1e-9  # largest difference of rotation matrices that count as equal [-]


def find_regions_out_of_reach(body: WholeBody, targets: Sequence[Target]) -> Iterator[str]:
    """Yield a sentence for each region that no configuration on the planted links brings its frame to."""
    for region in targets:
        if isinstance(region, RegionTarget):
            yield from _check_reach(body, region)


def _check_reach(body: WholeBody, region: RegionTarget) -> Iterator[str]:
    supports: list[tuple[str | None, str, np.ndarray, float]] = [(None, "the base", np.zeros(3), 0.0)]
    if region.reference is not None:
        supports = [(region.reference, region.reference, np.zeros(3), 0.0)]
    elif body.robot.is_floating:
        feet = body.planted
        supports = [(foot.link, foot.link, foot.pose_world_link[:3, 3], FOOT_DRIFT) for foot in feet]
    for link, name, position, drift in supports:
        reach = chain_length(body.robot, link, region.frame) + drift
        away = _measure_away(region, (position - region.position) @ region.rotation)
        if away > reach:
            yield (
                f"{region.frame} cannot reach its region: it is {away:.2f} m from {name}, the chain between them "
                f"at most {reach:.2f} m long"
            )
            return


def _measure_away(region: RegionTarget, offset: Float[np.ndarray, "3"]) -> float:
    """Return a lower bound of the distance of a point, given in the region's axes, from the region [m]."""
    beyond = np.maximum(np.maximum(region.lower - offset, offset - region.upper), 0.0)
    from_axis = float(np.linalg.norm(offset[:2])) - region.radius_m
    return max(float(np.linalg.norm(beyond)), from_axis, float(np.linalg.norm(offset)) - region.distance_m)


def find_contradicting_regions(body: WholeBody, targets: Sequence[Target]) -> Iterator[str]:
    """Yield a sentence for each goal of a frame that lies outside of a region that the frame keeps until the end."""
    for kept in body.kept:
        if not isinstance(kept, KeptRegion) or kept.region.during[1] < 1.0:
            continue
        for target in targets:
            if isinstance(target, PoseTarget | RegionTarget) and target.frame == kept.region.frame:
                gap = _measure_gap(target, kept.region)
                if gap > 0.0:
                    yield f"the goal of {target.frame} is {gap:.3f} m outside of the region that keep demands of it"


def _measure_gap(goal: PoseTarget | RegionTarget, kept: RegionTarget) -> float:
    """Return a lower bound of the distance between the places that a goal and a kept region allow [m]."""
    if isinstance(goal, PoseTarget):
        if kept.reference is not None:
            return 0.0
        return _measure_away(kept, (goal.position - kept.position) @ kept.rotation) - position_slack(goal)
    if goal.reference != kept.reference:
        return 0.0
    between = (goal.position - kept.position) @ kept.rotation
    gap = 0.0
    if np.isfinite(goal.distance_m):
        gap = _measure_away(kept, between) - goal.distance_m
    if np.abs(goal.rotation - kept.rotation).max() <= SAME_AXES:
        apart = np.maximum(between + goal.lower - kept.upper, kept.lower - (between + goal.upper))
        gap = max(gap, float(apart.max()))
    return gap
