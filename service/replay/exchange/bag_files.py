"""Trajectories in bags: MCAP files and folders or files of rosbag and rosbag2, read by rosbags without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from service.errors import RequestError, shown
from service.replay.exchange.joint_trajectory import JointTrajectory
from service.replay.exchange.ros_types import (
    DISPLAY_TRAJECTORY,
    JOINT_TRAJECTORY,
    MISSING,
    ROBOT_TRAJECTORY,
    TRAJECTORIES,
    load_types,
)
from service.replay.exchange.text_files import FIELDS

MAX_BAG_BYTES = 2**30
MAX_MESSAGE_BYTES = 256 * 2**20


def read_bag_trajectory(path: Path, topic: str | None = None, message: int | None = None) -> JointTrajectory:
    """Read one trajectory message (JointTrajectory, RobotTrajectory or DisplayTrajectory) of a bag.

    Args:
        topic: of a bag with trajectories on several topics.
        message: number of the message, -1 for the last; needed where there are several.

    Raises:
        RequestError: the bag cannot be read, or which message is meant is open.
    """
    is_ros1 = path.suffix.lower() == ".bag"
    store = load_types(is_ros1=is_ros1)
    files = [path] if path.is_file() else [file for file in path.glob("*") if file.is_file()]
    size = sum(file.stat().st_size for file in files)
    if size > MAX_BAG_BYTES:
        raise RequestError(f"{path.name}: is {size} bytes long; expected at most {MAX_BAG_BYTES}")
    try:
        return _read(path, store, topic, message, is_ros1=is_ros1)
    except RequestError:
        raise
    except ImportError as error:
        raise RequestError(MISSING.format(name=error.name)) from None
    except Exception as error:  # the reader raises many types
        raise RequestError(f"{path.name}: cannot be read as a bag: {shown(str(error))}") from None


def _read(path: Path, store: Any, topic: str | None, message: int | None, *, is_ros1: bool) -> JointTrajectory:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    with Reader1(path) if is_ros1 else Reader2(path) as reader:
        held = [connection for connection in reader.connections if connection.msgtype in TRAJECTORIES]
        topics = sorted({connection.topic for connection in held})
        if not topics:
            others = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections})) or "none"
            raise RequestError(f"{path.name}: has no trajectory; its topics are {shown(others)}")
        plain = sorted({connection.topic for connection in held if connection.msgtype == JOINT_TRAJECTORY})
        if topic is None and len(plain) == 1:  # the same motion may be there as a DisplayTrajectory, too
            topic = plain[0]
        if topic is None and len(topics) > 1:
            raise RequestError(
                f"{path.name}: has trajectories on {len(topics)} topics; --topic names one: {_list(topics)}"
            )
        if topic is not None and topic not in topics:
            raise RequestError(
                f"{path.name}: has no trajectory on topic {shown(topic)}; it has some on {_list(topics)}"
            )
        chosen = [connection for connection in held if connection.topic == (topic or topics[0])]
        count = sum(int(connection.msgcount) for connection in chosen)
        if message is None and count > 1:
            raise RequestError(f"{path.name}: has {count} trajectories; --message names one, -1 is the last")
        index = (message or 0) if (message or 0) >= 0 else count + (message or 0)
        for number, (connection, _, raw) in enumerate(reader.messages(connections=chosen)):
            if number != index:
                continue
            if len(raw) > MAX_MESSAGE_BYTES:
                raise RequestError(f"{path.name}: its message is {len(raw)} bytes long")
            read = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
            return convert_message(read(raw, connection.msgtype), connection.msgtype, path.name)
        raise RequestError(f"{path.name}: has no message {message}; it has {count} trajectories, 0 is the first")


def _list(names: Sequence[str]) -> str:
    return ", ".join(shown(name) for name in names[:5]) + (" and others" if len(names) > 5 else "")


def convert_message(message: Any, kind: str, source: str) -> JointTrajectory:
    """Return the trajectory of a message of ``trajectory_msgs`` or ``moveit_msgs``.

    Raises:
        RequestError: it holds no trajectory, or several.
    """
    if kind == DISPLAY_TRAJECTORY:
        if len(message.trajectory) != 1:
            raise RequestError(f"{source}: holds {len(message.trajectory)} trajectories; expected one")
        message, kind = message.trajectory[0], ROBOT_TRAJECTORY
    if kind == ROBOT_TRAJECTORY:
        if message.multi_dof_joint_trajectory.points and len(message.multi_dof_joint_trajectory.joint_names):
            raise RequestError(f"{source}: moves joints of several degrees of freedom; columns base_x ... are read")
        message = message.joint_trajectory
    names = tuple(str(name) for name in message.joint_names)
    columns = {field: _stack(message.points, field, len(names), source) for field in FIELDS}
    if columns["positions"] is None:
        raise RequestError(f"{source}: has no positions")
    times = np.array([_seconds(point.time_from_start) for point in message.points])
    return JointTrajectory(
        names, times, columns["positions"], columns["velocities"], columns["accelerations"], source=source
    )


def _stack(points: Sequence[Any], field: str, width: int, source: str) -> np.ndarray | None:
    rows = [np.asarray(getattr(point, field), dtype=float) for point in points]
    if not any(len(row) for row in rows):
        return None
    for index, row in enumerate(rows):
        if len(row) != width:
            raise RequestError(f"{source}: point {index} has {len(row)} numbers as {field}; expected {width}")
    return np.stack(rows)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
