"""``scopt scene``: a cloud file as a JSON file of convex pieces."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from costs.robot import RobotError, load_robot
from perception import PerceptionError, Reach, perceive, read_cloud
from service.errors import RequestError, ResultError
from service.request import StartRequest
from service.request_file import load_start
from service.result_json import piece_json, plain
from service.start import FEET_GROUP, placed_bodies, sole, start_configuration

FORMAT = "scopt-scene/1"


def perceive_file(
    cloud: Path,
    reach_m: float,
    robot: str | None,
    posture: Path | None,
    apply_viewpoint: bool,
    on_step: Callable[[str], None],
) -> dict[str, Any]:
    """Pieces and figures of a cloud file, JSON-ready.

    Args:
        cloud: the file.
        reach_m: horizontal radius about the world's origin that is kept [m].
        robot: a bundled robot whose own points are left out, standing as ``posture`` (a file that holds what a
            request's ``start`` holds) says, or as it stands by default.
        posture: see ``robot``.
        apply_viewpoint: whether the points are in the sensor's frame.
        on_step: told the name of each step before it begins.

    Raises:
        RequestError: one line for a file, name or value that cannot be used.
    """
    started = time.perf_counter()
    hulls: list[np.ndarray] = []
    soles: list[np.ndarray] = []
    if robot is not None:
        on_step("load robot")
        hulls, soles = _robot_in_the_way(robot, posture)
    try:
        on_step("read cloud")
        points = read_cloud(cloud, apply_viewpoint=apply_viewpoint)
        on_step("find pieces")
        seen = perceive(points, reach=Reach(radius=reach_m), robot_hulls=hulls, soles=soles, valve=False)
    except PerceptionError as error:
        raise RequestError(str(error)) from None
    pieces = seen.scene.pieces
    return {
        "format": FORMAT,
        "pieces": [piece_json(piece) for piece in pieces],
        "figures": {
            "points": len(points.points),
            "pieces": len(pieces),
            "largest_piece_vertices": max((len(piece.vertices) for piece in pieces), default=0),
            "reach_m": reach_m,
            "time_s": round(time.perf_counter() - started, 3),
        },
        "timings": plain(dict(seen.timings)),
        "notes": list(seen.notes),
    }


def write_scene(scene: dict[str, Any], path: Path) -> None:
    """Write the scene as JSON, as a whole or not at all.

    Raises:
        ResultError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as scratch:
            fresh = Path(scratch) / path.name
            fresh.write_text(json.dumps(scene, allow_nan=False), encoding="utf-8")
            os.replace(fresh, path)
    except OSError as error:
        raise ResultError(f"{path} cannot be written: {error.strerror or error}") from None


def _robot_in_the_way(name: str, posture: Path | None) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Hulls and soles of a bundled robot in the world."""
    try:
        robot = load_robot(name)
    except RobotError as error:
        raise RequestError(f"--robot: {error}") from None
    q, _ = start_configuration(robot, StartRequest() if posture is None else load_start(posture))
    feet = robot.link_groups.get(FEET_GROUP, ()) if robot.is_floating else ()
    return [vertices for _, vertices in placed_bodies(robot, q)], [sole(robot, q, foot) for foot in feet]
