"""Graph of poses in the data of the page: links of the poses, what is kept of many poses, and pages without a graph."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from posed_results import PATH, make_graph, make_posed_result, place_graph
from scipy.spatial.transform import Rotation
from urdf_momentum import euler, place_frames, read_links
from viewer_results import LINKS, make_result, unpack

import service.viewer.pose_graph as module
from costs.robot import load_robot
from service.viewer import LinkPlacements, make_pose_graph, place_poses, write_viewer
from service.viewer.payload import make_payload
from service.viewer.pose_graph import rank_poses


def test_drawn_poses_are_where_the_joints_of_the_urdf_put_the_links():
    robot = load_robot("atlas")
    rng = np.random.default_rng(4)
    q = robot.postures["stand"] + rng.uniform(-0.5, 0.5, (6, robot.n))
    poses = [{**pose, "q": row.tolist()} for pose, row in zip(make_graph()["poses"], q, strict=True)]
    graph = {**make_graph(), "poses": poses}
    bodies = [{"name": body.name, "link": body.link} for body in robot.bodies]
    placed = place_poses(robot, {"pose_graph": graph, "bodies": bodies})
    drawn = make_pose_graph(graph, placed)
    positions, rotations = unpack(drawn["positions"]), unpack(drawn["rotations"]) / 32767.0
    links = read_links(robot.source.urdf)
    column = {link.name: k for k, link in enumerate(links)}
    assert set(drawn["links"]) == {body["link"] for body in bodies}
    for pose, row in zip(drawn["poses"], q, strict=True):
        joints = dict(zip(robot.joint_names[6:], row[6:], strict=True))
        turned, moved = place_frames(links, euler(row[5], row[4], row[3]), row[:3], joints)
        for k, link in enumerate(drawn["links"]):
            np.testing.assert_allclose(positions[pose["drawn"], k], moved[column[link]], atol=5e-5)
            turn = Rotation.from_quat(rotations[pose["drawn"], k], scalar_first=True).as_matrix()
            np.testing.assert_allclose(turn, turned[column[link]], atol=1e-4)


def test_a_result_without_a_graph_has_the_page_it_had(tmp_path):
    result, moved = make_result()
    assert place_poses(load_robot("atlas"), result) is None
    assert place_poses(load_robot("atlas"), {**result, "pose_graph": None}) is None
    assert "pose_graph" not in make_payload(result, moved)
    write_viewer(result, moved, tmp_path / "a.html")
    write_viewer({**result, "pose_graph": None}, moved, tmp_path / "b.html", None)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_a_graph_without_poses_keeps_its_counts():
    graph = {**make_graph(), "poses": [], "path": [], "cost": None, "slip_m": None}
    bodies = [{"name": "pelvis", "link": "pelvis"}]
    made = make_pose_graph(graph, place_poses(load_robot("atlas"), {"pose_graph": graph, "bodies": bodies}))
    assert [phase["solved"] for phase in made["phases"]] == [1, 9, 1]
    assert (made["poses"], made["path"]) == ([], [])


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 70))
def test_the_chosen_poses_and_the_cheapest_of_each_phase_are_drawn_first(seed, n, room):
    rng = np.random.default_rng(seed)
    poses = [
        {"phase": f"p{rng.integers(4)}", "cost": rng.random(), "cost_to_end": rng.choice([None, rng.random()])}
        for _ in range(n)
    ]
    path = sorted(rng.choice(n, rng.integers(0, min(n, 4) + 1), replace=False).tolist())
    order = rank_poses(poses, path).tolist()
    assert sorted(order) == list(range(n))
    assert sorted(order[: len(path)]) == path
    to_end = [np.inf if pose["cost_to_end"] is None else pose["cost_to_end"] for pose in poses]
    kept = set(order[: max(room, len(path))])
    for i in set(range(n)) - kept:
        own = [k for k in kept - set(path) if poses[k]["phase"] == poses[i]["phase"]]
        assert all(to_end[k] <= to_end[i] for k in own)


def test_no_more_poses_are_drawn_than_there_is_room_for(monkeypatch):
    monkeypatch.setattr(module, "MAX_POSE_BYTES", 4 * 14 * len(LINKS))
    made = make_pose_graph(make_graph(), place_graph())
    assert unpack(made["positions"]).shape == (4, len(LINKS), 3)
    assert sorted(pose["drawn"] for pose in made["poses"]) == [-1, -1, 0, 1, 2, 3]
    assert min(made["poses"][i]["drawn"] for i in made["path"]) >= 0
    places = unpack(made["positions"])[:, 0]
    for i, pose in enumerate(made["poses"]):
        if pose["drawn"] >= 0:
            np.testing.assert_allclose(places[pose["drawn"]], place_graph().poses[i, 0, :3], atol=5e-5)
    monkeypatch.setattr(module, "MAX_SHOWN_POSES", 5)
    few = make_pose_graph(make_graph(), place_graph())
    assert (len(few["poses"]), few["left_out"]) == (5, 1)
    assert [few["poses"][i]["cost"] for i in few["path"]] == [make_graph()["poses"][i]["cost"] for i in PATH]


def test_thousands_of_poses_and_reasons_stay_below_one_and_a_half_megabytes():
    n, links = 6000, tuple(f"link_{k}" for k in range(30))
    graph = make_graph()
    graph["phases"] = [
        {**phase, "failures": {f"'right_foot within platform' is off by {i} m": 1 + (i == 7) for i in range(1000)}}
        for phase in graph["phases"]
    ]
    graph["poses"] = [{**graph["poses"][i % 6], "cost": 0.1234567890123 + i} for i in range(n)]
    table = np.random.default_rng(0).normal(size=(n, 30, 7))
    table[..., 3:] /= np.linalg.norm(table[..., 3:], axis=-1, keepdims=True)
    made = make_pose_graph(graph, LinkPlacements(links, table))
    assert len(json.dumps(made, separators=(",", ":"))) < 1_500_000
    assert made["phases"][0]["failures"][0] == ["'right_foot within platform' is off by 7 m", 2]
    assert made["phases"][0]["other_failures"] == 1001 - sum(count for _, count in made["phases"][0]["failures"])


def test_contradictions_are_refused_by_name():
    graph, placed = make_graph(), place_graph()
    with pytest.raises(ValueError, match="5 poses, placements have 6"):
        make_pose_graph({**graph, "poses": graph["poses"][:5]}, placed)
    with pytest.raises(ValueError, match="'crawl' is not among the phases"):
        make_pose_graph({**graph, "poses": [*graph["poses"][:5], {**graph["poses"][5], "phase": "crawl"}]}, placed)
    robot = load_robot("atlas")
    short = {**graph, "poses": [{**graph["poses"][0], "q": [0.0] * (robot.n - 1)}]}
    with pytest.raises(ValueError, match=f"{robot.n - 1} coordinates; atlas has {robot.n}"):
        place_poses(robot, {"pose_graph": short, "bodies": []})


def test_the_page_of_a_posed_result_holds_its_graph(tmp_path):
    result, moved = make_posed_result()
    write_viewer(result, moved, tmp_path / "viewer.html", place_graph())
    assert '"pose_graph":{"phases":[{"name":"sit"' in (tmp_path / "viewer.html").read_text("utf-8")
