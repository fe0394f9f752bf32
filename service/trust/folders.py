"""Files that a request may name: uploads, built scenes, and files in the server's allowed folders."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from service.errors import shown
from service.request.file import list_attached_meshes, list_scene_meshes
from service.request.scene import SceneRequest
from service.request.schema import PlanRequest, RobotRequest
from service.trust.errors import TrustError

UPLOADED, BUILT = "sha256:", "scene:"
Kind = Literal["cloud", "scene", "mesh", "file"]
_IDS: dict[Kind, str] = {
    "cloud": "the cloud_id of an uploaded cloud",
    "scene": "the scene_id of a built scene, the cloud_id of an uploaded one",
    "mesh": "the cloud_id of an uploaded STL, OBJ or PLY file",
    "file": "",
}
NO_FOLDERS = "this server reads no files of its own (`scopt serve --allow FOLDER` allows those of a folder)"


@dataclass(frozen=True)
class AllowedFolders:
    """Rule for the paths of requests.

    A path is the id of an upload or of a built scene, or an absolute path that lies in one of ``folders`` once every
    symbolic link is followed.

    Attributes:
        folders: real paths, as ``resolve_folders`` makes them.
        has_upload: whether an upload with this id is stored.
        has_scene: whether a built scene with this id is stored.
    """

    folders: tuple[Path, ...]
    has_upload: Callable[[str], bool]
    has_scene: Callable[[str], bool]

    def find_problems(self, request: PlanRequest) -> list[tuple[str, str]]:
        """Return field and problem of every path that the request may not name."""
        return [(field, problem) for field, path, kind in list_paths(request) if (problem := self.check(path, kind))]

    def find_scene_problems(self, scene: SceneRequest) -> list[tuple[str, str]]:
        """Return the same as ``find_problems`` for a scene alone."""
        return [(field, problem) for field, path, kind in _scene_paths(scene) if (problem := self.check(path, kind))]

    def check(self, path: str, kind: Kind = "cloud") -> str:
        """Return why a path may not be named for a ``kind``; empty if it may."""
        if path.startswith(UPLOADED):
            if kind == "file":
                return f"uploads cannot be used here, got {shown(path)}; {self._expected(kind)}"
            return "" if self.has_upload(path) else f"no {kind} {shown(path)} is stored; upload it first, or again"
        if path.startswith(BUILT) and kind == "scene":
            known = self.has_scene(path)
            return "" if known else f"unknown scene {shown(path)}; it was removed when the store was full, or never was"
        if not os.path.isabs(path):
            return f"no absolute path, got {shown(path)}; {self._expected(kind)}"
        try:
            real = Path(os.path.realpath(path))
        except (OSError, ValueError):
            real = None
        if real is None or not any(real.is_relative_to(folder) for folder in self.folders):
            return f"requests may not name this file, got {shown(path)}; {self._expected(kind)}"
        return ""

    def _expected(self, kind: Kind) -> str:
        known = _IDS[kind]
        if self.folders:
            absolute = f"an absolute path under {' or '.join(map(str, self.folders))}"
            return f"expected {known} or {absolute}" if known else f"expected {absolute}"
        return f"expected {known}; {NO_FOLDERS}" if known else NO_FOLDERS


def resolve_folders(
    folders: Sequence[Path], has_upload: Callable[[str], bool], has_scene: Callable[[str], bool]
) -> AllowedFolders:
    """Make the rule for the real paths of folders.

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


def list_paths(request: PlanRequest) -> Iterator[tuple[str, str, Kind]]:
    """Yield field, path and kind of every file that a request names."""
    yield from _robot_paths(request.robot)
    yield from _scene_paths(request.scene)
    for field, path in list_attached_meshes(request):
        yield field, path, "mesh"
    for name, path in request.section.list_paths():
        yield f"{request.kind.field}.{name}", path, "file"


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
    for field, path in list_scene_meshes(scene):
        yield field, path, "mesh"
