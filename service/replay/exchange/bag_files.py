"""Trajectories in bags: MCAP files and folders or files of rosbag and rosbag2, read by rosbags without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from service.errors import RequestError, shown
from service.replay.exchange.joint_trajectory import JointTrajectory
from service.replay.exchange.messages import parse_trajectory
from service.replay.exchange.ros_types import JOINT_TRAJECTORY, MISSING, TRAJECTORIES, load_types

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
            trajectory = convert_message(read(raw, connection.msgtype), path.name)
            unread = [name for name in topics if name != connection.topic]
            note = (f"the bag's trajectories on {_list(unread)} are not read",) if unread else ()
            return replace(trajectory, notes=(*trajectory.notes, *note))
        raise RequestError(f"{path.name}: has no message {message}; it has {count} trajectories, 0 is the first")


def _list(names: Sequence[str]) -> str:
    return ", ".join(shown(name) for name in names[:5]) + (" and others" if len(names) > 5 else "")


def convert_message(message: Any, source: str) -> JointTrajectory:
    """Return the trajectory of a message of ``trajectory_msgs`` or ``moveit_msgs``.

    Raises:
        RequestError: it holds no trajectory, or several.
    """
    return parse_trajectory(_to_plain(message), source)


def _to_plain(value: Any) -> Any:
    """Return a message as mappings and lists; arrays stay arrays."""
    if is_dataclass(value) and not isinstance(value, type):
        names = (field.name for field in fields(value) if not field.name.startswith("__"))
        return {name: _to_plain(getattr(value, name)) for name in names}
    return [_to_plain(entry) for entry in value] if isinstance(value, list | tuple) else value
