"""Data of the viewer page: hulls, thinned frames, packed numbers, and no executable content."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from viewer_results import box, make_result, unpack

from costs.robot import VisualMesh
from service.scan.json_data import to_json_data
from service.viewer import LinkPlacements, write_viewer
from service.viewer.html import render_viewer
from service.viewer.hulls import make_convex_mesh
from service.viewer.payload import make_payload, pack, quantize, select_samples


def signed_volume(mesh):
    corners = mesh.vertices[mesh.triangles]
    return np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0


@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
def test_hull_triangles_face_outward_and_enclose_the_hulls_volume(seed, n):
    points = np.random.default_rng(seed).normal(size=(n, 3))
    assert signed_volume(make_convex_mesh(points)) == pytest.approx(ConvexHull(points).volume, rel=1e-9)


def test_a_box_has_its_twelve_edges_at_right_angles():
    mesh = make_convex_mesh(np.array(box((1, 2, 3), (0.2, 0.4, 0.6))))
    assert len(mesh.edges) == 12
    assert mesh.bends == pytest.approx(np.full(12, np.pi / 2))


def test_a_flat_set_becomes_a_two_sided_polygon():
    mesh = make_convex_mesh(np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1], [0.5, 0.5, 1.0]]))
    assert len(mesh.triangles) == 4
    assert len(mesh.edges) == 4
    assert signed_volume(mesh) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("points", [[[1, 2, 3]], [[0, 0, 0], [1, 1, 1]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]]])
def test_a_point_or_line_has_no_surface(points):
    assert len(make_convex_mesh(np.array(points, dtype=float)).triangles) == 0


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.array([[0, 0, np.nan]]), np.zeros((3, 2))])
def test_a_hull_of_nothing_or_of_nan_is_refused(points):
    with pytest.raises(ValueError, match="finite vertices"):
        make_convex_mesh(points)


@given(st.integers(1, 400), st.floats(0.1, 30.0), st.lists(st.integers(0, 399), max_size=8))
def test_kept_samples_hold_ends_and_waypoints_at_no_more_than_thirty_per_second(n, duration, waypoints):
    times = np.linspace(0.0, duration, n)
    inside = [i for i in waypoints if i < n]
    kept = select_samples(times, waypoints)
    assert {0, n - 1, *inside} <= set(kept.tolist())
    assert len(kept) <= 30.0 * duration + 2 + len(set(inside))


def test_few_samples_are_all_kept():
    assert select_samples(np.linspace(0.0, 2.0, 21), []).tolist() == list(range(21))


@given(st.integers(0, 2**32 - 1))
def test_quantized_points_are_within_half_a_grid_step(seed):
    points = np.random.default_rng(seed).uniform(-3.0, 5.0, (50, 3))
    step = (points.max(axis=0) - points.min(axis=0)) / 65535.0
    assert np.all(np.abs(unpack(quantize(points)) - points) <= 0.51 * step)


def test_packed_arrays_read_back():
    values = np.array([[1.5, -2.0], [np.nan, 4.0]])
    np.testing.assert_array_equal(unpack(pack(values, "f4")), values.astype(np.float32))


def test_payload_places_links_where_the_result_has_them():
    result, placements = make_result(n_samples=601, duration=6.0)
    payload = make_payload(result, placements)
    times = unpack(payload["times"])
    samples = np.rint(times / 6.0 * 600).astype(int)
    assert len(samples) < 601
    np.testing.assert_allclose(unpack(payload["positions"])[:, :6], placements.poses[samples, :, :3], atol=5e-5)
    np.testing.assert_allclose(
        unpack(payload["rotations"])[:, :6] / 32767.0, placements.poses[samples, :, 3:], atol=5e-5
    )
    np.testing.assert_allclose(times[payload["waypoints"]], np.array(result["waypoints"]) / 100.0, atol=1e-5)


def test_phases_and_supports_speak_in_seconds():
    payload = make_payload(*make_result())
    assert [(phase["start"], phase["end"]) for phase in payload["phases"]] == [(0.0, 3.0), (3.0, 6.0)]
    assert payload["support"][0]["end"] == 6.0


def test_a_scene_without_trajectory_keeps_its_pieces():
    result, _ = make_result()
    for key in (
        "trajectory",
        "phases",
        "waypoints",
        "support_polygons",
        "com",
        "zmp",
        "movables",
        "cloud",
        "certificate",
    ):
        result[key] = None
    payload = make_payload(result, LinkPlacements((), np.zeros((0, 0, 7))))
    assert len(payload["pieces"]) == 3
    assert payload["times"]["shape"] == [0]


def test_placements_must_match_the_trajectory():
    result, _ = make_result(n_samples=61)
    with pytest.raises(ValueError, match="61 samples, placements have 31"):
        make_payload(result, make_result(n_samples=31)[1])


def test_a_body_without_placement_is_refused_by_name():
    result, placements = make_result()
    short = LinkPlacements(placements.links[:-1], placements.poses[:, :-1])
    with pytest.raises(ValueError, match="'r_foot'"):
        make_payload(result, short)


def test_numbers_that_json_lacks_become_null():
    assert to_json_data({"a": [float("nan"), np.float64(1.0)], "b": np.array([np.inf, 2.0])}) == {
        "a": [None, 1.0],
        "b": [None, 2.0],
    }


class _Elements(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags = []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_a_hostile_name_cannot_leave_the_data_element():
    result, placements = make_result()
    evil = "</script><img src=x onerror=alert(1)><!--"
    result["pieces"][1]["name"] = evil
    result["robot"]["name"] = evil
    page = render_viewer(make_payload(result, placements))
    parser = _Elements()
    parser.feed(page)
    assert "img" not in [tag for tag, _ in parser.tags]
    data = re.search(r'id="payload">(.*?)</script>', page, re.DOTALL).group(1)
    assert json.loads(data)["pieces"][1]["name"] == evil


def test_the_policy_allows_nothing_but_the_two_inlined_sources():
    page = render_viewer(make_payload(*make_result()))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page).group(1)
    directives = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    assert directives["default-src"] == "'none'"
    assert re.fullmatch(r"'sha256-[A-Za-z0-9+/=]{44}'", directives["script-src"])
    assert "unsafe" not in policy
    assert "http" not in policy


def test_write_viewer_replaces_the_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "viewer.html"
    path.write_text("old")
    write_viewer(*make_result(), path)
    assert path.read_text("utf-8").startswith("<!doctype html>")
    assert [entry.name for entry in tmp_path.iterdir()] == ["viewer.html"]


def test_what_links_look_like_is_packed_and_unknown_links_are_left_out():
    result, placements = make_result()
    link = placements.links[0]
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3]])
    looks = [VisualMesh(link, corners, faces), VisualMesh("nowhere", corners, faces)]
    (packed,) = make_payload(result, placements, looks)["visuals"]
    assert packed["link"] == link
    np.testing.assert_array_equal(unpack(packed["triangles"]), faces)
    np.testing.assert_allclose(unpack(packed["vertices"]), corners, atol=1e-4)
    assert make_payload(result, placements)["visuals"] == []


def test_a_look_with_more_vertices_than_indices_can_name_is_cut_off():
    result, placements = make_result()
    corners = np.random.default_rng(0).normal(size=(70_000, 3))
    look = VisualMesh(placements.links[0], corners, np.arange(69_999).reshape(-1, 3))
    (packed,) = make_payload(result, placements, [look])["visuals"]
    assert packed["vertices"]["shape"] == [65_535, 3]
    assert int(unpack(packed["triangles"]).max()) == 65_534
