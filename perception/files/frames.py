"""Frames of a bag: transforms recorded as tf messages, and poses in the frame at their root."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from perception.errors import CloudError
from perception.files.scan import quote

if TYPE_CHECKING:
    from jaxtyping import Float

TRANSFORMS = "tf2_msgs/msg/TFMessage"
_MOST_TRANSFORMS = 1_000_000


@dataclass(frozen=True)
class Link:
    """A frame's parent and its poses in it over time.

    Attributes:
        times: (K,) ascending [s].
        poses: (K, 7) x y z qw qx qy qz in the parent.
    """

    parent: str
    times: Float[np.ndarray, "K"]
    poses: Float[np.ndarray, "K 7"]

    def pose_at(self, time: float) -> Float[np.ndarray, "4 4"]:
        """Return the last pose up to a time, the first if there is none before."""
        row = self.poses[max(0, int(np.searchsorted(self.times, time, side="right")) - 1)]
        w, x, y, z = row[3:] / np.linalg.norm(row[3:])
        pose = np.eye(4)
        pose[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
        pose[:3, 3] = row[:3]
        return pose


@dataclass(frozen=True)
class Tree:
    """Frames by name, without a leading slash."""

    links: Mapping[str, Link]

    def find_root(self, frame: str) -> str:
        """Return the frame at the root of the tree that has this one; itself if it has no parent.

        Raises:
            CloudError: the frames have each other as parents.
        """
        return self._climb(frame)[-1] if frame.lstrip("/") in self.links else frame

    def find_pose(self, frame: str, time: float) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a frame in its root at a time [s]."""
        pose = np.eye(4)
        for name in self._climb(frame)[:-1]:
            pose = self.links[name].pose_at(time) @ pose
        return pose

    def _climb(self, frame: str) -> list[str]:
        names = [frame.lstrip("/")]
        while names[-1] in self.links:
            names.append(self.links[names[-1]].parent)
            if names[-1] in names[:-1]:
                raise CloudError(f"the transforms of the bag turn in a circle at the frame '{quote(names[-1])}'")
        return names


def read_tree(messages: Iterable[Any]) -> Tree:
    """Return the tree of all transforms of tf messages; those that are not finite or have no rotation are left out."""
    rows: dict[str, list[tuple[float, str, list[float]]]] = {}
    n_rows = 0
    for message in messages:
        for entry in message.transforms:
            move, turn = entry.transform.translation, entry.transform.rotation
            values = [float(v) for v in (move.x, move.y, move.z, turn.w, turn.x, turn.y, turn.z)]
            if not np.isfinite(values).all() or np.linalg.norm(values[3:]) < 1e-6:
                continue
            stamp = float(entry.header.stamp.sec) + 1e-9 * float(entry.header.stamp.nanosec)
            parent = str(entry.header.frame_id).lstrip("/")
            rows.setdefault(str(entry.child_frame_id).lstrip("/"), []).append((stamp, parent, values))
            n_rows += 1
        if n_rows > _MOST_TRANSFORMS:
            break
    links = {}
    for child, entries in rows.items():
        entries.sort(key=lambda entry: entry[0])
        own = [entry for entry in entries if entry[1] == entries[-1][1]]
        links[child] = Link(own[0][1], np.array([entry[0] for entry in own]), np.array([entry[2] for entry in own]))
    return Tree(links)
