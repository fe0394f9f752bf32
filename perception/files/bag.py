"""Clouds and depth images of ROS bags, moved by their transforms; read by rosbags.

ROS 2: folders, MCAP and SQLite files.  ROS 1: .bag files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from perception.errors import CloudError
from perception.files.depth import make_depth_scan, parse_intrinsics
from perception.files.frames import TRANSFORMS, Tree, read_tree
from perception.files.scan import Scan, find_missing_axis, index_columns, make_scan, quote
from perception.limits import MAX_POINTS

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped

Message = int | Literal["all"]

_TYPE = "sensor_msgs/msg/PointCloud2"
_IMAGE, _INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_PACKED = b"\x28\xb5\x2f\xfd"  # first bytes of a zstd frame; no message starts with them
# Messages of the reader about a truncated file, and the command that repairs it.
_CUT_OFF = {
    "File end magic is invalid": "mcap recover",
    "Bag is not indexed": "rosbag reindex",
    "Bag index looks damaged": "rosbag reindex",
}
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def read_bag(path: Path, name: str, topic: str | None, message: Message) -> Scan:
    """Read one message of each topic with clouds, or all of them, in the frame that the bag's transforms lead to.

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
        bag = _Bag(reader, read, name)
        tree = read_tree(bag.list_messages(TRANSFORMS))
        topics = _select_topics(reader.connections, topic, name)
        if not topics:
            return _read_images(bag, topic, message)
        if len(topics) > 1:
            _check_joined(topics, bag, tree, name)
        return merge_scans([_read_topic(bag, chosen, message, tree) for chosen in topics])


@dataclass(frozen=True)
class _Bag:
    """An open bag: its reader, how messages are decoded, and its name."""

    reader: Any
    decode: Callable[[bytes, str], Any]
    name: str

    def list_messages(self, kind: str) -> Iterator[Any]:
        """Yield all messages of a type, first the static transforms."""
        connections = [connection for connection in self.reader.connections if connection.msgtype == kind]
        for _, _, data in self.reader.messages(connections=connections) if connections else ():
            yield self.decode(_check_unpacked(bytes(data), self.name), kind)

    def select(self, topic: str, kind: str, message: Message) -> tuple[list[Any], int]:
        """Return the requested messages of a topic, and how many it has."""
        connections = [c for c in self.reader.connections if c.topic == topic and c.msgtype == kind]
        n_messages = sum(int(connection.msgcount) for connection in connections)
        where = f"{self.name}: topic {quote(topic)}"
        raw = (_check_unpacked(bytes(data), where) for _, _, data in self.reader.messages(connections=connections))
        return [self.decode(data, kind) for data in _select_messages(raw, message, n_messages, where)], n_messages


def _read_topic(bag: _Bag, topic: str, message: Message, tree: Tree) -> Scan:
    clouds, n_messages = bag.select(topic, _TYPE, message)
    return _merge_messages(clouds, message, n_messages, f"{bag.name}: topic {quote(topic)}", tree)


def _check_joined(topics: Sequence[str], bag: _Bag, tree: Tree, name: str) -> None:
    """
    Raises:
        CloudError: the bag's transforms do not join the frames of its topics.
    """
    frames = {topic: str(bag.select(topic, _TYPE, 0)[0][0].header.frame_id) for topic in topics}
    roots = {tree.find_root(frame) for frame in frames.values()}
    if len(roots) > 1 or not roots.isdisjoint(frames.values()):
        raise CloudError(f"{name}: has clouds on {len(topics)} topics; name one: {quote(', '.join(topics))}")


def _read_images(bag: _Bag, topic: str | None, message: Message) -> Scan:
    """Read depth images with the intrinsics of their CameraInfo, in the camera's frame or moved by transforms.

    Raises:
        CloudError: the bag has no cloud and no such pair, or several.
    """
    names = {c.topic for c in bag.reader.connections if c.msgtype == _IMAGE and "depth" in c.topic}
    infos = {c.topic.rpartition("/")[0]: c.topic for c in bag.reader.connections if c.msgtype == _INFO}
    pairs = {name: infos[name.rpartition("/")[0]] for name in sorted(names) if name.rpartition("/")[0] in infos}
    if topic is not None:
        pairs = {name: info for name, info in pairs.items() if name == topic}
    if not pairs:
        held = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in bag.reader.connections}))
        raise CloudError(
            f"{bag.name}: has no PointCloud2, and no depth image with a CameraInfo beside it; its topics are "
            f"{quote(held) or 'none'}"
        )
    if len(pairs) > 1:
        raise CloudError(f"{bag.name}: has depth images on {len(pairs)} topics; name one: {quote(', '.join(pairs))}")
    ((name, info_name),) = pairs.items()
    (info,), _ = bag.select(info_name, _INFO, 0)
    images, n_images = bag.select(name, _IMAGE, 0 if message == "all" else message)
    matrix = getattr(info, "k", getattr(info, "K", None))
    camera = parse_intrinsics({"K": None if matrix is None else list(matrix)}, f"{bag.name}: {info_name}")
    scan = make_depth_scan(_decode_image(images[0], bag.name), camera, bag.name)
    tree = read_tree(bag.list_messages(TRANSFORMS))
    scan = _move(scan, str(images[0].header.frame_id), _stamp(images[0]), tree)
    if n_images > 1:
        scan = replace(
            scan, notes=(*scan.notes, f"one of {n_images} depth images was read; another one can be requested")
        )
    return scan


def _decode_image(image: Any, name: str) -> Float[np.ndarray, "H W"]:
    """Return the depths of an image of ROS (REP 118) [m]; 0 or NaN where there is none."""
    kinds = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
    if str(image.encoding) not in kinds:
        raise CloudError(f"{name}: image encoding '{quote(str(image.encoding))}' is no depth; expected 16UC1 or 32FC1")
    code, metres = kinds[str(image.encoding)]
    kind = np.dtype((">" if image.is_bigendian else "<") + code)
    height, width, step = int(image.height), int(image.width), int(image.step)
    data = np.ascontiguousarray(image.data)
    if (
        not (height and width)
        or step < width * kind.itemsize
        or data.nbytes < height * step
        or height * width > MAX_POINTS
    ):
        raise CloudError(f"{name}: an image of {width} x {height} pixels in {data.nbytes} bytes; its size is wrong")
    grid: Shaped[np.ndarray, "H W"] = np.ndarray((height, width), kind, data.data, 0, (step, kind.itemsize))
    return metres * grid.astype(np.float64)


def _stamp(message: Any) -> float:
    stamp = message.header.stamp
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _move(scan: Scan, frame: str, stamp: float, tree: Tree) -> Scan:
    """Return a scan moved to the root of the bag's transforms; as it is, with a note, if they do not have its frame."""
    root = tree.find_root(frame)
    if root == frame:
        note = f"the points are in the frame '{quote(frame)}', of which the bag has no transform"
        return replace(scan, notes=(note, *scan.notes))
    pose = tree.find_pose(frame, stamp)
    return Scan(
        scan.points @ pose[:3, :3].T + pose[:3, 3],
        misses=scan.misses @ pose[:3, :3].T + pose[:3, 3],
        starts=pose[:3, 3],
        notes=(f"moved from the frame '{quote(frame)}' to '{quote(root)}' by the bag's transforms", *scan.notes),
    )


def merge_scans(scans: Sequence[Scan]) -> Scan:
    """Return the scans of several sensors in one frame, each point with the start of its ray."""
    if len(scans) == 1:
        return scans[0]
    if sum(len(scan.points) + len(scan.misses) for scan in scans) > MAX_POINTS:
        raise CloudError(f"the clouds of the topics have more than {MAX_POINTS} points together; name one topic")

    def starts_of(scan: Scan, rows: int) -> Float[np.ndarray, "N 3"]:
        return np.broadcast_to(np.zeros(3) if scan.starts is None else scan.starts, (rows, 3))

    return Scan(
        np.concatenate([scan.points for scan in scans]),
        misses=np.concatenate([scan.misses for scan in scans]),
        starts=np.concatenate([starts_of(scan, len(scan.points)) for scan in scans]),
        miss_starts=np.concatenate([starts_of(scan, len(scan.misses)) for scan in scans]),
        notes=tuple(dict.fromkeys(note for scan in scans for note in scan.notes)),
    )


def _select_topics(connections: Sequence[Any], topic: str | None, name: str) -> list[str]:
    """Return the requested topic with clouds, or all of them; empty if there is none."""
    topics = sorted({connection.topic for connection in connections if connection.msgtype == _TYPE})
    if topic is not None and topics and topic not in topics:
        raise CloudError(f"{name}: has no clouds on topic '{quote(topic)}'; it has some on {quote(', '.join(topics))}")
    return topics if topic is None or not topics else [topic]


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


def _merge_messages(clouds: Sequence[Any], message: Message, n_messages: int, where: str, tree: Tree) -> Scan:
    scans, frames = [], set()
    for cloud in clouds:
        frame = str(cloud.header.frame_id)
        scans.append(_move(_parse_message(cloud, where), frame, _stamp(cloud), tree))
        frames.add(quote(tree.find_root(frame)))
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
    notes: tuple[str, ...] = ()
    if len(scans) > 1:
        is_moved = scans[0].starts is not None
        right = "moved by the transforms" if is_moved else "as they stand; that is right for a sensor that stood still"
        notes = (f"merged {len(scans)} messages {right}",)
    elif n_messages > 1:
        notes = (f"message {message} of {n_messages} was read; another one or all can be requested",)
    if all(scan.starts is None for scan in scans):
        return Scan(
            np.concatenate([scan.points for scan in scans]),
            misses=np.concatenate([scan.misses for scan in scans]),
            notes=(*scans[0].notes, *notes),
        )
    merged = merge_scans(scans)
    return replace(merged, notes=(*merged.notes, *notes))


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
