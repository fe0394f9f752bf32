"""Writer of the result folder."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel, read_robot_visuals
from service.errors import ResultError, shown
from service.result.folder import (
    GLB_NAME,
    OPENRAVE_NAME,
    RESULT_NAME,
    ROBOT_NAME,
    TRAJECTORY_NAME,
    VIEWER_NAME,
    ResultFiles,
    check_folder,
    replace_folder,
)
from service.result.manifest import write_manifest
from service.result.motion_json import samples_of
from service.result.result import PlanResult
from service.result.result_json import to_result_json
from service.verify import Motion
from service.viewer import (
    add_objects,
    list_drawn_frames,
    place_links,
    place_poses,
    trace_hand_contacts,
    write_glb,
    write_openrave,
    write_viewer,
)

URDF_NAME = "robot.urdf"  # in the folder of a robot


def write_result(result: PlanResult, folder: str | Path) -> ResultFiles:
    """Write a result folder as a whole, also when interrupted; an earlier result is replaced.

    Raises:
        ResultError: the folder holds something else or cannot be written.
    """
    folder = Path(folder)
    check_folder(folder)
    data = to_result_json(result)
    try:
        with replace_folder(folder) as fresh:
            (fresh / RESULT_NAME).write_text(json.dumps(data, allow_nan=False), encoding="utf-8")
            _write_trajectory(result, data["trajectory"], fresh / TRAJECTORY_NAME)
            write_robot(result.robot, fresh / ROBOT_NAME)
            draw_views(result.robot, result.motion, result.start, data, fresh)
            write_manifest(fresh, data)
    except OSError as error:
        raise ResultError(f"{folder} cannot be written: {error.strerror or error}") from None
    return ResultFiles(folder)


def _write_trajectory(result: PlanResult, trajectory: Mapping[str, Any], path: Path) -> None:
    """Write the samples: time, positions as in ``result.json``, then velocities and accelerations of a timed motion."""
    header = ["time", *trajectory["joint_names"]]
    columns = [np.array(trajectory["times"])[:, None], np.array(trajectory["positions"])]
    for kind, rates in (("velocity", result.velocities), ("acceleration", result.accelerations)):
        if rates is not None:
            header += [f"{kind}.{name}" for name in result.joint_names]
            columns.append(rates)
    table = np.hstack(columns)
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header=",".join(header), comments="")


def write_robot(robot: RobotModel, folder: Path) -> None:
    """Write a robot's URDF, SRDF and meshes to a new folder (OSError, ResultError: it cannot be written)."""
    folder.mkdir(parents=True)
    (folder / URDF_NAME).write_text(robot.source.urdf, encoding="utf-8")
    if robot.source.srdf:
        (folder / "robot.srdf").write_text(robot.source.srdf, encoding="utf-8")
    for name, source in robot.source.files.items():
        target = folder / name
        if not target.resolve().is_relative_to(folder.resolve()):
            raise ResultError(f"mesh path {shown(name)} leads out of the result folder")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def draw_views(
    robot: RobotModel, motion: Motion | None, start: Float[np.ndarray, "n"], data: Mapping[str, Any], folder: Path
) -> None:
    """Write the drawings of a result into a folder; equal results give equal bytes.

    Args:
        robot: the result's robot, without the joints that the task moves.
        motion: the result's motion; None draws the start.
        start: configuration at the start.
        data: content of ``result.json``.
        folder: folder of the files.
    """
    q = start[None] if motion is None else motion.curve(samples_of(motion))
    visuals = [mesh for mesh in read_robot_visuals(robot) if robot.model.existFrame(mesh.link)]
    links = tuple(dict.fromkeys([*list_drawn_frames(robot, data), *(mesh.link for mesh in visuals)]))
    placements = place_links(robot, q[:, : robot.n], links)
    if motion is not None:
        placements = add_objects(placements, motion, samples_of(motion))
    pressed = () if motion is None else trace_hand_contacts(motion, samples_of(motion), data)
    write_viewer(data, placements, folder / VIEWER_NAME, place_poses(robot, data), visuals, pressed)
    write_glb(data, placements, folder / GLB_NAME)
    write_openrave(data, folder / OPENRAVE_NAME)
