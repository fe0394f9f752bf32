"""Cloud files of the kinds that libraries write, made for tests."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

CLOUD = "sensor_msgs/msg/PointCloud2"


def las_bytes(
    points: np.ndarray, *, is_compressed: bool = False, scale: float = 0.001, crs: Any = None, **columns: np.ndarray
) -> bytes:
    """A LAS 1.2 file with the points rounded to ``scale``, and the record ``crs`` of its coordinate system.

    ``columns`` are such as ``withheld`` or ``classification``.
    """
    import laspy

    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = np.full(3, scale)
    header.offsets = np.floor(points.min(axis=0))
    if crs is not None:
        header.vlrs.append(crs)
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    for name, values in columns.items():
        setattr(las, name, values)
    stream = io.BytesIO()
    las.write(stream, do_compress=is_compressed, laz_backend=laspy.LazBackend.Lazrs if is_compressed else None)
    return stream.getvalue()


def write_e57(path: Path, scans: Sequence[dict[str, object]]) -> None:
    """An E57 file; a scan has ``points`` and may have ``position``, ``quaternion_wxyz`` and a ``state`` per point."""
    import pye57

    with pye57.E57(str(path), mode="w") as file:
        for scan in scans:
            points = np.asarray(scan["points"], dtype=float)
            data = {f"cartesian{axis}": points[:, i].copy() for i, axis in enumerate("XYZ")}
            if "state" in scan:
                data["cartesianInvalidState"] = np.asarray(scan["state"], dtype=np.int8)
            file.write_scan_raw(
                data,
                rotation=np.asarray(scan.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))),
                translation=np.asarray(scan.get("position", (0.0, 0.0, 0.0))),
            )


def cloud_message(store: object, points: np.ndarray, frame: str = "lidar", **changes: object) -> object:
    """A PointCloud2 of float32 x y z with an intensity before them and padding behind."""
    types = store.types  # type: ignore[attr-defined]
    field = types["sensor_msgs/msg/PointField"]
    stride = 20
    table = np.zeros(
        len(points), np.dtype({"names": list("xyz"), "formats": ["<f4"] * 3, "offsets": [4, 8, 12], "itemsize": stride})
    )
    for i, axis in enumerate("xyz"):
        table[axis] = points[:, i]
    stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    header = changes.pop("header", None) or types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)
    content: dict[str, object] = {
        "header": header,
        "height": 1,
        "width": len(points),
        "fields": [field("intensity", 0, 7, 1), *(field(axis, 4 + 4 * i, 7, 1) for i, axis in enumerate("xyz"))],
        "is_bigendian": False,
        "point_step": stride,
        "row_step": stride * len(points),
        "data": np.frombuffer(table.tobytes(), np.uint8),
        "is_dense": True,
    }
    return types[CLOUD](**{**content, **changes})


def write_bag(
    folder: Path, clouds: dict[str, Sequence[tuple[np.ndarray, str]]], storage: str = "mcap", compression: Any = None
) -> None:
    """A ROS 2 bag folder with the clouds (points, frame) of each topic; ``compression`` is one of rosbags' modes."""
    from rosbags.rosbag2 import CompressionFormat, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    bag = Writer(folder, version=9, storage_plugin=plugin)
    if compression is not None:
        bag.set_compression(compression, CompressionFormat.ZSTD)
    with bag as writer:
        for topic, messages in clouds.items():
            connection = writer.add_connection(topic, CLOUD, typestore=store)
            for i, (points, frame) in enumerate(messages):
                raw = store.serialize_cdr(cloud_message(store, points, frame), CLOUD)
                writer.write(connection, 1_000_000_000 * (i + 1), raw)
