"""Poses of the objects that hands carry, at all samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from service.verify import Motion, split_motion
from service.viewer.placements import LinkPlacements, align_signs, place_links


def add_objects(placed: LinkPlacements, motion: Motion, s: Float[np.ndarray, "S"]) -> LinkPlacements:
    """Return placements with the objects of a motion appended, each where its carrier has it.

    Args:
        placed: of the robot's links at samples.
        motion: the motion.
        s: path parameters of the samples.
    """
    if not motion.objects:
        return placed
    names = tuple(item.name for item in motion.objects)
    q, parts = motion.curve(s), split_motion(motion)
    rows = find_phase_rows(motion, s)
    poses = np.empty((len(s), len(names), 7))
    for number, part in enumerate(parts):
        own = rows == number
        if own.any():
            poses[own] = place_links(part.robot, q[own], names).poses
    both = np.concatenate([placed.poses, align_signs(poses)], axis=1)
    return LinkPlacements((*placed.links, *names), both)


def find_phase_rows(motion: Motion, s: Float[np.ndarray, "S"]) -> np.ndarray:
    """Return the number of the phase at each path parameter; the earlier one at a border."""
    return np.searchsorted([phase.last for phase in motion.phases[:-1]], s)


def list_object_bodies(result: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """Return the objects of a ``result.json`` like the bodies of links."""
    return [
        {"name": item["name"], "link": item["name"], "vertices": item["vertices"]}
        for item in result.get("objects") or []
    ]
