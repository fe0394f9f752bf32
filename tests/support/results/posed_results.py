"""A result with a graph of poses: the little biped of ``viewer_results`` crouches at places of three phases."""

from __future__ import annotations

from typing import Any

import numpy as np
from viewer_results import LINKS, make_result, placements

from service.viewer import LinkPlacements

SENTENCES = ["leaving 'crouch' on l_foot: contact forces can err by 3 N at most, 5 N are required", "no way to 'rise'"]
COSTS = (0.04, 0.003, 0.002, 0.005, 0.7, 0.05)
TO_END = (101.0, 95.0, 94.0, None, 60.0, 0.05)
PHASES = ("sit", "crouch", "crouch", "crouch", "crouch", "rise")
PLACES = (0, 0, 1, 4, 7, 0)
PATH = [0, 1, 5]
SIDE_M = 0.9
"""How far the poses stand beside the motion, that they are not covered by it."""


def make_graph() -> dict[str, Any]:
    """A ``pose_graph`` as ``json.loads`` would give it; its configurations are empty."""
    poses = [
        {"phase": phase, "place": place, "cost": cost, "cost_to_end": to_end, "q": []}
        for phase, place, cost, to_end in zip(PHASES, PLACES, COSTS, TO_END, strict=True)
    ]
    counts = {"sit": (1, 1, 0), "crouch": (9, 5, 1), "rise": (1, 1, 0)}
    return {
        "phases": [
            {"name": name, "solved": solved, "feasible": feasible, "duplicates": alike, "failures": {}}
            for name, (solved, feasible, alike) in counts.items()
        ],
        "poses": poses,
        "path": PATH,
        "cost": 100.5,
        "slip_m": 2e-4,
        "not_linked": list(SENTENCES),
    }


def place_graph() -> LinkPlacements:
    """Links at the poses of ``make_graph``: pose 4 on the right of the motion, all others on its left."""
    poses = np.repeat(placements(1).poses, len(COSTS), axis=0)
    poses[..., 1] += np.where(np.arange(len(COSTS)) == 4, -SIDE_M, SIDE_M)[:, None]
    poses[..., 0] += 0.1 * np.arange(len(COSTS))[:, None]
    poses[:, LINKS.index("torso"), 2] -= 0.05 * np.arange(len(COSTS))
    return LinkPlacements(LINKS, poses)


def make_posed_result() -> tuple[dict[str, Any], LinkPlacements]:
    """The result of ``viewer_results`` with the graph."""
    result, moved = make_result()
    return {**result, "pose_graph": make_graph()}, moved
