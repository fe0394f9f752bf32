"""Which files of the server a request may name: uploaded clouds, and what lies under allowed folders."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from service.errors import shown
from service.request import PlanRequest, RobotRequest
from service.request_scene import MeshRequest, SceneRequest
from service.trust.errors import TrustError

UPLOADED = "sha256:"
NO_FOLDERS = "this server reads no files of its own (`scopt serve --allow FOLDER` has it read those of a folder)"


@dataclass(frozen=True)
class AllowedFolders:
    """What paths of a request may mean on the server.

    Paths are absolute, and where they lead once every symbolic link is followed is under one of ``folders``; or they
    are the id of an uploaded cloud.

    Attributes:
        folders: as real paths; ``allowed_folders`` makes them.
        has_cloud: whether an id is that of an uploaded cloud.
    """

    folders: tuple[Path, ...]
    has_cloud: Callable[[str], bool]

    def problems(self, request: PlanRequest) -> list[tuple[str, str]]:
        """Every path of a request that it may not name: the field, and what would do."""
        paths = paths_of(request)
        return [(field, words) for field, path, is_cloud in paths if (words := self.refused(path, is_cloud=is_cloud))]

    def scene_problems(self, scene: SceneRequest) -> list[tuple[str, str]]:
        """As ``problems``, of a scene alone."""
        return [
            (f, words) for f, path, is_cloud in _scene_paths(scene) if (words := self.refused(path, is_cloud=is_cloud))
        ]

    def refused(self, path: str, *, is_cloud: bool = True) -> str:
        """Why a path may not be named; empty if it may.

        Args:
            is_cloud: whether it stands where a cloud is asked for.
        """
        if path.startswith(UPLOADED):
            if not is_cloud:
                return f"an uploaded cloud is no file of this kind, got {shown(path)}; {self._would_do(is_cloud)}"
            return "" if self.has_cloud(path) else f"no cloud {shown(path)} is there; upload it first, or again"
        if not os.path.isabs(path):
            return f"no path on the server, got {shown(path)}; {self._would_do(is_cloud)}"
        try:
            real = Path(os.path.realpath(path))
        except (OSError, ValueError):
            real = None
        if real is None or not any(real.is_relative_to(folder) for folder in self.folders):
            return f"not a file that requests may name, got {shown(path)}; {self._would_do(is_cloud)}"
        return ""

    def _would_do(self, is_cloud: bool) -> str:
        uploaded = "the cloud_id of an uploaded cloud"
        if self.folders:
            under = f"an absolute path under {' or '.join(map(str, self.folders))} would do"
            return f"{uploaded} or {under}" if is_cloud else under
        return f"{f'{uploaded} would do; ' if is_cloud else ''}{NO_FOLDERS}"


def allowed_folders(folders: Sequence[Path], has_cloud: Callable[[str], bool]) -> AllowedFolders:
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
    return AllowedFolders(tuple(real), has_cloud)


def paths_of(request: PlanRequest) -> Iterator[tuple[str, str, bool]]:
    """Every path of a request: its field, itself as it was written, and whether it is a cloud's."""
    yield from _robot_paths(request.robot)
    yield from _scene_paths(request.scene)


def _robot_paths(robot: RobotRequest) -> Iterator[tuple[str, str, bool]]:
    for key, path in (("urdf", robot.urdf), ("srdf", robot.srdf)):
        if path is not None:
            yield f"robot.{key}", path, False
    for index, path in enumerate(robot.package_dirs):
        yield f"robot.package_dirs[{index}]", path, False


def _scene_paths(scene: SceneRequest) -> Iterator[tuple[str, str, bool]]:
    for index, cloud in enumerate(scene.cloud_files):
        yield ("scene.cloud" if isinstance(scene.cloud, str) else f"scene.cloud[{index}].file"), cloud.file, True
    for index, obstacle in enumerate(scene.obstacles):
        if isinstance(obstacle, MeshRequest):
            yield f"scene.obstacles[{index}].file", obstacle.file, False
