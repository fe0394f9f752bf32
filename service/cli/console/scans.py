"""Scans beside the console: their list, their points, and what detectors find where the operator clicks."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from service.cli.console.scan_changes import APART_M, ScanGroup, describe_groups, find_groups
from service.client import AsyncPlannerClient
from service.errors import RequestError, shown, would_do
from service.proto.planner.v1.planner_pb2 import CloudsSpec
from service.proto.planner.v1.request_pb2 import CloudFile, Start
from service.request.schema import RobotRequest, StartRequest
from service.request.tasks.kind import LARGEST_MOVE_M
from service.viewer.payload import quantize, thin_points

if TYPE_CHECKING:
    from service.scan.cloud import CloudRead

MOST_SCANS = 200
MOST_POINTS = 60_000
MOST_UNSEEN = 20_000
ROUND_ROBOT_M = 0.05  # points this near to the robot's shapes are its own
MOST_HITS = 100  # that a session remembers


def list_scans(folders: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the cloud files in the folders, newest first, with their ages [s]."""
    now = time.time()
    found = [(path.stat().st_mtime, name) for name, path in _find_scans(folders).items()]
    return [
        {"name": name, "age_s": max(0.0, now - written)} for written, name in sorted(found, reverse=True)[:MOST_SCANS]
    ]


def find_scan(folders: Sequence[Path], name: str) -> Path:
    """Return the file of a scan that was listed.

    Raises:
        RequestError: there is none of this name.
    """
    found = _find_scans(folders)
    if name not in found:
        raise RequestError(
            f"scan: there is no scan {shown(name)} here; expected {would_do(name, found) or 'a cloud file in --scans'}"
        )
    return found[name]


async def show_scan(
    folders: Sequence[Path], name: str, robot: str, posture: str | None, most_points: int = MOST_POINTS
) -> dict[str, Any]:
    """Return the points of a scan without those of the robot, packed for the page, and its age.

    Raises:
        RequestError: there is no such scan, or it cannot be read.
    """
    path = find_scan(folders, name)
    cloud = thin_points(await asyncio.to_thread(_read_points, path, robot, posture), most_points)
    return {"name": name, "age_s": max(0.0, time.time() - path.stat().st_mtime), "cloud": quantize(cloud)}


async def show_unseen(folders: Sequence[Path], name: str, robot: str, posture: str | None) -> dict[str, Any]:
    """Return where the space that a scan has seen ends without a surface, packed for the page.

    Raises:
        RequestError: there is no such scan, or it cannot be read.
    """
    unseen = await asyncio.to_thread(_find_unseen, find_scan(folders, name), robot, posture)
    return {"cells": quantize(thin_points(unseen, MOST_UNSEEN))}


async def compare_scans(
    folders: Sequence[Path], name: str, before: str, robot: str, posture: str | None
) -> dict[str, Any]:
    """Return what a scan has that an earlier one had not, and the reverse, packed for the page, with a line about it.

    Raises:
        RequestError: there is no such scan, or it cannot be read.
    """
    paths = find_scan(folders, name), find_scan(folders, before)
    return await asyncio.to_thread(_compare, *paths, robot, posture)


def _compare(path: Path, before: Path, robot: str, posture: str | None) -> dict[str, Any]:
    now, then = (_read_points(each, robot, posture) for each in (path, before))
    added, gone = find_groups(now, then), find_groups(then, now)
    lines = [describe_groups(added, "new"), describe_groups(gone, "gone, or no longer seen")]
    return {
        "line": " · ".join(filter(None, lines)) or f"nothing of {APART_M:g} m moved",
        "added": quantize(thin_points(_join(added), MOST_POINTS)),
        "gone": quantize(thin_points(_join(gone), MOST_POINTS)),
    }


def _join(groups: Sequence[ScanGroup]) -> np.ndarray:
    return np.concatenate([np.empty((0, 3)), *(group.points for group in groups)])


async def detect_at(
    client: AsyncPlannerClient,
    known: dict[int, dict[str, Any]],
    clouds: CloudsSpec,
    at: tuple[float, float, float],
    kinds: Sequence[str],
) -> dict[str, Any]:
    """Return the fits of objects of some kinds at a point that the operator clicked, best first.

    Args:
        known: objects that were found, by number; the new ones are added.

    Raises:
        PlannerError: the server refuses, or does not answer.
    """
    hits: list[dict[str, Any]] = []
    notes: list[str] = []
    for kind in kinds:
        reply = await client.detect(clouds, kind, hint=at)
        notes += [note for note in reply.notes if note not in notes]
        for found in reply.hits:
            hits.append({
                "kind": found.kind,
                "searched": kind,
                "confidence": found.confidence,
                "pose_world_object": np.reshape(found.pose_world_object, (4, 4)).tolist(),
                "sizes": dict(found.sizes),
                "residuals": dict(found.residuals),
                "doubts": list(found.doubts),
                "points": quantize(np.empty((0, 3))),
                "moved_m": [0.0, 0.0, 0.0],
                "clicked": list(at),
            })  # fmt: skip
    hits.sort(key=lambda hit: -hit["confidence"])
    for hit in hits:
        _keep_hit(known, hit)
    return {"hits": hits, "notes": notes}


def move_hit(known: dict[int, dict[str, Any]], number: int, moved_m: Sequence[float]) -> dict[str, Any]:
    """Return a fit as the operator moved it, which is another object from then on.

    Args:
        known: objects that were found, by number; the moved one is added.
        number: of the fit.
        moved_m: displacement from where the scan shows it, in world axes [m].

    Raises:
        RequestError: the fit is not known any more, or the displacement is too large.
    """
    hit = find_hit(known, number)
    size = math.hypot(*moved_m)
    if size > LARGEST_MOVE_M:
        raise RequestError(f"moved_m: {size:.3g} m; expected at most {LARGEST_MOVE_M:g} m, click again for farther")
    pose = np.array(hit["pose_world_object"])
    further = np.subtract(moved_m, hit["moved_m"])
    pose[:3, 3] += further
    moved = {**hit, "pose_world_object": pose.tolist(), "moved_m": list(moved_m)}
    if "clicked" in hit:
        moved["clicked"] = np.add(hit["clicked"], further).tolist()
    _keep_hit(known, moved)
    return moved


def find_hit(known: Mapping[int, dict[str, Any]], number: int) -> dict[str, Any]:
    """Return an object that was found.

    Raises:
        RequestError: it is not known any more.
    """
    if number not in known:
        raise RequestError(f"hit: object {number} is not known any more; click on it again")
    return known[number]


def _keep_hit(known: dict[int, dict[str, Any]], hit: dict[str, Any]) -> None:
    hit["hit"] = max(known, default=0) + 1
    known[hit["hit"]] = hit
    for old in sorted(known)[:-MOST_HITS]:
        del known[old]


async def upload_scan(
    client: AsyncPlannerClient, folders: Sequence[Path], name: str, robot: str, posture: str | None
) -> CloudsSpec:
    """Upload a scan, and return it as a cloud with the robot that stood in it, whose own points are left out.

    Raises:
        RequestError: there is no such scan.
        PlannerError: the server refuses it, or does not answer.
    """
    cloud_id = await client.upload_cloud(find_scan(folders, name))
    start = None if posture is None else Start(posture=posture)
    return CloudsSpec(clouds=[CloudFile(file=cloud_id)], robot=robot, start=start)


def _find_scans(folders: Sequence[Path]) -> dict[str, Path]:
    """Return the cloud files by name; of two with one name, that of the folder given first."""
    from perception import SUFFIXES

    found: dict[str, Path] = {}
    for folder in folders:
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            if path.suffix.lower() in SUFFIXES and path.is_file():
                found.setdefault(path.name, path)
    return found


def _read_points(path: Path, robot: str, posture: str | None) -> np.ndarray:
    """Return the points of a cloud file without those of a robot."""
    from perception import inside_hulls

    read = _read_cloud(path, robot, posture)
    points = read.cloud.points
    own = inside_hulls(points, read.hulls, ROUND_ROBOT_M) if len(read.hulls) else np.zeros(len(points), dtype=bool)
    return np.asarray(points[~own])


def _read_cloud(path: Path, robot: str, posture: str | None) -> CloudRead:
    """Read a cloud file and the robot that stood in it; one that only the server knows keeps its own points."""
    from service.scan.cloud import CloudInput, read_input

    clouds = CloudInput((path,))
    start = StartRequest() if posture is None else StartRequest(posture=posture)
    try:
        return read_input(replace(clouds, robot=RobotRequest(name=robot), start=start), lambda step: None)
    except RequestError:
        return read_input(clouds, lambda step: None)


def _find_unseen(path: Path, robot: str, posture: str | None) -> np.ndarray:
    from perception import CloudError, list_unseen, make_view

    read = _read_cloud(path, robot, posture)
    try:
        view = make_view(read.cloud, robot_hulls=read.hulls, soles=read.soles)
    except CloudError as error:
        raise RequestError(f"scan: {error}") from None
    return list_unseen(view.cloud.rays, view.near.points, view.reach, view.floors, view.robot_hulls)
