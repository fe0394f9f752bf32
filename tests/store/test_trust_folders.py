"""A request names only uploaded clouds and files under allowed folders, wherever its paths seem to lead."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service import parse_request
from service.request.fields import FilePath
from service.request.schema import PlanRequest
from service.trust import AllowedFolders, TrustError, resolve_folders

CLOUD = "sha256:" + "0" * 64 + ".pcd"
SCENE = "scene:" + "0" * 64


@pytest.fixture
def folders(tmp_path: Path) -> AllowedFolders:
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans" / "a.pcd").write_text("")
    (tmp_path / "secret").write_text("")
    (tmp_path / "scans" / "out").symlink_to(tmp_path)
    (tmp_path / "scans" / "loop").symlink_to(tmp_path / "scans" / "loop")
    (tmp_path / "link").symlink_to(tmp_path / "scans")
    return resolve_folders([tmp_path / "link"], lambda cloud_id: cloud_id == CLOUD, lambda scene_id: scene_id == SCENE)


def _request(**parts: Any) -> PlanRequest:
    return parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "home"}} | parts)


def test_a_file_under_an_allowed_folder_and_an_uploaded_cloud_may_be_named(
    folders: AllowedFolders, tmp_path: Path
) -> None:
    for path in (
        tmp_path / "scans" / "a.pcd",
        tmp_path / "link" / "a.pcd",
        tmp_path / "scans" / "not_there.pcd",
        CLOUD,
    ):
        assert folders.find_problems(_request(scene={"cloud": str(path)})) == []


@pytest.mark.parametrize(
    "path",
    [
        "/etc/passwd",
        "{}/secret",
        "{}/scans/../secret",
        "{}/scans/out/secret",
        "{}/scans/loop/../../secret",
        "{}/scansx/a.pcd",
        "{}",
        "/",
        "/proc/self/root/etc/passwd",
        "scans/a.pcd",
        "~/scans/a.pcd",
        "file:///etc/passwd",
        "sha256:" + "1" * 64 + ".pcd",
        "sha256:../../secret",
        "SHA256:" + "0" * 64 + ".pcd",
    ],
)
def test_whatever_leads_out_is_refused_naming_the_field(folders: AllowedFolders, tmp_path: Path, path: str) -> None:
    path = path.format(tmp_path)
    ((field, words),) = folders.find_problems(_request(scene={"cloud": path}))
    assert field == "scene.cloud"
    assert "cloud_id" in words or "upload it first" in words
    assert words.endswith(f"an absolute path under {tmp_path}/scans") or path.startswith("sha256:")


@given(st.text(st.characters(codec="utf-8"), min_size=1))
def test_no_text_leads_out(text: str) -> None:
    folders = AllowedFolders((Path("/nowhere/allowed"),), lambda cloud_id: False, lambda scene_id: False)
    assert folders.check(text)
    assert folders.check(f"/nowhere/allowed/../{text}") or "allowed" in text


def test_every_field_that_holds_a_path_is_checked(folders: AllowedFolders) -> None:
    bad = "/etc/passwd"
    request = parse_request(
        {
            "robot": {"urdf": bad, "srdf": bad, "package_dirs": [bad, bad]},
            "goal": {"posture": "home"},
            "scene": {
                "cloud": [{"file": CLOUD}, {"file": bad}],
                "obstacles": [
                    {"name": "box", "type": "box", "size": [1, 1, 1]},
                    {"name": "mesh", "type": "mesh", "file": bad},
                ],
            },
        }
    )
    found = [field for field, _ in folders.find_problems(request)]
    assert found == [
        "robot.urdf",
        "robot.srdf",
        "robot.package_dirs[0]",
        "robot.package_dirs[1]",
        "scene.cloud[1].file",
        "scene.obstacles[1].file",
    ]
    assert [field for field, _ in folders.find_scene_problems(request.scene)] == found[4:]
    assert _path_fields(PlanRequest) == {"urdf", "srdf", "package_dirs", "cloud", "file", "phases_file"}
    leaving = parse_request({"robot": {"name": "atlas"}, "task": {"egress": {"phases_file": bad}}})
    assert [field for field, _ in folders.find_problems(leaving)] == ["task.egress.phases_file"]


def test_an_uploaded_file_is_no_robot_and_may_be_a_mesh(folders: AllowedFolders) -> None:
    mesh = {"name": "crate", "type": "mesh", "file": CLOUD}
    assert folders.find_problems(_request(scene={"obstacles": [mesh]})) == []
    ((field, words),) = folders.find_problems(_request(robot={"urdf": CLOUD}))
    assert field == "robot.urdf"
    assert "uploads cannot be used here" in words


def test_a_server_that_allows_no_folder_says_so() -> None:
    folders = resolve_folders([], lambda cloud_id: False, lambda scene_id: False)
    ((_, words),) = folders.find_problems(_request(robot={"urdf": "/robots/a.urdf"}))
    no_files = "this server reads no files of its own (`scopt serve --allow FOLDER` allows those of a folder)"
    assert words == f"requests may not name this file, got '/robots/a.urdf'; {no_files}"
    ((_, words),) = folders.find_problems(_request(scene={"cloud": "a.pcd"}))
    assert words == f"no absolute path, got 'a.pcd'; expected the cloud_id of an uploaded cloud; {no_files}"


def test_the_whole_disk_or_what_is_no_folder_cannot_be_allowed(tmp_path: Path) -> None:
    (tmp_path / "root").symlink_to("/")
    with pytest.raises(TrustError, match="is the whole disk"):
        resolve_folders([tmp_path / "root"], bool, bool)
    with pytest.raises(TrustError, match="is no folder"):
        resolve_folders([tmp_path / "not_there"], bool, bool)


def _path_fields(section: Any) -> set[str]:
    """Names of all fields, at any depth, that hold a ``FilePath``."""
    found: set[str] = set()

    def walk(hint: Any, name: str) -> None:
        parts = get_args(hint)
        if parts[: len(get_args(FilePath))] == get_args(FilePath):
            found.add(name)
        if isinstance(hint, type) and hint.__module__.startswith("service.request"):
            for key, inner in get_type_hints(hint, include_extras=True).items():
                walk(inner, key)
        for inner in parts:
            walk(inner, name)

    walk(section, "")
    return found


def test_a_scene_is_one_that_was_built_or_uploaded_or_lies_in_an_allowed_folder(
    folders: AllowedFolders, tmp_path: Path
) -> None:
    for path in (SCENE, CLOUD, str(tmp_path / "scans" / "scene.json")):
        assert folders.find_problems(_request(scene={"file": path})) == []
    other = "scene:" + "1" * 64
    ((field, words),) = folders.find_problems(_request(scene={"file": other}))
    assert field == "scene.file"
    assert words.endswith("it was removed when the store was full, or never was")
    ((_, words),) = folders.find_problems(_request(scene={"file": "scene.json"}))
    assert "the scene_id of a built scene, the cloud_id of an uploaded one or an absolute path under" in words


def test_the_id_of_a_scene_is_no_cloud(folders: AllowedFolders) -> None:
    ((field, words),) = folders.find_problems(_request(scene={"cloud": SCENE}))
    assert (field, words.startswith("no absolute path")) == ("scene.cloud", True)
