"""Mechanisms as trees in the viewer's files: a bar that slides on a leaf that turns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pygltflib
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree
from tiny_robots import PLANAR, chain
from viewer_results import HINGE, SLIDE, door, make_result, movable, unpack

from costs.robot import MechanismJoint, RobotModel, with_mechanism
from service.viewer import LinkPlacements, write_glb, write_openrave
from service.viewer.movables import list_chains, place_movables
from service.viewer.payload import make_payload

N = 61


def augment(movables: list[dict[str, Any]]) -> RobotModel:
    """A robot with the joints of the movables; the reference for their poses."""
    return with_mechanism(
        chain(PLANAR),
        [
            MechanismJoint(
                name=m["joint"], link=m["name"], origin=np.array(m["origin"]), axis=np.array(m["axis"]),
                bodies={body["name"]: np.array(body["vertices"]) for body in m["bodies"]}, kind=m["type"],
                parent=m["parent"], lower=-9.0, upper=9.0,
            )
            for m in movables
        ],
    )  # fmt: skip


def poses_by_pinocchio(movables: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """(S, 4, 4) pose in the world of each link at each sample."""
    robot = augment(movables)
    data, n = robot.model.createData(), robot.n - len(movables)
    found: dict[str, list[np.ndarray]] = {m["name"]: [] for m in movables}
    for values in zip(*(m["angles"] for m in movables), strict=True):
        pin.framesForwardKinematics(robot.model, data, np.concatenate([np.zeros(n), values]))
        for name, poses in found.items():
            poses.append(data.oMf[robot.model.getFrameId(name)].homogeneous.copy())
    return {name: np.array(poses) for name, poses in found.items()}


def as_matrix(pose: Any) -> np.ndarray:
    """(4, 4) of ``x y z qw qx qy qz``."""
    x, y, z, qw, qx, qy, qz = (float(value) for value in pose)
    made = np.eye(4)
    made[:3, :3] = pin.Quaternion(qw, qx, qy, qz).normalized().matrix()
    made[:3, 3] = x, y, z
    return made


vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
axes = vectors.filter(lambda v: np.linalg.norm(v) > 0.1)
kinds = st.sampled_from(["revolute", "prismatic"])


@given(st.lists(st.tuples(vectors, axes, kinds, st.integers(-1, 3), st.floats(-3.0, 3.0)), min_size=1, max_size=4))
@settings(max_examples=40, deadline=None)
def test_links_of_any_tree_stand_where_pinocchio_has_them(joints: list[Any]) -> None:
    movables = [
        movable(f"m{i}", origin, axis, [0.0, value, -value], kind, f"m{above}" if 0 <= above < i else None)
        for i, (origin, axis, kind, above, value) in enumerate(joints)
    ]
    placed = place_movables(movables, 3)
    for column, (name, expected) in enumerate(poses_by_pinocchio(movables).items()):
        assert placed.links[column] == name
        made = np.array([as_matrix(pose) for pose in placed.poses[:, column]])
        np.testing.assert_allclose(made, expected, atol=1e-9)


def test_children_may_be_listed_before_their_parents() -> None:
    leaf, bar = door(N)
    forth, back = place_movables([leaf, bar], N), place_movables([bar, leaf], N)
    np.testing.assert_allclose(back.poses[:, ::-1], forth.poses, atol=1e-12)


def test_an_unknown_parent_and_a_cycle_are_refused_by_name() -> None:
    leaf, bar = door(N)
    with pytest.raises(ValueError, match="'door/bar': its parent 'gate' is no movable"):
        list_chains([leaf, {**bar, "parent": "gate"}])
    with pytest.raises(ValueError, match="'door/leaf': its parents form a cycle"):
        list_chains([{**leaf, "parent": "door/bar"}, bar])


def test_without_a_trajectory_a_movable_stands_at_its_start() -> None:
    leaf, bar = door(N)
    for values in ({"angles": []}, {"angles": None}, {}):
        placed = place_movables([{**leaf, **values}, {**bar, "angles": []}], 0)
        assert placed.poses.shape == (1, 2, 7)
        np.testing.assert_allclose(placed.poses[0, 0, 3:], [np.cos(0.1), 0.0, 0.0, -np.sin(0.1)], atol=1e-12)


def test_the_page_gets_the_poses_and_the_bodies_in_their_frames() -> None:
    result, placements = make_result(n_samples=N)
    result["movables"] = door(N)
    payload = make_payload(result, placements)
    expected = poses_by_pinocchio(door(N))
    samples = np.rint(unpack(payload["times"]) / 6.0 * (N - 1)).astype(int)
    positions, rotations = unpack(payload["positions"]), unpack(payload["rotations"]) / 32767.0
    for entry, source in zip(payload["movables"], door(N), strict=True):
        column = payload["links"].index(entry["name"])
        made = np.array([as_matrix([*p, *r]) for p, r in zip(positions[:, column], rotations[:, column], strict=True)])
        np.testing.assert_allclose(made, expected[entry["name"]][samples], atol=1e-4)
        np.testing.assert_allclose(unpack(entry["angles"]), np.array(source["angles"])[samples], atol=1e-6)
        assert entry["type"] == source["type"]
        (body,) = entry["bodies"]
        corners = unpack(body["hull"]["vertices"]) + np.array(source["origin"])
        np.testing.assert_allclose(
            np.unique(corners.round(6), axis=0), np.unique(np.round(source["bodies"][0]["vertices"], 6), axis=0),
            atol=2e-6,
        )  # fmt: skip


def test_glb_moves_the_bar_with_the_leaf(tmp_path: Any) -> None:
    result, placements = make_result(n_samples=N)
    result["movables"] = door(N)
    write_glb(result, placements, tmp_path / "scene.glb")
    document = pygltflib.GLTF2().load(str(tmp_path / "scene.glb"))

    def rows(index: int) -> np.ndarray:
        accessor = document.accessors[index]
        view = document.bufferViews[accessor.bufferView]
        blob = document.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
        return np.frombuffer(blob, dtype="<f4").reshape(accessor.count, -1)

    animation = document.animations[0]
    for name, expected in poses_by_pinocchio(door(N)).items():
        node = next(i for i, node in enumerate(document.nodes) if node.name == name)
        tracks = {
            channel.target.path: rows(animation.samplers[channel.sampler].output)
            for channel in animation.channels
            if channel.target.node == node
        }
        assert len(tracks["translation"]) == N
        np.testing.assert_allclose(tracks["translation"], expected[:, :3, 3], atol=1e-6)
        poses = np.hstack([tracks["translation"], tracks["rotation"][:, [3, 0, 1, 2]]])
        np.testing.assert_allclose([as_matrix(pose) for pose in poses], expected, atol=1e-6)


def test_openrave_has_one_kinbody_whose_joints_make_the_same_poses(tmp_path: Any) -> None:
    result, placements = make_result(n_samples=N)
    assert isinstance(placements, LinkPlacements)
    result["movables"] = door(N)[::-1]  # a tree in any order
    environment, trajectory = write_openrave(result, tmp_path)
    kinbody = etree.parse(str(environment)).find("kinbody[@name='door/leaf']")
    assert etree.parse(str(environment)).find("kinbody[@name='door/bar']") is None
    assert [body.get("name") for body in kinbody.findall("body")] == ["base", "door/leaf", "door/bar"]
    assert [joint.get("type") for joint in kinbody.findall("joint")] == ["hinge", "slider"]
    np.testing.assert_allclose(np.array(kinbody.findtext("jointvalues").split(), dtype=float), [0.2, 0.0])
    limits = [joint.findtext(tag) for joint, tag in zip(kinbody.findall("joint"), ("limitsdeg", "limits"), strict=True)]
    np.testing.assert_allclose(np.array(limits[0].split(), dtype=float), np.degrees([-9.0, 9.0]), rtol=1e-8)
    np.testing.assert_allclose(np.array(limits[1].split(), dtype=float), [-9.0, 9.0])

    root = etree.parse(str(trajectory)).getroot()
    group = next(g for g in root.iterfind("configuration/group") if g.get("name") == "joint_values door/leaf 0 1")
    data = root.find("data")
    table = np.array(data.text.split(), dtype=float).reshape(int(data.get("count")), -1)
    values = table[:, int(group.get("offset")) :][:, :2]
    expected = poses_by_pinocchio(door(N))
    for sample in (0, 20, N - 1):
        poses = {"base": np.eye(4)}
        for joint, value in zip(kinbody.findall("joint"), values[sample], strict=True):
            above, link = (body.text for body in joint.findall("body"))
            anchor, axis = (np.array(joint.findtext(tag).split(), dtype=float) for tag in ("anchor", "axis"))
            step = np.eye(4)
            if joint.get("type") == "hinge":
                step[:3, :3] = pin.exp3(axis / np.linalg.norm(axis) * value)
                step[:3, 3] = anchor - step[:3, :3] @ anchor
            else:
                step[:3, 3] = axis / np.linalg.norm(axis) * value
            poses[link] = poses[above] @ step
        for name, origin in (("door/leaf", HINGE), ("door/bar", SLIDE)):
            at_zero = np.eye(4)
            at_zero[:3, 3] = origin
            np.testing.assert_allclose(poses[name] @ at_zero, expected[name][sample], atol=1e-7)
