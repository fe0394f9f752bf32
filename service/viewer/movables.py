"""Poses of the links of mechanisms (a wheel, a door with its lever) at all samples, along their tree of joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from service.viewer.placements import LinkPlacements, align_signs


def place_movables(movables: Sequence[Mapping[str, Any]], n_samples: int) -> LinkPlacements:
    """Return the poses of the links of ``result["movables"]`` at the samples of the trajectory.

    A link's frame stands at its joint's origin and has the world's axes while all joints are at 0. A movable without
    one angle per sample stays at its first angle, else at its ``start``.

    Args:
        movables: entries of ``result["movables"]`` (docs/result-format.md); parents in any order.
        n_samples: S; with 0 the single pose at the start is returned.

    Raises:
        ValueError: a parent is no movable, or parents form a cycle.
    """
    poses: dict[str, Float[np.ndarray, "S 4 4"]] = {}
    for chain in sorted(list_chains(movables), key=len):
        above = chain[-2] if len(chain) > 1 else None
        poses[chain[-1]["name"]] = _place_link(chain[-1], above, poses, n_samples)
    names = tuple(str(movable["name"]) for movable in movables)
    table = np.empty((max(n_samples, 1), len(names), 7))
    for column, name in enumerate(names):
        table[:, column, :3] = poses[name][:, :3, 3]
        table[:, column, 3:] = Rotation.from_matrix(poses[name][:, :3, :3]).as_quat(scalar_first=True)
    return LinkPlacements(names, align_signs(table))


def list_chains(movables: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Return each movable after its ancestors, in the order of ``movables``.

    Raises:
        ValueError: a parent is no movable, or parents form a cycle.
    """
    by_name = {movable["name"]: movable for movable in movables}
    chains = []
    for movable in movables:
        chain = [movable]
        while (parent := chain[0].get("parent")) is not None:
            if parent not in by_name:
                raise ValueError(f"movable {chain[0]['name']!r}: its parent {parent!r} is no movable")
            if len(chain) > len(movables):
                raise ValueError(f"movable {movable['name']!r}: its parents form a cycle")
            chain.insert(0, by_name[parent])
        chains.append(chain)
    return chains


def read_angles(movable: Mapping[str, Any], n_samples: int) -> Float[np.ndarray, "S"]:
    """Return a movable's value at every sample [rad, m]; constant if the result has not one per sample."""
    angles = np.asarray(movable.get("angles") or [], dtype=float)
    if len(angles) == n_samples > 0:
        return angles
    start = angles[0] if len(angles) else float(movable.get("start") or 0.0)
    return np.full(max(n_samples, 1), start)


def make_local_bodies(movable: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a movable's bodies with their vertices in the link's frame [m]."""
    origin = np.asarray(movable["origin"], dtype=float)
    return [{**body, "vertices": np.asarray(body["vertices"], dtype=float) - origin} for body in movable["bodies"]]


def is_prismatic(movable: Mapping[str, Any]) -> bool:
    """Return whether a movable slides along its axis instead of turning about it."""
    return bool(movable.get("type") == "prismatic")


def _place_link(
    movable: Mapping[str, Any],
    above: Mapping[str, Any] | None,
    poses: Mapping[str, Float[np.ndarray, "S 4 4"]],
    n_samples: int,
) -> Float[np.ndarray, "S 4 4"]:
    """Return ``pose_world_link`` at every sample; ``above`` is the parent, which ``poses`` has."""
    values = read_angles(movable, n_samples)
    axis = np.asarray(movable["axis"], dtype=float)
    axis = axis / np.linalg.norm(axis)
    pose_parent_link = np.tile(np.eye(4), (len(values), 1, 1))
    pose_parent_link[:, :3, 3] = movable["origin"]
    if is_prismatic(movable):
        pose_parent_link[:, :3, 3] += values[:, None] * axis
    else:
        pose_parent_link[:, :3, :3] = Rotation.from_rotvec(values[:, None] * axis).as_matrix()
    if above is None:
        return pose_parent_link
    pose_parent_link[:, :3, 3] -= np.asarray(above["origin"], dtype=float)
    return np.asarray(poses[above["name"]] @ pose_parent_link)
