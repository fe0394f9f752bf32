"""Poses of all links at all samples, for the viewer files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel


@dataclass(frozen=True)
class LinkPlacements:
    """World poses of links at the samples of a trajectory.

    Attributes:
        links: L link names.
        poses: (S, L, 7) ``x y z qw qx qy qz`` in the world [m]; unit quaternions whose sign does not flip from one
            sample to the next.  S may be 0 (a scene without a robot pose) or 1 (a single pose).
    """

    links: tuple[str, ...]
    poses: Float[np.ndarray, "S L 7"]

    def __post_init__(self) -> None:
        if self.poses.ndim != 3 or self.poses.shape[1:] != (len(self.links), 7):
            raise ValueError(f"poses must have shape (S, {len(self.links)}, 7), got {self.poses.shape}")
        if not np.isfinite(self.poses).all():
            raise ValueError("poses must be finite")


def place_links(robot: RobotModel, q: Float[np.ndarray, "S n"], links: Sequence[str]) -> LinkPlacements:
    """Return the poses of ``links`` at configurations ``q`` (internal coordinates, see ``RobotModel``).

    Raises:
        ValueError: the robot lacks a link.
    """
    unknown = [link for link in links if not robot.model.existFrame(link)]
    if unknown:
        raise ValueError(f"unknown link {unknown[0]!r}; {robot.name} does not have it")
    data = robot.model.createData()
    frames = [robot.model.getFrameId(link) for link in links]
    poses = np.empty((len(q), len(links), 7))
    for sample, configuration in enumerate(np.asarray(q, dtype=float)):
        pin.framesForwardKinematics(robot.model, data, configuration)
        for column, frame in enumerate(frames):
            x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(data.oMf[frame])
            poses[sample, column] = (x, y, z, qw, qx, qy, qz)
    return LinkPlacements(tuple(links), align_signs(poses))


def list_drawn_frames(robot: RobotModel, result: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the links and frames that a viewer draws: all links, and the frames and joints of targets and checks."""
    names = [body["link"] for body in result.get("bodies") or []]
    names.extend((result.get("robot") or {}).get("links_without_shape") or [])
    for section in (*(result.get("phases") or []), result.get("obstruction") or {}):
        names.extend(target["frame"] for target in section.get("targets") or [] if target.get("frame"))
    for check in result.get("checks") or []:
        names.extend((check.get("where") or {}).get("names") or [])
    return tuple(dict.fromkeys(name for name in names if robot.model.existFrame(name)))


def align_signs(poses: Float[np.ndarray, "S L 7"]) -> Float[np.ndarray, "S L 7"]:
    """Return the poses with unit quaternions whose signs do not flip from one sample to the next.

    ``q`` and ``-q`` are the same rotation, but interpolation between them turns the link by a full turn.
    """
    poses = np.array(poses, dtype=float)
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    dots = np.sum(poses[1:, :, 3:] * poses[:-1, :, 3:], axis=-1)
    signs = np.cumprod(np.where(dots < 0.0, -1.0, 1.0), axis=0)
    poses[1:, :, 3:] *= signs[..., None]
    return poses
