"""Objects given by parameters: made as stated, refused in one line, found in a scan by the code that finds meshes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from little_scan import scopt

from benchmarks.clouds.given import make_given
from perception import Cloud, make_view, write_npz
from perception.simulate import Pose, Scanner, box, cylinder, scan
from perception.solids.match import find_matches
from perception.solids.shapes import make_lever, make_wheel, unite_meshes
from service.errors import RequestError
from service.request.object_file import is_object_text, parse_object, parse_object_text
from service.scan.given_objects import make_object
from service.scan.meshes import read_solid

WHEEL = "wheel radius=0.15 rim_radius=0.015 spokes=3"
CENTRE = np.array([0.9, 0.1, 1.1])
AXIS = np.array([-0.8, 0.0, 0.6])


@pytest.fixture(scope="module")
def wheel_scan() -> Cloud:
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([np.cross([0.0, 1.0, 0.0], AXIS), [0.0, 1.0, 0.0], AXIS])
    pose[:3, 3] = CENTRE
    wheel = [mesh.place(pose) for mesh in make_wheel(0.15, 0.015, 3)]
    stem = cylinder((CENTRE - 0.02 * AXIS).tolist(), (CENTRE - 0.3 * AXIS).tolist(), 0.02)
    room = [box((-4.0, -4.0, -0.1), (4.0, 4.0, 0.0)), box((1.5, -2.0, 0.0), (1.6, 2.0, 2.4))]
    carton = box((0.8, -0.9, 0.0), (1.2, -0.5, 0.5))
    sensor = Pose.looking((0.1, 0.0, 1.6), CENTRE.tolist(), 0.0)
    return scan([*wheel, stem, carton, *room], sensor, Scanner(n_lines=120), 0)


def test_a_wheel_has_the_sizes_it_was_given() -> None:
    solid = unite_meshes(make_wheel(0.3, 0.02, 4), "wheel")
    vertices = np.concatenate([mesh.vertices for mesh in solid.closed])
    assert len(solid.closed) == 6
    assert not solid.open
    assert np.hypot(*vertices.T[:2]).max() == pytest.approx(0.32)
    assert np.abs(vertices[:, 2]).max() == pytest.approx(0.02)


def test_a_crank_has_its_grip_at_the_end() -> None:
    vertices = np.concatenate([mesh.vertices for mesh in make_lever(0.2, 0.01, 0.1)])
    grip = vertices[vertices[:, 2] > 0.02]
    assert grip[:, 0].mean() == pytest.approx(0.2)
    assert grip[:, 2].max() == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("weel radius=0.2", "unknown type 'weel'; expected box, cylinder, capsule, wheel, lever"),
        ("wheel radius=0.2", "rim_radius: is missing"),
        ("wheel radius=x", "radius: 'x' is no number"),
        ("wheel radius=0.2 radius=0.3", "radius is given twice"),
        (
            "wheel big",
            "'big' is no NAME=NUMBER; expected such as 'wheel radius=0.3 rim_radius=0.02 spokes=5'",
        ),
        ("box size=0.1,0.2", "size: entry 3 is missing, got [0.1, 0.2]"),
    ],
)
def test_a_wrong_parameter_is_refused_in_one_line(text: str, problem: str) -> None:
    with pytest.raises(RequestError) as caught:
        parse_object_text(text)
    assert str(caught.value) == problem


def test_sizes_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(RequestError, match=r"wheel: rim_radius 0.2 m is not smaller than radius 0.1 m"):
        make_object(parse_object_text("wheel radius=0.1 rim_radius=0.2"), "wheel")


def test_an_object_without_parts_is_refused() -> None:
    with pytest.raises(RequestError, match=r"a\.yaml: an object needs at least one part"):
        parse_object({"parts": []}, "a.yaml")


def test_a_file_is_no_line_of_parameters() -> None:
    assert is_object_text(WHEEL)
    assert not is_object_text("part number=3.stl near 1 2 3"[:4])
    assert not is_object_text("wheel.stl near=3")


def test_parts_of_a_file_stand_where_it_says(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    turned = "quaternion_wxyz: [0.7071068, 0.7071068, 0, 0]"
    path.write_text(
        "parts:\n- {type: box, size: [0.2, 0.1, 0.1]}\n"
        f"- {{type: cylinder, radius: 0.02, height: 0.3, position: [0, 0, 0.2], {turned}}}\n"
    )
    first, second = read_solid(path, "file", 2.0).closed
    np.testing.assert_allclose(np.ptp(first.vertices, axis=0), [0.4, 0.2, 0.2], atol=1e-9)
    np.testing.assert_allclose(np.ptp(second.vertices, axis=0), [0.08, 0.6, 0.08], atol=1e-3)
    np.testing.assert_allclose(second.vertices.mean(axis=0), [0.0, 0.0, 0.4], atol=1e-6)


def test_a_wheel_on_its_stem_is_found_in_the_whole_scan(wheel_scan: Cloud) -> None:
    best = find_matches(make_object(parse_object_text(WHEEL), "wheel"), make_view(wheel_scan))[0]
    assert best.confidence >= 0.5
    assert np.linalg.norm(best.pose_world_mesh[:3, 3] - CENTRE) < 0.005
    assert abs(best.pose_world_mesh[:3, 2] @ AXIS) > np.cos(np.radians(1.5))


def test_a_wheel_of_another_size_is_not_found(wheel_scan: Cloud) -> None:
    other = make_object(parse_object_text("wheel radius=0.22 rim_radius=0.015 spokes=3"), "wheel")
    matches = find_matches(other, make_view(wheel_scan), CENTRE)
    assert all(match.confidence < 0.5 for match in matches)


def test_the_command_says_how_well_a_scan_shows_an_object(tmp_path: Path, wheel_scan: Cloud) -> None:
    write_npz(tmp_path / "scan.npz", wheel_scan)
    pose = "0.9 0.1 1.1 0.8944272 0 -0.4472136 0"
    result = scopt("detect", "object", tmp_path / "scan.npz", "--object", f"{WHEEL} at {pose}", "--json")
    assert result.exit_code == 0
    hit = json.loads(result.stdout)["hits"][0]
    assert hit["kind"] == "wheel"
    assert hit["confidence"] >= 0.5
    assert hit["residuals"]["missing_share"] < 0.5


def test_an_object_needs_its_kind_and_the_kind_an_object(tmp_path: Path, wheel_scan: Cloud) -> None:
    for words in (("object",), ("valve", "--object", WHEEL)):
        result = scopt("detect", words[0], tmp_path / "none.npz", *words[1:])
        assert result.exit_code != 0
        assert "KIND: 'object' and --object need each other" in result.stderr


def test_a_crank_is_not_found_on_a_post_that_goes_on_at_both_of_its_ends() -> None:
    post = cylinder((0.8, 0.3, 0.0), (0.8, 0.3, 1.15), 0.015)
    head = cylinder((0.75, 0.3, 1.3), (0.85, 0.3, 1.3), 0.15)
    room = [box((-4.0, -4.0, -0.1), (4.0, 4.0, 0.0)), box((1.5, -2.0, 0.0), (1.6, 2.0, 2.4))]
    cloud = scan([post, head, *room], Pose.looking((0.1, 0.0, 1.6), (0.9, 0.0, 1.0), 0.0), Scanner(n_lines=120), 0)
    crank = unite_meshes(make_lever(0.22, 0.012, 0.1), "crank")
    assert all(match.confidence < 0.5 for match in find_matches(crank, make_view(cloud)))


def test_a_crank_is_not_taken_the_wrong_way_round_on_its_stem() -> None:
    # The stem looks like the grip, and the first fit has them exchanged.
    scene, pose = make_given("crank_22", 1)
    crank = unite_meshes(make_lever(0.22, 0.012, 0.1), "crank")
    best = find_matches(crank, make_view(scene.scan("solid")))[0]
    assert best.confidence >= 0.5
    assert np.linalg.norm(best.pose_world_mesh[:3, 3] - pose[:3, 3]) < 0.01
