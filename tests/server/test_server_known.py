"""A real server that is told of known objects and of an earlier scene, as ``scopt scene`` is."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from little_scan import CRATE, box_obj, crate_scan
from planner_server import planner_server

from service.client import PlannerClient, PlannerError
from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import BuiltScene, CloudsSpec, KnownMesh

pytestmark = pytest.mark.filterwarnings("error")

SIZE = tuple(np.subtract(CRATE[1], CRATE[0]).tolist())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("known")
    box_obj(folder / "crate.obj", (0.0, 0.0, 0.0), SIZE)
    box_obj(folder / "crate_mm.obj", (0.0, 0.0, 0.0), SIZE, 0.001)
    (folder / "empty.stl").write_text("solid nothing\nendsolid\n")
    (folder / "crate.urdf").write_text("<robot/>")
    crate_scan(folder / "first.npz")
    crate_scan(folder / "without.npz", crate_y=None, seed=3)
    return folder


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[PlannerClient]:
    with planner_server(folder / "kept") as server, PlannerClient(server.address) as made:
        yield made


@pytest.fixture(scope="module")
def built(client: PlannerClient, folder: Path) -> BuiltScene:
    """The crate found in a scan, from about where it is."""
    near = KnownMesh(file=str(folder / "crate.obj"), position=[1.03, -0.28, 0.02], quaternion_wxyz=[1, 0, 0, 0])
    return client.build_scene(folder / "first.npz", meshes=[near])


def _told(scene: BuiltScene) -> dict[str, Any]:
    return dict(json.loads(scene.json))


def test_known_mesh_is_uploaded_and_found_in_the_scan(built: BuiltScene, folder: Path) -> None:
    (mesh,) = _told(built)["meshes"]
    assert (mesh["name"], mesh["placing"], mesh["pieces"]) == ("crate", "found", ["crate/1"])
    assert np.array(mesh["pose_world_mesh"])[0, 3] == pytest.approx(CRATE[0][0], abs=0.02)
    assert mesh["file"].startswith("sha256:")
    assert [piece.kind for piece in built.pieces if piece.name == "crate/1"] == ["object"]
    assert str(folder) not in built.json.decode()


def test_mesh_that_is_placed_stands_there_under_its_own_name_and_scale(client: PlannerClient, folder: Path) -> None:
    mesh = KnownMesh(
        file=str(folder / "crate_mm.obj"), name="lid", scale=0.001, position=[0.0, 0.6, 1.2], is_placed=True
    )
    (told,) = _told(client.build_scene(folder / "first.npz", meshes=[mesh]))["meshes"]
    assert (told["name"], told["placing"], told["pieces"]) == ("lid", "given", ["lid/1"])
    np.testing.assert_allclose(np.array(told["pose_world_mesh"])[:3, 3], [0.0, 0.6, 1.2])


def test_update_holds_a_scan_against_a_scene_by_its_id_and_by_its_file(
    client: PlannerClient, folder: Path, built: BuiltScene
) -> None:
    (folder / "first.json").write_bytes(built.json)
    for before in (built.scene_id, folder / "first.json"):
        told = _told(client.build_scene(folder / "without.npz", update=before))
        assert told["update"]["gone"] == ["crate/1"]
        assert told["update"]["stayed"]
        assert str(folder) not in json.dumps(told)


@pytest.mark.parametrize(
    ("asked", "field", "words"),
    [
        (lambda f, s: {"meshes": [f / "empty.stl"]}, "meshes[0].file", "0 triangles"),
        (lambda f, s: {"meshes": ["/etc/hostname"]}, "meshes[0].file", "the cloud_id of an uploaded"),
        (lambda f, s: {"meshes": [KnownMesh(file="/x.obj", is_placed=True)]}, "meshes[0]", "give position"),
        (lambda f, s: {"meshes": [KnownMesh(file="/x.obj", name="a/b")]}, "meshes[0]", "without '/'"),
        (lambda f, s: {"meshes": [KnownMesh(file=str(f / "crate.obj"), scale=1e4)]}, "meshes[0].file", "spans 6000 m"),
        (lambda f, s: {"meshes": ["/x.obj"] * 21}, "meshes", "at most 20 entries"),
        (lambda f, s: {"update": "scene:" + "0" * 64}, "update", "or never was"),
        (lambda f, s: {"update": f / "crate.obj"}, "update", "crate.obj is no JSON"),
        (lambda f, s: {"update": s, "method": "coacd"}, "method", "was made with planes, and an update keeps to that"),
        (lambda f, s: {"update": s, "reach": 2.0}, "clouds.reach_m", "leave it out, or leave out update"),
    ],
)
def test_what_cannot_be_used_is_told_of_its_field(
    client: PlannerClient,
    folder: Path,
    built: BuiltScene,
    asked: Callable[[Path, str], dict[str, Any]],
    field: str,
    words: str,
) -> None:
    given = asked(folder, built.scene_id)
    cloud_id = client.upload_cloud(folder / "without.npz")
    spec = CloudsSpec(clouds=[{"file": cloud_id}], reach_m=given.pop("reach", None))  # type: ignore[list-item]
    with pytest.raises(PlannerError) as caught:
        client.build_scene(spec, **given)
    assert caught.value.code is grpc.StatusCode.INVALID_ARGUMENT
    assert [one.field for one in caught.value.violations] == [field]
    assert words in caught.value.text
    assert "/kept/" not in caught.value.text


def test_mesh_that_is_not_here_or_cannot_be_sent_is_told_here(
    client: PlannerClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(RequestError) as caught:
        client.build_scene("first.npz", meshes=["nowhere.obj", "crate.urdf"], update="gone.json")
    nowhere, gone, urdf = caught.value.problems
    assert nowhere == "meshes[0].file: 'nowhere.obj' does not exist; expected an existing file"
    assert gone == "update: 'gone.json' does not exist; expected an existing file"
    assert urdf.startswith("meshes[1].file: 'crate.urdf': it is not uploaded")
