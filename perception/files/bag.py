"""PointCloud2 messages of ROS bags, read by rosbags: ROS 2 (folder, MCAP, SQLite) and ROS 1."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from perception.errors import CloudError
from perception.files.scan import Scan, find_missing_axis, index_columns, make_scan, quote
from perception.limits import MAX_POINTS

if TYPE_CHECKING:
    from jaxtyping import Shaped

Message = int | Literal["all"]

_TYPE = "sensor_msgs/msg/PointCloud2"
_PACKED = b"\x28\xb5\x2f\xfd"  # first bytes of a zstd frame; no message starts with them
# Messages of the reader about a truncated file, and the command that repairs it.
_CUT_OFF = {
    "File end magic is invalid": "mcap recover",
    "Bag is not indexed": "rosbag reindex",
    "Bag index looks damaged": "rosbag reindex",
}
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def read_bag(path: Path, name: str, topic: str | None, message: Message) -> Scan:
    """Read one message of a topic, or all of them merged, in the frame they were recorded in.

    Raises:
        CloudError: the bag cannot be used; the message names ``name`` and the fault.
    """
    try:
        return _read(path, name, topic, message)
    except CloudError:
        raise
    except Exception as error:  # the reader raises several types
        remedy = next((tool for words, tool in _CUT_OFF.items() if words in str(error)), "")
        if not remedy:
            raise
        raise CloudError(f"{name}: its recording was cut off, it seems; '{remedy}' makes it whole again") from None


def _read(path: Path, name: str, topic: str | None, message: Message) -> Scan:
    from rosbags.rosbag1 import Reader as Reader1  # optional
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = path.suffix.lower() == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    read = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
    with Reader1(path) if is_ros1 else Reader2(path) as reader:
        connections = _select_topic(reader.connections, topic, name)
        where = f"{name}: topic {quote(connections[0].topic)}"
        n_messages = sum(int(connection.msgcount) for connection in connections)
        raw = (_check_unpacked(bytes(data), where) for _, _, data in reader.messages(connections=connections))
        clouds = (read(data, _TYPE) for data in _select_messages(raw, message, n_messages, where))
        return _merge_messages(clouds, message, n_messages, where)


def _select_topic(connections: Sequence[Any], topic: str | None, name: str) -> list[Any]:
    """Return the connections of the requested topic, or of the only topic with clouds."""
    clouds = [connection for connection in connections if connection.msgtype == _TYPE]
    topics = sorted({connection.topic for connection in clouds})
    if not topics:
        held = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in connections}))
        raise CloudError(f"{name}: has no PointCloud2; its topics are {quote(held) or 'none'}")
    if topic is None and len(topics) > 1:
        raise CloudError(f"{name}: has clouds on {len(topics)} topics; name one: {quote(', '.join(topics))}")
    if topic is not None and topic not in topics:
        raise CloudError(f"{name}: has no clouds on topic '{quote(topic)}'; it has some on {quote(', '.join(topics))}")
    return [connection for connection in clouds if connection.topic == (topic or topics[0])]


def _select_messages(raw: Iterator[bytes], message: Message, n_messages: int, where: str) -> Iterator[bytes]:
    """Yield the requested raw messages."""
    if message == "all":
        yield from raw
        return
    index = message if message >= 0 else n_messages + message
    chosen = next(islice(raw, index, None), None) if index >= 0 else None
    if not n_messages:
        raise CloudError(f"{where}: holds no message; at least one is needed")
    if chosen is None:
        raise CloudError(f"{where}: has no message {message}; it has {n_messages}, 0 is the first and -1 the last")
    yield chosen


def _check_unpacked(data: bytes, where: str) -> bytes:
    """Return the message unchanged; the reader has unpacked it if the bag's metadata says that messages are packed.

    Raises:
        CloudError: the message is still packed.
    """
    if data.startswith(_PACKED):
        raise CloudError(f"{where}: its messages are compressed, as only metadata.yaml can say; give the bag's folder")
    return data


def _merge_messages(clouds: Iterator[Any], message: Message, n_messages: int, where: str) -> Scan:
    scans, frames = [], set()
    for cloud in clouds:
        scans.append(_parse_message(cloud, where))
        frames.add(quote(str(cloud.header.frame_id)))
        if len(frames) > 1:
            frame_list = ", ".join(sorted(frames))
            raise CloudError(f"{where}: its messages are in different frames ({frame_list}); choose one message")
        if sum(len(scan.points) + len(scan.misses) for scan in scans) > MAX_POINTS:
            raise CloudError(
                f"{where}: its first {len(scans)} messages have more than {MAX_POINTS} points together; choose one"
            )
    if not scans:
        raise CloudError(f"{where}: holds no message; at least one is needed")
    if not any(len(scan.points) + len(scan.misses) for scan in scans):
        if message == "all" or n_messages == 1:
            raise CloudError(f"{where}: its {len(scans)} messages hold no points; at least one is needed")
        raise CloudError(f"{where}: message {message} of {n_messages} holds no points; choose another one, or all")
    notes = [
        f"the points are in the frame '{frames.pop()}'; transforms recorded in the bag are not read, only one that is "
        "given with it"
    ]
    if len(scans) > 1:
        notes.append(f"merged {len(scans)} messages as they stand; that is right for a sensor that stood still")
    elif n_messages > 1:
        notes.append(f"message {message} of {n_messages} was read; another one or all can be requested")
    return Scan(
        np.concatenate([scan.points for scan in scans]),
        misses=np.concatenate([scan.misses for scan in scans]),
        notes=tuple(notes),
    )


def _parse_message(cloud: Any, where: str) -> Scan:
    """Make a scan of one PointCloud2."""
    width, height, stride, row = (int(n) for n in (cloud.width, cloud.height, cloud.point_step, cloud.row_step))
    n_points, there = width * height, int(cloud.data.nbytes)
    if not n_points:
        return Scan(np.zeros((0, 3)))
    if n_points > MAX_POINTS:
        raise CloudError(f"{where}: a message announces {n_points} points; at most {MAX_POINTS} are read")
    row = max(row, width * stride)
    if (height - 1) * row + width * stride > there:
        raise CloudError(f"{where}: {n_points} points of {stride} bytes are announced, {there} bytes are there")
    indices = index_columns([str(field.name) for field in cloud.fields])
    if missing := find_missing_axis(indices):
        raise CloudError(f"{where}: its fields have no '{missing}'; x, y and z are needed")
    order = ">" if cloud.is_bigendian else "<"
    data = np.ascontiguousarray(cloud.data)
    columns: dict[str, Shaped[np.ndarray, "N"]] = {}
    for key, i in indices.items():
        field = cloud.fields[i]
        if int(field.datatype) not in _KINDS:
            raise CloudError(f"{where}: field '{key}' has datatype {field.datatype}; 1 to 8 are possible")
        kind = np.dtype(order + _KINDS[int(field.datatype)])
        if int(field.offset) + kind.itemsize > stride:
            raise CloudError(f"{where}: field '{key}' at byte {field.offset} lies outside points of {stride} bytes")
        grid: Shaped[np.ndarray, "H W"] = np.ndarray((height, width), kind, data.data, int(field.offset), (row, stride))
        columns[key] = grid.ravel()
    return make_scan(columns, None)
