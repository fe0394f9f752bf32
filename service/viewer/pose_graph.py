"""Graph of poses from which a sequence was chosen, for the viewer page: costs, the chosen path, and links to draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from costs.robot import RobotModel
from service.viewer.payload import pack, quantize
from service.viewer.placements import LinkPlacements, place_links

MAX_POSE_BYTES = 750_000
"""Largest size of the drawn poses before they are written as text, which takes 4/3 of it [bytes]."""

MAX_SHOWN_POSES = 4000
"""Largest number of poses in the picture of the graph."""

MAX_FAILURES = 6
"""Largest number of reasons per phase why poses do not hold."""

_BYTES_PER_LINK = 7 * 2


def place_poses(robot: RobotModel, result: Mapping[str, Any]) -> LinkPlacements | None:
    """Return the links of all bodies at the poses of ``result["pose_graph"]``, one sample per pose.

    None without a graph.

    Raises:
        ValueError: a configuration has another number of coordinates than the robot, or a body's link is unknown.
    """
    graph = result.get("pose_graph")
    if not graph:
        return None
    rows = [pose["q"] for pose in graph["poses"]]
    wrong = [len(row) for row in rows if len(row) != robot.n]
    if wrong:
        raise ValueError(f"pose_graph.poses[].q: {wrong[0]} coordinates; {robot.name} has {robot.n}")
    links = dict.fromkeys(body["link"] for body in result.get("bodies") or [])
    return place_links(robot, np.array(rows, dtype=float).reshape(len(rows), robot.n), list(links))


def make_pose_graph(graph: Mapping[str, Any], poses: LinkPlacements) -> dict[str, Any]:
    """Return the picture of a graph of poses, and the poses of its links, JSON-ready.

    Args:
        graph: ``pose_graph`` of a result (docs/result-format.md).
        poses: of the links that are drawn, one sample per pose of the graph.

    Of too many poses the picture has the ``MAX_SHOWN_POSES`` that matter most (``rank_poses``), and the scene as many
    of these as ``MAX_POSE_BYTES`` hold. ``drawn`` is the row of a pose in ``positions`` (D, L, 3) and ``rotations``
    (D, L, 4), -1 for a pose that only the picture has; ``left_out`` counts those that are not in the picture.

    Raises:
        ValueError: graph and placements have different numbers of poses, or a pose is of an unknown phase.
    """
    given = graph["poses"]
    if len(given) != len(poses.poses):
        raise ValueError(f"graph has {len(given)} poses, placements have {len(poses.poses)}")
    columns = {phase["name"]: column for column, phase in enumerate(graph["phases"])}
    unknown = sorted({pose["phase"] for pose in given} - set(columns))
    if unknown:
        raise ValueError(f"pose_graph.poses[].phase: {unknown[0]!r} is not among the phases")
    order = rank_poses(given, graph["path"])
    shown = np.sort(order[:MAX_SHOWN_POSES])
    n_drawn = min(MAX_POSE_BYTES // (_BYTES_PER_LINK * max(len(poses.links), 1)), len(shown))
    drawn = np.sort(order[:n_drawn])
    rows = np.full(len(given), -1)
    rows[drawn] = np.arange(n_drawn)
    place_of = np.full(len(given), -1)
    place_of[shown] = np.arange(len(shown))
    table = poses.poses[drawn]
    return {
        "phases": [_make_phase(phase) for phase in graph["phases"]],
        "poses": [
            {
                "phase": columns[given[i]["phase"]],
                "place": given[i]["place"],
                "cost": given[i]["cost"],
                "cost_to_end": given[i]["cost_to_end"],
                "drawn": int(rows[i]),
            }
            for i in shown
        ],
        "left_out": len(given) - len(shown),
        "path": [int(place_of[i]) for i in graph["path"]],
        "cost": graph.get("cost"),
        "slip_m": graph.get("slip_m"),
        "not_linked": list(graph.get("not_linked") or []),
        "links": list(poses.links),
        "positions": quantize(table[..., :3]),
        "rotations": pack(np.round(table[..., 3:] * 32767.0), "i2"),
    }


def rank_poses(poses: Sequence[Mapping[str, Any]], path: Sequence[int]) -> Int[np.ndarray, "N"]:
    """Return the indices of poses by importance: the path, then the cheapest to the end of each phase in turn."""
    to_end = np.array([np.inf if pose["cost_to_end"] is None else pose["cost_to_end"] for pose in poses])
    cost = np.array([pose["cost"] for pose in poses], dtype=float)
    turn = np.zeros(len(poses), dtype=int)
    phases = [pose["phase"] for pose in poses]
    for phase in dict.fromkeys(phases):
        own = np.array([i for i, name in enumerate(phases) if name == phase])
        turn[own[np.lexsort((cost[own], to_end[own]))]] = np.arange(len(own))
    turn[np.asarray(path, dtype=int)] = -1
    return np.asarray(np.argsort(turn, kind="stable"))


def _make_phase(phase: Mapping[str, Any]) -> dict[str, Any]:
    """Return a phase with its commonest failures, and how many others there are."""
    failures = sorted((phase.get("failures") or {}).items(), key=lambda item: -item[1])
    return {
        **{key: phase[key] for key in ("name", "solved", "feasible", "duplicates")},
        "failures": [[text, count] for text, count in failures[:MAX_FAILURES]],
        "other_failures": sum(count for _, count in failures[MAX_FAILURES:]),
    }
