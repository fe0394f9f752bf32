"""Reader of trajectory files of every kind."""

from __future__ import annotations

from pathlib import Path

from service.errors import RequestError
from service.replay.exchange.bag_files import read_bag_trajectory
from service.replay.exchange.joint_trajectory import JointTrajectory
from service.replay.exchange.text_files import read_text_trajectory

TEXT_SUFFIXES = (".yaml", ".yml", ".json", ".csv", ".npz")
BAG_SUFFIXES = (".mcap", ".db3", ".bag")


def read_trajectory(path: str | Path, topic: str | None = None, message: int | None = None) -> JointTrajectory:
    """Read a trajectory: YAML, JSON, CSV, NPZ, MCAP, or a bag of ROS 1 or ROS 2 (a folder, or its file).

    Args:
        path: the file, or a bag's folder.
        topic, message: which message of a bag; needed where it holds several trajectories.

    Raises:
        RequestError: the file cannot be read as its name says; the message names it.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return read_bag_trajectory(path, topic, message)
    if not path.exists():
        raise RequestError(f"{path.name}: does not exist")
    if kind in BAG_SUFFIXES:
        return read_bag_trajectory(path, topic, message)
    if kind in TEXT_SUFFIXES:
        return read_text_trajectory(path)
    expected = ", ".join((*TEXT_SUFFIXES, *BAG_SUFFIXES))
    raise RequestError(f"{path.name}: is no trajectory by its name; expected one of {expected}, or a bag's folder")
