"""The page that shows the robot in physics beside the planned one, with both forces of the ground."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from service.result.motion_json import samples_of
from service.simulation.run import SimulatedRun
from service.viewer import (
    add_objects,
    list_drawn_frames,
    make_pose_graph,
    place_links,
    place_poses,
    trace_hand_contacts,
)
from service.viewer.files import replace_file
from service.viewer.html import render_viewer
from service.viewer.movables import place_movables
from service.viewer.payload import make_payload, pack, quantize, select_samples


def write_page(data: Mapping[str, Any], execution: SimulatedRun, report: Mapping[str, Any], path: Path) -> None:
    """Write the viewer page of a result with the simulated robot as a layer (``y`` hides it) and its verdict on top.

    Args:
        data: content of ``result.json``.
        execution: of that result.
        report: of the execution.
        path: file to write.
    """
    robot, motion = execution.reference.robot, execution.reference.motion
    frames = list_drawn_frames(robot, data)
    planned = add_objects(place_links(robot, motion.curve(samples_of(motion)), frames), motion, samples_of(motion))
    pressed = trace_hand_contacts(motion, samples_of(motion), data)
    payload = make_payload(data, planned, hand_contacts=pressed)
    poses = place_poses(robot, data)
    if poses is not None:
        payload["pose_graph"] = make_pose_graph(data["pose_graph"], poses)
    payload["notes"] = [*payload["notes"], *(f"in physics: {line}" for line in report["notes"])]
    payload["simulated"] = {
        "verdict": report["verdict"],
        "reasons": report["explanation"],
        **_make_simulated(data, execution, frames),
    }
    replace_file(path, render_viewer(payload).encode("utf-8"))


def _make_simulated(data: Mapping[str, Any], execution: SimulatedRun, frames: tuple[str, ...]) -> dict[str, Any]:
    """Return the poses of the payload's links in physics, and the ground's force, at the page's frame rate."""
    record, reference = execution.record, execution.reference
    rows = np.flatnonzero(record.times >= -1e-9)
    rows = rows[select_samples(record.times[rows], ())]
    q = record.configuration[rows]
    own = place_links(reference.robot, q, frames)
    n_own = reference.robot.n - len(reference.mechanism_names)
    movables = [
        {**movable, "angles": q[:, n_own + reference.mechanism_names.index(movable["joint"])].tolist()}
        for movable in data["movables"]
    ]
    moved = place_movables(movables, len(rows))
    objects = [record.objects[item.name][rows][:, None] for item in reference.motion.objects]
    poses = np.concatenate([own.poses, *objects, moved.poses], axis=1)
    size = (len(record.times), 3)
    ground = [
        np.linalg.norm(sum((wrench[:, :3] for wrench in table.values()), start=np.zeros(size)), axis=1)[rows]
        for table in (record.planned_wrenches, record.wrenches)
    ]
    return {
        "times": pack(record.times[rows], "f4"),
        "positions": quantize(poses[..., :3]),
        "rotations": pack(np.round(poses[..., 3:] * 32767.0), "i2"),
        "ground": pack(np.stack(ground, axis=1), "f4"),
    }
