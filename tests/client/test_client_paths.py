"""Errors about files: the client refuses missing local files, and a server's errors name the local file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from google.rpc.error_details_pb2 import BadRequest
from planner_clients import CLIENTS
from planner_stand_in import PlannerStandIn, accepted, refuse, refused, serving, write_cloud

from service.client import PlannerClient, PlannerError
from service.client.error_texts import MAX_NAMES, UploadNames
from service.client.local_files import find_local_files, replace_by_ids, resolve_paths
from service.errors import RequestError
from service.proto.planner.v1 import planner_pb2 as pb
from service.request.file import load_request, parse_request
from service.request.scene import MeshRequest
from service.request.schema import PlanRequest

Code = grpc.StatusCode
REQUESTS = Path(__file__).parents[2] / "examples" / "requests"
SHA = "795b" * 16


def _request(folder: Path, **parts: Any) -> PlanRequest:
    return parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}} | parts, folder)


def _bad(*lines: str) -> BadRequest:
    return BadRequest(field_violations=[{"field": "request.scene.cloud", "description": line} for line in lines])  # type: ignore[list-item]


def test_a_missing_relative_cloud_of_a_request_is_refused_by_the_client(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    (tmp_path / "bag").mkdir()
    clouds = [{"file": "nowhere.pcd"}, {"file": "bag"}, {"file": "/robot/scan.pcd"}]
    with connect() as client, pytest.raises(RequestError) as caught:
        client.plan(_request(tmp_path, scene={"cloud": clouds}))
    assert caught.value.problems == (
        "scene.cloud[0].file: 'nowhere.pcd' does not exist; expected an existing file",
        "scene.cloud[1].file: 'bag' is a folder; expected a file in it, or an absolute path on the server",
    )
    with connect() as client, pytest.raises(RequestError, match=r"scene\.cloud: 'nowhere\.pcd' does not exist"):
        client.plan(_request(tmp_path, scene={"cloud": "nowhere.pcd"}))
    assert stand_in.requests == []


def test_missing_clouds_of_a_detection_or_a_scene_are_refused_by_the_client(
    connect: Callable[..., Any], stand_in: PlannerStandIn
) -> None:
    with connect() as client:
        with pytest.raises(RequestError, match=r"clouds\[1\]: 'nowhere\.pcd' does not exist"):
            client.detect([f"sha256:{SHA}.pcd", "nowhere.pcd"], "valve")
        with pytest.raises(RequestError, match=r"clouds\[0\]: 'tests' is a folder"):
            client.build_scene(Path("tests"))
    assert stand_in.requests == []


def test_a_path_that_exists_on_no_machine_is_reported_for_both(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path
) -> None:
    line = "scene.cloud: not a file that requests may name, got '/nowhere.pcd'; the cloud_id of an upload would do"
    stand_in.plans.append(refused(Code.INVALID_ARGUMENT, line, _bad(line)))
    with connect() as client, pytest.raises(PlannerError) as caught:
        client.plan(_request(tmp_path, scene={"cloud": "/nowhere.pcd"}))
    assert caught.value.problems == (f"{line}; no such file on this machine either, so it was not uploaded",)


@pytest.mark.parametrize("sent", ["{id}: no DATA line", "no cloud '{cut}… is stored; upload it first, or again"])
def test_an_error_about_an_uploaded_cloud_names_its_file(
    connect: Callable[..., Any], stand_in: PlannerStandIn, tmp_path: Path, sent: str
) -> None:
    def plan(request: pb.PlanRequest, context: grpc.ServicerContext) -> Iterator[pb.PlanResponse]:
        yield accepted(request)
        (cloud_id,) = stand_in.clouds
        line = sent.format(id=cloud_id, cut=cloud_id[:40])
        refuse(context, Code.INVALID_ARGUMENT, line, [_bad(f"scene.cloud: {line}")])

    path = write_cloud(tmp_path)
    stand_in.plans.append(plan)
    with connect() as client, pytest.raises(PlannerError) as caught:
        client.plan(_request(tmp_path, scene={"cloud": "scan.pcd"}))
    (line,) = caught.value.problems
    assert "sha256" not in line + caught.value.text
    assert str(path) in line
    assert str(path) in caught.value.text
    assert caught.value.violations[0].field == "request.scene.cloud"


@pytest.mark.parametrize(
    ("sent", "shown"),
    [
        ("chunk: the cloud is empty", "the cloud is empty"),
        ("header.format: pcd, ply would do, got 'txt2'", "format: pcd, ply would do, got 'txt2'"),
        ("header.size_bytes: at most 9 would do, got 12", "size_bytes: at most 9 would do, got 12"),
    ],
)
@pytest.mark.parametrize("kind", CLIENTS)
def test_the_error_of_a_refused_upload_names_its_file(tmp_path: Path, kind: str, sent: str, shown: str) -> None:
    class Refusing(PlannerStandIn):
        def UploadCloud(self, requests: Any, context: grpc.ServicerContext) -> pb.UploadCloudResponse:
            refuse(context, Code.INVALID_ARGUMENT, sent, [_bad(sent)])

    path = write_cloud(tmp_path)
    with serving(Refusing()) as target, CLIENTS[kind](target) as client, pytest.raises(PlannerError) as caught:
        client.upload_cloud(path)
    assert (caught.value.text, caught.value.problems) == (f"{path}: {shown}", (f"{path}: {shown}",))


def test_the_number_of_remembered_upload_names_is_limited() -> None:
    names = UploadNames()
    for number in range(MAX_NAMES + 10):
        names.add(f"sha256:{number:064x}.pcd", Path(f"{number}.pcd"))
    sent = PlannerError(Code.INVALID_ARGUMENT, f"sha256:{9:064x}.pcd and sha256:{MAX_NAMES:064x}.pcd are damaged")
    assert names.restore(sent).text == f"sha256:{9:064x}.pcd and {MAX_NAMES}.pcd are damaged"


def test_relative_paths_are_absolute_for_a_server_on_this_machine(tmp_path: Path) -> None:
    request = load_request(REQUESTS / "mesh.yaml")
    resolved = resolve_paths(request, is_this_machine=True)
    assert resolved.folder == request.folder
    (tmp_path / "crate.urdf").touch()
    obstacle = {"name": "crate", "type": "mesh", "file": "crate.urdf"}
    (crate,) = resolve_paths(_request(tmp_path, scene={"obstacles": [obstacle]}), is_this_machine=True).scene.obstacles
    assert isinstance(crate, MeshRequest)
    assert crate.file == str(tmp_path / "crate.urdf")


@pytest.mark.parametrize("is_this_machine", [True, False])
def test_local_meshes_are_uploaded_and_named_by_their_ids(is_this_machine: bool) -> None:
    request = resolve_paths(load_request(REQUESTS / "mesh.yaml"), is_this_machine)
    ((name, path),) = find_local_files(request).items()
    assert path.name == "window_frame.obj"
    (frame,) = replace_by_ids(request, {name: "sha256:1.obj"}).scene.obstacles
    assert isinstance(frame, MeshRequest)
    assert frame.file == "sha256:1.obj"


def test_relative_paths_are_refused_for_a_server_on_another_machine(tmp_path: Path) -> None:
    for name in ("robot.urdf", "table.urdf", "sent.obj"):
        (tmp_path / name).touch()
    obstacles = [
        {"name": name, "type": "mesh", "file": name} for name in ("table.urdf", "gone.obj", "/there/b.obj", "sent.obj")
    ]
    request = _request(tmp_path, robot={"urdf": "robot.urdf"}, scene={"obstacles": obstacles})
    with pytest.raises(RequestError) as caught:
        resolve_paths(request, is_this_machine=False)
    robot, table, gone = caught.value.problems
    assert robot.startswith("robot.urdf: 'robot.urdf' is a path of this machine; it is not uploaded")
    assert table.startswith("scene.obstacles[0].file: 'table.urdf' is a path of this machine")
    assert "scopt serve --allow FOLDER" in table
    assert gone == "scene.obstacles[1].file: 'gone.obj' does not exist; expected an existing file"
    with pytest.raises(RequestError, match=r"^scene\.obstacles\[1\]\.file: 'gone\.obj' does not exist"):
        resolve_paths(request, is_this_machine=True)


def test_relative_robot_files_are_absolute_for_a_server_on_this_machine(tmp_path: Path) -> None:
    for name in ("robot.urdf", "robot.srdf"):
        (tmp_path / name).touch()
    robot = {"urdf": "robot.urdf", "srdf": "robot.srdf", "package_dirs": ["."]}
    resolved = resolve_paths(_request(tmp_path, robot=robot), is_this_machine=True).robot
    assert (resolved.urdf, resolved.srdf) == (f"{tmp_path}/robot.urdf", f"{tmp_path}/robot.srdf")
    assert resolved.package_dirs == (str(tmp_path),)


def test_a_result_folder_too_large_for_one_message_is_refused_by_the_client(
    stand_in: PlannerStandIn, target: str, tmp_path: Path
) -> None:
    (tmp_path / "robot").mkdir()
    (tmp_path / "result.json").write_text('{"format": "scopt-result/1"}')
    (tmp_path / "robot" / "torso.stl").write_bytes(bytes(5 * 2**20))
    with PlannerClient(target) as client, pytest.raises(RequestError) as caught:
        client.verify(tmp_path)
    assert str(caught.value) == (
        "files: the message has 5.0 MiB; a server accepts at most 4.0 MiB and robot/torso.stl alone has 5.0 MiB; "
        "verify the folder here, or give the plan's id"
    )
    assert stand_in.requests == []
