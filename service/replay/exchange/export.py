"""Exports of a plan: a bag of ROS 2 with the robot beside it, an MCAP file, or an archive of NumPy."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np
import yaml

from service.errors import ResultError, shown
from service.replay.exchange.recorded_plan import RecordedPlan
from service.replay.exchange.ros_messages import describe, encode, list_messages, list_topics, make_plain_trajectory
from service.replay.exchange.ros_types import MISSING, load_types
from service.result.result import PlanResult

Target = Literal["ros2", "mcap", "numpy"]
SUFFIXES: dict[Target, str] = {"ros2": "-ros2", "mcap": ".mcap", "numpy": ".npz"}
BAG_NAME, TRAJECTORY_NAME, ROBOT_NAME = "bag", "joint_trajectory.yaml", "robot"
_PACKAGE = re.compile(r"""(filename\s*=\s*["'])package://""")


def export(source: PlanResult | str | Path, target: Target, path: str | Path, *, any_verdict: bool = False) -> Path:
    """Write a plan for other programs, as a whole; an earlier export is replaced, nothing else.

    - ``ros2``: a folder with ``bag`` (rosbag2 with SQLite: JointTrajectory, DisplayTrajectory, PlanningScene, markers,
      joint states, and tf of a floating base), ``joint_trajectory.yaml`` for ``ros2 topic pub``, and ``robot`` with
      meshes by relative paths.
    - ``mcap``: one file with the same messages, for Foxglove and ``ros2 bag play``.
    - ``numpy``: one archive with joint_names, times, positions, velocities, accelerations, base and scene.

    Args:
        source: a result, or the folder that it was written to.
        target: kind of the export.
        path: file or folder to write.
        any_verdict: whether a motion without a certificate is exported as well.

    Raises:
        ResultError: the result has no certificate or no motion, or ``path`` holds something else or cannot be written.
    """
    plan, path = RecordedPlan.of(source), Path(path)
    if plan.verdict != "CERTIFIED" and not any_verdict:
        raise ResultError(f"the verdict is {shown(plan.verdict)}; --any-verdict exports the motion all the same")
    if target != "numpy" and not plan.is_timed:
        raise ResultError("the motion is untimed, and messages of ROS need times; plan with options.timed: true")
    if target == "ros2":
        _write_folder(plan, path)
        return path
    write = _write_mcap if target == "mcap" else _write_archive
    content = BytesIO()
    write(plan, content)
    with _replace(path) as fresh:
        fresh.write_bytes(content.getvalue())
    return path


@contextmanager
def _replace(path: Path) -> Iterator[Path]:
    """Yield a new path that takes the place of ``path`` once the body has succeeded.

    Raises:
        ResultError: ``path`` cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as scratch:
            fresh = Path(scratch) / "fresh"
            yield fresh
            if path.is_dir():
                os.rename(path, Path(scratch) / "earlier")
            os.replace(fresh, path)
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror or error}") from None


def _write_folder(plan: RecordedPlan, path: Path) -> None:
    if path.exists() and not (path / BAG_NAME / "metadata.yaml").is_file():
        raise ResultError(f"{path} holds no earlier export; name a new folder")
    with _replace(path) as fresh:
        fresh.mkdir()
        _write_bag(plan, fresh / BAG_NAME)
        text = yaml.safe_dump(make_plain_trajectory(plan), sort_keys=False, default_flow_style=None, width=1000)
        (fresh / TRAJECTORY_NAME).write_text(text, encoding="utf-8")
        write_robot(plan, fresh / ROBOT_NAME)


def write_robot(plan: RecordedPlan, folder: Path) -> None:
    """Write the robot's URDF with its meshes beside it, named by relative paths, which every reader resolves.

    Raises:
        ResultError: a mesh path leads out of the folder.
    """
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(_PACKAGE.sub(r"\1", plan.urdf), encoding="utf-8")
    for name, source in plan.files.items():
        place = folder / name
        if not place.resolve().is_relative_to(folder.resolve()):
            raise ResultError(f"mesh path {shown(name)} leads out of the folder")
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, place)


def _write_bag(plan: RecordedPlan, path: Path) -> None:
    try:
        from rosbags.rosbag2 import Writer
    except ImportError:
        raise ResultError(MISSING.format(name="rosbags")) from None
    messages = list(list_messages(plan))
    with Writer(path, version=8) as bag:
        connections = {
            topic: bag.add_connection(topic, kind, typestore=load_types())
            for topic, kind in list_topics(messages).items()
        }
        for stamped in messages:
            bag.write(connections[stamped.topic], stamped.time_ns, encode(stamped))


def _write_mcap(plan: RecordedPlan, file: BytesIO) -> None:
    try:
        from mcap.writer import Writer
    except ImportError:
        raise ResultError(MISSING.format(name="mcap")) from None
    messages = list(list_messages(plan))
    writer = Writer(file)
    writer.start(profile="ros2", library="scopt")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for topic, kind in list_topics(messages).items():
        if kind not in schemas:
            schemas[kind] = writer.register_schema(name=kind, encoding="ros2msg", data=describe(kind).encode())
        channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schemas[kind])
    for number, stamped in enumerate(messages):
        writer.add_message(
            channel_id=channels[stamped.topic],
            log_time=stamped.time_ns,
            publish_time=stamped.time_ns,
            data=encode(stamped),
            sequence=number,
        )
    writer.finish()  # type: ignore[no-untyped-call]


def _write_archive(plan: RecordedPlan, file: BytesIO) -> None:
    arrays = {
        "joint_names": np.array(plan.joint_names),
        "times": plan.times,
        "positions": plan.positions,
        "verdict": np.array(plan.verdict),
        "piece_names": np.array(list(plan.pieces)),
        "piece_kinds": np.array([kind for kind, _ in plan.pieces.values()]),
        "piece_sizes": np.array([len(vertices) for _, vertices in plan.pieces.values()], dtype=int),
        "piece_vertices": np.vstack([np.zeros((0, 3)), *(vertices for _, vertices in plan.pieces.values())]),
    }
    if plan.is_timed:
        arrays |= {"velocities": plan.velocities, "accelerations": plan.accelerations}
    if plan.base is not None and plan.base_velocities is not None:
        arrays |= {"base_poses": plan.base, "base_velocities": plan.base_velocities}
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
