"""Which files of the server a request may name: uploaded ones, built scenes, and what lies under allowed folders."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from service.errors import shown
from service.request.scene import MeshRequest, SceneRequest
from service.request.schema import PlanRequest, RobotRequest
from service.trust.errors import TrustError

UPLOADED, BUILT = "sha256:", "scene:"
Kind = Literal["cloud", "scene", "mesh", "file"]
_IDS: dict[Kind, str] = {
    "cloud": "the cloud_id of an uploaded cloud",
    "scene": "the scene_id of a scene that was built, the cloud_id of an uploaded one",
    "mesh": "the cloud_id of an uploaded STL, OBJ or PLY file",
    "file": "",
}
NO_FOLDERS = "this server reads no files of its own (`scopt serve --allow FOLDER` has it read those of a folder)"


@dataclass(frozen=True)
class AllowedFolders:
    """What paths of a request may mean on the server.

    Paths are absolute, and where they lead once every symbolic link is followed is under one of ``folders``; or they
    are the id of what was uploaded, or of a scene that was built.

    Attributes:
        folders: as real paths; ``allowed_folders`` makes them.
        has_upload: whether an id is that of an uploaded file.
        has_scene: whether an id is that of a scene that was built.
    """

    folders: tuple[Path, ...]
    has_upload: Callable[[str], bool]
    has_scene: Callable[[str], bool]

    def problems(self, request: PlanRequest) -> list[tuple[str, str]]:
        """Every path of a request that it may not name: the field, and what would do."""
        return [(field, words) for field, path, kind in paths_of(request) if (words := self.refused(path, kind))]

    def scene_problems(self, scene: SceneRequest) -> list[tuple[str, str]]:
        """As ``problems``, of a scene alone."""
        return [(field, words) for field, path, kind in _scene_paths(scene) if (words := self.refused(path, kind))]

    def refused(self, path: str, kind: Kind = "cloud") -> str:
        """Why a path may not be named where a ``kind`` is asked for; empty if it may."""
        if path.startswith(UPLOADED):
            if kind == "file":
                return f"what was uploaded is no file of this kind, got {shown(path)}; {self._would_do(kind)}"
            there = self.has_upload(path)
            return "" if there else f"no {kind} {shown(path)} is there; upload it first, or again"
        if path.startswith(BUILT) and kind == "scene":
            there = self.has_scene(path)
            return "" if there else f"no scene {shown(path)} is there; it never was, or went when the store was full"
        if not os.path.isabs(path):
            return f"no path on the server, got {shown(path)}; {self._would_do(kind)}"
        try:
            real = Path(os.path.realpath(path))
        except (OSError, ValueError):
            real = None
        if real is None or not any(real.is_relative_to(folder) for folder in self.folders):
            return f"not a file that requests may name, got {shown(path)}; {self._would_do(kind)}"
        return ""

    def _would_do(self, kind: Kind) -> str:
        known = _IDS[kind]
        if self.folders:
            under = f"an absolute path under {' or '.join(map(str, self.folders))} would do"
            return f"{known} or {under}" if known else under
        return f"{f'{known} would do; ' if known else ''}{NO_FOLDERS}"


def allowed_folders(
    folders: Sequence[Path], has_upload: Callable[[str], bool], has_scene: Callable[[str], bool]
) -> AllowedFolders:
    """The real paths of folders that requests may name files in.

    Raises:
        TrustError: one is no folder, or is the whole disk.
    """
    real = []
    for folder in folders:
        path = Path(os.path.realpath(folder))
        if not path.is_dir():
            raise TrustError(f"--allow {folder}: is no folder")
        if path == path.parent:
            raise TrustError(f"--allow {folder}: is the whole disk; name the folder that holds the files")
        real.append(path)
    return AllowedFolders(tuple(real), has_upload, has_scene)


def paths_of(request: PlanRequest) -> Iterator[tuple[str, str, Kind]]:
    """Every path of a request: its field, itself as it was written, and what it is to lead to."""
    yield from _robot_paths(request.robot)
    yield from _scene_paths(request.scene)


def _robot_paths(robot: RobotRequest) -> Iterator[tuple[str, str, Kind]]:
    for key, path in (("urdf", robot.urdf), ("srdf", robot.srdf)):
        if path is not None:
            yield f"robot.{key}", path, "file"
    for index, path in enumerate(robot.package_dirs):
        yield f"robot.package_dirs[{index}]", path, "file"


def _scene_paths(scene: SceneRequest) -> Iterator[tuple[str, str, Kind]]:
    if scene.file is not None:
        yield "scene.file", scene.file, "scene"
    for index, cloud in enumerate(scene.cloud_files):
        yield ("scene.cloud" if isinstance(scene.cloud, str) else f"scene.cloud[{index}].file"), cloud.file, "cloud"
    for index, obstacle in enumerate(scene.obstacles):
        if isinstance(obstacle, MeshRequest):
            yield f"scene.obstacles[{index}].file", obstacle.file, "mesh"
