"""Ways of carried objects followed by inverse kinematics: up, across and down."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from costs.kinematics import locate_links
from costs.terms import FramePose
from service.body.holds import Hold, project_within_limits
from service.body.ladder import Path
from service.body.whole_body import WholeBody

RISES_M = (0.0, 0.1)  # above the higher end, at which the way goes across


def _place(body: WholeBody, tool: str, target: Float[np.ndarray, "4 4"]) -> Hold:
    """Return the hold of a tool at a pose."""
    return lambda waypoints: FramePose(body.robot, tool, waypoints, target)


def list_ways_over(
    body: WholeBody, tool: str, first: Float[np.ndarray, "n"], last: Float[np.ndarray, "n"], count: int
) -> Iterator[tuple[str, Path]]:
    """Yield paths between two configurations on which a tool goes up, across and down."""
    ends = [locate_links(body.engine, q, [tool])[tool] for q in (first, last)]
    for rise in RISES_M:
        top = max(end[2, 3] for end in ends) + rise
        corners = [ends[0][:3, 3], *(np.array([*end[:2, 3], top]) for end in ends), ends[1][:3, 3]]
        yield f"over it, {1e3 * rise:.0f} mm higher", _follow(body, tool, corners, ends, first, last, count)


def _follow(
    body: WholeBody,
    tool: str,
    corners: Sequence[Float[np.ndarray, "3"]],
    ends: Sequence[Float[np.ndarray, "4 4"]],
    first: Float[np.ndarray, "n"],
    last: Float[np.ndarray, "n"],
    count: int,
) -> Path:
    """Return waypoints that lead a tool along corners, each the nearest to the one before; both ends are exact.

    What is missed at the end is taken back along the way.  Obstacles are left to the optimiser.
    """
    lengths = np.concatenate([[0.0], np.cumsum([np.linalg.norm(b - a) for a, b in pairwise(corners)])])
    turns = Slerp([0.0, 1.0], Rotation.from_matrix([end[:3, :3] for end in ends]))
    path, reserved = [first], body.bounds(1, {})
    for share in np.linspace(0.0, 1.0, count)[1:]:
        target = np.eye(4)
        at = share * lengths[-1]
        target[:3, 3] = [np.interp(at, lengths, [corner[k] for corner in corners]) for k in range(3)]
        target[:3, :3] = turns(share).as_matrix()
        # The nearest configuration alone would stay bent: lead it towards the end as well.
        guess = path[-1] + (last - path[-1]) / max(count - len(path), 1)
        holds = (*body.holds(), _place(body, tool, target))
        path.append(project_within_limits(body.engine, guess[None], holds, *reserved)[0])
    q = np.stack(path)
    return np.asarray(q + np.linspace(0.0, 1.0, count)[:, None] * (last - q[-1]))
