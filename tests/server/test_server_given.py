"""A real server that looks for objects given by parameters or files, with the same hits as ``scopt detect object``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from little_scan import CRATE, box_obj, crate_scan, scopt
from planner_server import planner_server

from service.client import PlannerClient, PlannerError
from service.errors import RequestError
from service.proto.planner.v1.planner_pb2 import DetectResponse, KnownMesh, ObjectPart, PartShape

pytestmark = pytest.mark.filterwarnings("error")

SIZE = [float(high - low) for low, high in zip(*CRATE, strict=True)]
HINT = (1.2, -0.1, 0.4)  # near the crate, for short searches
LINE = f"box size={','.join(map(str, SIZE))}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("given")
    crate_scan(folder / "scan.npz")
    box_obj(folder / "crate.obj", (0.0, 0.0, 0.0), tuple(SIZE))
    parts = [{"type": "box", "size": SIZE, "position": [0.5 * side for side in SIZE]}]
    (folder / "crate.json").write_text(json.dumps({"parts": parts}))
    (folder / "broken.yaml").write_text("parts:\n- {type: wheel, radius: 0.2}\n")
    return folder


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[PlannerClient]:
    with planner_server(folder / "kept") as server, PlannerClient(server.address) as made:
        yield made


def _by_command(folder: Path, given: str) -> list[dict[str, Any]]:
    result = scopt("detect", "object", folder / "scan.npz", "--object", given, "--hint", *HINT, "--json")
    assert result.exit_code == 0
    return list(json.loads(result.stdout)["hits"])


def _by_service(reply: DetectResponse) -> list[dict[str, Any]]:
    return [
        {
            "kind": hit.kind,
            "confidence": hit.confidence,
            "pose_world_object": [list(hit.pose_world_object[4 * row : 4 * row + 4]) for row in range(4)],
            "sizes": dict(hit.sizes),
            "residuals": dict(hit.residuals),
            "doubts": list(hit.doubts),
        }
        for hit in reply.hits
    ]


def test_parameters_give_the_hits_of_the_command(client: PlannerClient, folder: Path) -> None:
    expected = _by_command(folder, LINE)
    assert expected[0]["kind"] == "box"
    assert expected[0]["confidence"] >= 0.5
    assert expected[0]["pose_world_object"][0][3] == pytest.approx(0.5 * (CRATE[0][0] + CRATE[1][0]), abs=0.03)
    assert _by_service(client.detect(folder / "scan.npz", "object", objects=[LINE], hint=HINT)) == expected


def test_a_mesh_file_gives_the_hits_of_the_command(client: PlannerClient, folder: Path) -> None:
    expected = _by_command(folder, str(folder / "crate.obj"))
    assert expected[0]["kind"] == "crate"
    reply = client.detect(folder / "scan.npz", "object", objects=[folder / "crate.obj"], hint=HINT)
    assert _by_service(reply) == expected


def test_an_object_file_gives_the_same_hits_when_the_client_reads_it_and_when_the_server_does(
    client: PlannerClient, folder: Path
) -> None:
    stored = KnownMesh(file=client.upload_cloud(folder / "crate.json"), name="crate")
    read_here, read_there = (
        _by_service(client.detect(folder / "scan.npz", "object", objects=[given], hint=HINT))
        for given in (folder / "crate.json", stored)
    )
    assert read_here == read_there
    assert read_here[0]["confidence"] >= 0.5


def test_a_scene_takes_an_object_by_its_parameters(client: PlannerClient, folder: Path) -> None:
    near = KnownMesh(parts=[ObjectPart(type=PartShape.PART_SHAPE_BOX, size=SIZE)], position=HINT)
    (told,) = json.loads(client.build_scene(folder / "scan.npz", meshes=[near]).json)["meshes"]
    assert (told["name"], told["placing"], told["pieces"]) == ("box", "found", ["box/1"])


@pytest.mark.parametrize(
    ("kind", "given", "field", "words"),
    [
        ("object", [], "objects", "expected some with kind 'object', and none with another"),
        ("valve", [LINE], "objects", "expected some with kind 'object', and none with another"),
        ("object", [KnownMesh(name="none")], "objects[0]", "give either a file or parts"),
        ("object", [KnownMesh(parts=[ObjectPart(size=[1.0, 1.0, 1.0])])], "objects[0].parts[0]", "type"),
        ("object", ["/etc/hostname"], "objects[0].file", "the cloud_id of an uploaded"),
        ("object", ["wheel radius=0.1 rim_radius=0.2"], "objects", "rim_radius 0.2 m is not smaller than radius"),
        ("object", [lambda folder: KnownMesh(file=str(folder / "crate.obj"), scale=1e4)], "objects[0].file", "spans"),
        ("object", [LINE] * 21, "objects", "at most 20 entries"),
    ],
)
def test_what_cannot_be_used_is_told_of_its_field(
    client: PlannerClient,
    folder: Path,
    kind: str,
    given: list[Callable[[Path], KnownMesh] | KnownMesh | str],
    field: str,
    words: str,
) -> None:
    objects = [item(folder) if callable(item) else item for item in given]
    with pytest.raises(PlannerError) as caught:
        client.detect(folder / "scan.npz", kind, objects=objects)
    assert caught.value.code is grpc.StatusCode.INVALID_ARGUMENT
    assert [one.field for one in caught.value.violations] == [field]
    assert words in caught.value.text
    assert "/kept/" not in caught.value.text


def test_a_text_or_file_that_is_wrong_is_told_here(client: PlannerClient, folder: Path) -> None:
    with pytest.raises(RequestError) as caught:
        client.detect(folder / "scan.npz", "object", objects=["weel radius=0.2", folder / "broken.yaml"])
    text, file = caught.value.problems
    assert text.startswith("objects[0]: unknown type 'weel'")
    assert file == "objects[1]: broken.yaml: parts[0].rim_radius: is missing"
