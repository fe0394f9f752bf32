"""``scopt scene --mesh`` and ``--update``: known objects in a scan, and updates of a written scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little_scan import CRATE, box_obj, crate_scan, scopt

from perception.solids.mesh import Solid
from perception.solids.rating import MeshMatch
from service.errors import RequestError
from service.scan.cloud import CloudInput
from service.scan.known_meshes import explain_low_confidence, load_known_meshes, parse_mesh_option
from service.scan.make_scene import SceneInput, read_earlier_scene

SIZE = tuple(np.subtract(CRATE[1], CRATE[0]).tolist())
PLACE = "1 -0.3 0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the mesh of a crate in metres and in millimetres, and scans with and without it."""
    folder = tmp_path_factory.mktemp("known")
    box_obj(folder / "crate.obj", (0.0, 0.0, 0.0), SIZE)
    box_obj(folder / "crate_mm.obj", (0.0, 0.0, 0.0), SIZE, 0.001)
    crate_scan(folder / "first.npz")
    crate_scan(folder / "again.npz", seed=1)
    crate_scan(folder / "moved.npz", crate_y=0.7, seed=2)
    crate_scan(folder / "without.npz", crate_y=None, seed=3)
    return folder


def _scene(folder: Path, cloud: str, out: str, *options: object) -> dict[str, Any]:
    result = scopt("scene", folder / cloud, "--out", folder / out, *options, "--json")
    assert result.exit_code == 0, result.stderr
    return dict(json.loads((folder / out).read_text()))


@pytest.fixture(scope="module")
def plain(folder: Path) -> dict[str, Any]:
    return _scene(folder, "first.npz", "plain.json")


@pytest.fixture(scope="module")
def matched(folder: Path) -> dict[str, Any]:
    """Scene with the crate matched from 4 cm off, and a second crate placed in the air."""
    near, at = f"{folder}/crate.obj near 1.03 -0.28 0.02 0.05 0 0", f"{folder}/crate.obj at 0 0.6 1.2 0 0 0"
    return _scene(folder, "first.npz", "matched.json", "--mesh", near, "--mesh", at)


def _corners(scene: dict[str, Any], name: str) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.concatenate([piece["vertices"] for piece in scene["pieces"] if piece["name"].startswith(name + "/")])
    return vertices.min(axis=0), vertices.max(axis=0)


def test_a_matched_mesh_stands_where_the_scan_shows_it(matched: dict[str, Any]) -> None:
    found = matched["meshes"][0]
    assert (found["name"], found["placing"], found["pieces"]) == ("crate", "found", ["crate/1"])
    assert found["confidence"] >= 0.5
    assert found["residuals"]["rms"] < 0.01
    # Only the front is seen, so y and z are not determined.
    np.testing.assert_allclose(_corners(matched, "crate")[0][0], CRATE[0][0], atol=0.02)
    assert np.array(found["pose_world_mesh"]).shape == (4, 4)


def test_points_of_a_matched_mesh_make_no_pieces_and_are_covered(
    matched: dict[str, Any], plain: dict[str, Any]
) -> None:
    def in_front(scene: dict[str, Any]) -> list[str]:
        return [
            piece["name"]
            for piece in scene["pieces"]
            if piece["kind"] not in ("floor", "object")
            and np.min(piece["vertices"], axis=0)[0] < 1.05
            and np.ptp(piece["vertices"], axis=0).max() > 0.2
        ]

    assert in_front(plain)
    assert not in_front(matched)
    assert matched["figures"]["covered_points"] > 0.99


def test_a_placed_mesh_stands_there_and_is_doubted_where_the_scan_sees_through_it(matched: dict[str, Any]) -> None:
    placed = matched["meshes"][1]
    assert (placed["name"], placed["placing"]) == ("crate-2", "given")
    np.testing.assert_allclose(_corners(matched, "crate-2"), np.add((0.0, 0.6, 1.2), [(0, 0, 0), SIZE]), atol=1e-9)
    assert placed["confidence"] < 0.5
    (note,) = [note for note in matched["notes"] if note.startswith("crate-2 stands where it was placed, but")]
    assert "of the rays that reached its place went on" in note


def test_a_mesh_that_is_not_found_is_told_and_left_out(folder: Path) -> None:
    out = "lost.json"
    data = _scene(folder, "without.npz", out, "--mesh", f"{folder}/crate_mm.obj", "--mesh-scale", 0.001)
    (lost,) = data["meshes"]
    assert (lost["placing"], lost["pieces"]) == ("not found", [])
    assert lost["confidence"] < 0.5
    assert not [piece for piece in data["pieces"] if piece["kind"] == "object"]
    assert any(
        note.startswith("crate_mm is not in the scene, since the scan does not show it") for note in data["notes"]
    )
    assert "Known meshes" in (folder / out).with_suffix(".html").read_text()


@pytest.mark.parametrize(
    ("text", "pose", "hint", "is_placed"),
    [
        ("crate.obj", None, None, False),
        ("crate.obj near 1 2 3", None, (1, 2, 3), False),
        ("crate.obj near 1 2 3 0 0 0", (1, 2, 3), None, False),
        ("crate.obj at 1, 2, 3", (1, 2, 3), None, True),
        ("crate.obj at 1 2 3 1 0 0 0", (1, 2, 3), None, True),
        ("look at me.obj at 1 2 3", (1, 2, 3), None, True),
        ("look at me.obj", None, None, False),
    ],
)
def test_a_mesh_is_asked_for_anywhere_near_a_place_or_at_a_pose(
    tmp_path: Path, text: str, pose: tuple[float, ...] | None, hint: tuple[float, ...] | None, is_placed: bool
) -> None:
    for name in ("crate.obj", "look at me.obj"):
        box_obj(tmp_path / name, (0, 0, 0), (1, 1, 1))
    asked = parse_mesh_option(f"{tmp_path}/{text}")
    assert asked.is_placed is is_placed
    assert (asked.pose_world_mesh is None) == (pose is None)
    assert (asked.hint is None) == (hint is None)
    if asked.pose_world_mesh is not None:
        np.testing.assert_array_equal(asked.pose_world_mesh[:3], np.column_stack([np.eye(3), pose]))
    if asked.hint is not None:
        np.testing.assert_array_equal(asked.hint, hint)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("gone.obj", "--mesh: {}/gone.obj is not there; expected FILE, 'FILE near X Y Z'"),
        ("gone.obj at 1 2 3", "--mesh: {}/gone.obj is not there"),
        ("", "--mesh: {} is a folder; expected FILE, "),
        (
            "scan.pcd",
            "--mesh: {}/scan.pcd: format '.pcd' is not read; expected .stl, .obj, .ply, .dae, .glb, .gltf, .urdf",
        ),
        (
            "crate.obj at",
            "--mesh: {}/crate.obj at: expected 'X Y Z', 'X Y Z YAW PITCH ROLL', 'X Y Z QW QX QY QZ', '16 numbers'",
        ),
        ("crate.obj at 1 2", "--mesh: {}/crate.obj at: expected 'X Y Z', "),
        (
            "crate.obj near here",
            "--mesh: {}/crate.obj near: expected numbers separated by spaces or commas, got 'here'",
        ),
        ("crate.obj at 0 0 0 90 0 0", "--mesh: {}/crate.obj at: pose turns by 90 rad"),
        ("crate.obj at nan 0 0", "--mesh: {}/crate.obj at: pose holds NaN"),
    ],
)
def test_a_mesh_that_cannot_be_asked_for_is_one_line(tmp_path: Path, text: str, problem: str) -> None:
    box_obj(tmp_path / "crate.obj", (0, 0, 0), (1, 1, 1))
    (tmp_path / "scan.pcd").write_text("")
    with pytest.raises(RequestError) as error:
        parse_mesh_option(f"{tmp_path}/{text}")
    assert str(error.value).startswith(problem.format(tmp_path))


def test_a_confidence_that_is_a_little_too_low_does_not_read_as_enough() -> None:
    match = MeshMatch(np.eye(4), 0.4991, {"n_points": 7.0}, Solid((), (), ()), 0.01)
    assert explain_low_confidence(match) == "confidence 0.49, 0.5 is needed (7 points lie on it)"


def test_meshes_take_no_name_that_pieces_have(tmp_path: Path) -> None:
    files = [box_obj(tmp_path / name, (0, 0, 0), (1, 1, 1)) for name in ("wall.obj", "a.obj")]
    asked = [parse_mesh_option(str(file)) for file in (*files, files[1])]
    assert [one.name for one in load_known_meshes(asked)] == ["wall-2", "a", "a-2"]


def test_a_scale_that_makes_a_speck_of_a_mesh_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "speck.urdf"
    shape = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    path.write_text(f'<robot name="a"><link name="a">{shape}</link></robot>')
    with pytest.raises(
        RequestError, match=r"speck\.urdf spans 1e-05 m at --mesh-scale 1e-05; expected 0\.001 to 100 m"
    ):
        load_known_meshes([parse_mesh_option(str(path), 1e-5)])


def test_the_very_same_scan_leaves_every_piece_as_it_was(folder: Path, plain: dict[str, Any]) -> None:
    data = _scene(folder, "first.npz", "same.json", "--update", folder / "plain.json")
    names = [piece["name"] for piece in plain["pieces"]]
    told = {"stayed": names, "changed": [], "new": [], "gone": []}
    assert data["update"] == {"previous": str(folder / "plain.json"), **told}
    assert [piece["vertices"] for piece in data["pieces"]] == [piece["vertices"] for piece in plain["pieces"]]
    assert [data["figures"][f"{how}_pieces"] for how in told] == [len(names), 0, 0, 0]
    assert data["settings"] == plain["settings"]


def test_a_crate_that_moved_is_all_that_changes(folder: Path, plain: dict[str, Any]) -> None:
    data = _scene(folder, "moved.npz", "moved.json", "--update", folder / "plain.json")
    update = data["update"]
    pieces = {piece["name"]: np.array(piece["vertices"]) for piece in (*data["pieces"], *plain["pieces"])}
    large = {name: np.ptp(vertices, axis=0).max() > 0.2 for name, vertices in pieces.items()}
    new, gone = ([name for name in update[how] if large[name]] for how in ("new", "gone"))
    assert new
    assert gone
    assert min(pieces[name][:, 1].min() for name in new) > 0.3  # where it is now
    assert max(pieces[name][:, 1].max() for name in gone) < 0.3  # where it was
    assert {"floor", "wall/0"} <= {*update["stayed"]}
    assert not {*update["new"]} & {piece["name"] for piece in plain["pieces"]}


def test_an_update_of_an_update_goes_on_from_there(folder: Path, plain: dict[str, Any]) -> None:
    _scene(folder, "again.npz", "second.json", "--update", folder / "plain.json")
    data = _scene(folder, "first.npz", "third.json", "--update", folder / "second.json")
    assert {"floor", "wall/0"} <= {*data["update"]["stayed"]}
    assert data["figures"]["covered_points"] > 0.99


def test_a_mesh_stays_in_an_update_and_goes_when_rays_go_through_it(folder: Path, matched: dict[str, Any]) -> None:
    again = _scene(folder, "again.npz", "again.json", "--update", folder / "matched.json")
    assert [one["placing"] for one in again["meshes"]] == ["found", "given"]
    assert {"crate/1", "crate-2/1"} <= {*again["update"]["stayed"]}
    assert again["meshes"][0]["pose_world_mesh"] == matched["meshes"][0]["pose_world_mesh"]
    without = _scene(folder, "without.npz", "gone.json", "--update", folder / "matched.json")
    assert [one["placing"] for one in without["meshes"]] == ["gone", "given"]
    assert "crate/1" in without["update"]["gone"]
    assert any(note.startswith("crate is gone: ") for note in without["notes"])
    assert "crate" not in [mesh.name for mesh in read_earlier_scene(folder / "gone.json").meshes]


def test_a_mesh_asked_for_again_takes_the_place_of_the_one_before(folder: Path, matched: dict[str, Any]) -> None:
    again = f"{folder}/crate.obj at 1 0.4 0"
    data = _scene(folder, "moved.npz", "anew.json", "--update", folder / "matched.json", "--mesh", again)
    assert [(one["name"], one["placing"]) for one in data["meshes"]] == [("crate", "given"), ("crate-2", "given")]
    assert data["meshes"][0]["confidence"] >= 0.5
    assert "crate/1" in data["update"]["changed"]


@pytest.mark.parametrize(
    ("options", "exit_code", "problem"),
    [
        (("--reach", 4), 3, "--reach: {}/plain.json was made with 3.0, and an update keeps to that; leave it out"),
        (("--seed", 1), 3, "--seed: {}/plain.json was made with 0"),
        (("--method", "coacd"), 3, "--method: {}/plain.json was made with planes"),
        (("--unknown", "occupied"), 3, "--unknown: {}/plain.json was made with free"),
        (("--mesh-scale", 0.001), 2, "Usage: "),
    ],
)
def test_what_an_update_takes_from_the_scene_before_cannot_be_said_otherwise(
    folder: Path, plain: dict[str, Any], options: tuple[object, ...], exit_code: int, problem: str
) -> None:
    out = folder / "refused.json"
    result = scopt("scene", folder / "again.npz", "--out", out, "--update", folder / "plain.json", *options)
    assert result.exit_code == exit_code
    assert any(line.startswith(problem.format(folder)) for line in result.stderr.splitlines())
    assert not out.exists()


def _damaged(data: dict[str, Any], *path: str | int, value: object) -> bytes:
    data = json.loads(json.dumps(data))
    place: Any = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return json.dumps(data).encode()


@pytest.mark.parametrize(
    ("damage", "problem"),
    [
        (lambda data: b"pieces", " is no JSON; expected the file that 'scopt scene' writes"),
        (lambda data: b"[1, 2]", " is no scene, its format is None; expected scopt-scene/1"),
        (lambda data: b'{"format": "scopt-detections/1"}', " is no scene, its format is 'scopt-detections/1'; exp"),
        (lambda data: b'{"format": "scopt-scene/1"}', " does not say what it was made with; make it anew"),
        (lambda data: _damaged(data, "settings", "reach_m", value=-1), ": settings.reach_m: "),
        (lambda data: _damaged(data, "pieces", 1, "vertices", value=[[0, 0, 0]]), ": pieces.1.vertices: "),
        (lambda data: _damaged(data, "pieces", 1, "vertices", 0, value=["x", 0, 0]), ": pieces.1.vertices.0.0: "),
        (lambda data: _damaged(data, "pieces", 1, "name", value="floor"), ": piece names must be unique"),
        (lambda data: _damaged(data, "pieces", 1, "name", value="wall/a"), ": pieces: 'wall/a' is no name of a piece"),
        (lambda data: _damaged(data, "pieces", 1, "seen", "plane", value=[0, 0, 1]), ": pieces.1.seen.plane"),
        (lambda data: _damaged(data, "meshes", value=[{
            "name": "a", "file": "a.obj", "placing": "found", "pose_world_mesh": None, "pieces": ["b"]
        }]), ": meshes: 'a' names pieces that are not there"),
    ],
)  # fmt: skip
def test_a_scene_that_cannot_be_updated_is_one_line(
    tmp_path: Path, plain: dict[str, Any], damage: Any, problem: str
) -> None:
    path = tmp_path / "before.json"
    path.write_bytes(damage(plain))
    with pytest.raises(RequestError) as error:
        read_earlier_scene(path)
    (line,) = error.value.problems
    assert line.startswith(f"--update: {path}{problem}")


def test_a_scene_that_is_not_there_cannot_be_updated(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"--update: .*none\.json cannot be read: No such file"):
        read_earlier_scene(tmp_path / "none.json")


def test_a_scene_read_back_is_the_scene_that_was_written(folder: Path, plain: dict[str, Any]) -> None:
    before = read_earlier_scene(folder / "plain.json")
    assert before.settings == SceneInput(CloudInput(())).settings
    assert [piece.vertices.tolist() for piece in before.scene.pieces] == [one["vertices"] for one in plain["pieces"]]
    assert [piece.name for piece in before.pieces] == [one["name"] for one in plain["pieces"] if "seen" in one]
    planes = [piece.plane for piece in before.pieces if piece.kind == "wall"]
    assert all(plane is not None and abs(np.linalg.norm(plane[:3]) - 1.0) < 1e-9 for plane in planes)
