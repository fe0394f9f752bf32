"""GLB and OpenRAVE files, read back."""

from __future__ import annotations

import numpy as np
import pygltflib
import pytest
from lxml import etree
from viewer_results import SIZES, TURN, VALVE, make_result

from service.viewer import LinkPlacements, write_glb, write_openrave

Z_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def matrix_of(quaternion_xyzw):
    x, y, z, w = quaternion_xyzw
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rows_of(document, accessor_index):
    accessor = document.accessors[accessor_index]
    view = document.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
    blob = document.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    return np.frombuffer(blob, dtype="<f4").reshape(accessor.count, width)


@pytest.fixture
def glb(tmp_path):
    result, placements = make_result()
    path = tmp_path / "scene.glb"
    write_glb(result, placements, path)
    return pygltflib.GLTF2().load(str(path)), placements


def node_named(document, name):
    return next(i for i, node in enumerate(document.nodes) if node.name == name)


def channel_of(document, name, path):
    node = node_named(document, name)
    animation = document.animations[0]
    channel = next(c for c in animation.channels if c.target.node == node and c.target.path == path)
    sampler = animation.samplers[channel.sampler]
    return rows_of(document, sampler.input)[:, 0], rows_of(document, sampler.output)


def test_glb_names_every_link_piece_and_movable(glb):
    document, placements = glb
    assert {*placements.links, "floor", "crate", "wall", "valve"} <= {node.name for node in document.nodes}


def test_glb_root_turns_world_z_up_into_y_up(glb):
    document, _ = glb
    np.testing.assert_allclose(matrix_of(document.nodes[0].rotation), Z_TO_Y_UP, atol=1e-12)


def test_glb_animation_moves_the_hand_as_the_placements_do(glb):
    document, placements = glb
    times, track = channel_of(document, "l_hand", "translation")
    hand = placements.poses[:, placements.links.index("l_hand"), :3]
    assert times[-1] == pytest.approx(6.0)
    np.testing.assert_allclose(track, hand, atol=1e-6)


def test_glb_valve_turns_by_its_angle_about_its_axis(glb):
    document, _ = glb
    _, track = channel_of(document, "valve", "rotation")
    assert 2.0 * np.arccos(abs(track[-1, 3])) == pytest.approx(TURN, abs=1e-5)
    np.testing.assert_allclose(track[-1, :3] / np.sin(TURN / 2), [-1, 0, 0], atol=1e-5)
    np.testing.assert_allclose(document.nodes[node_named(document, "valve")].translation, VALVE)


def test_glb_valve_bodies_lie_around_the_point_they_turn_about(glb):
    document, _ = glb
    mesh = document.meshes[document.nodes[node_named(document, "valve")].mesh]
    corners = np.concatenate([rows_of(document, p.attributes.POSITION) for p in mesh.primitives])
    np.testing.assert_allclose(corners.min(axis=0), [-0.015, -0.015, -0.15], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [0.015, 0.015, 0.15], atol=1e-6)


def test_glb_rotations_never_jump_to_the_far_side(glb):
    document, _ = glb
    for name in ("torso", "valve"):
        _, track = channel_of(document, name, "rotation")
        assert np.all(np.sum(track[1:] * track[:-1], axis=1) > 0.5)


def test_glb_meshes_have_the_bodies_extents(glb):
    document, _ = glb
    mesh = document.meshes[document.nodes[node_named(document, "l_foot")].mesh]
    corners = rows_of(document, mesh.primitives[0].attributes.POSITION)
    np.testing.assert_allclose(np.ptp(corners, axis=0), SIZES["l_foot"], atol=1e-6)


def test_glb_of_a_scene_without_trajectory_has_no_animation(tmp_path):
    result, _ = make_result()
    result.update(trajectory=None, movables=None, waypoints=None)
    write_glb(result, LinkPlacements((), np.zeros((0, 0, 7))), tmp_path / "scene.glb")
    document = pygltflib.GLTF2().load(str(tmp_path / "scene.glb"))
    assert document.animations == []
    assert {node.name for node in document.nodes} == {"world", "floor", "crate", "wall"}


def test_openrave_trimeshes_hold_nine_numbers_per_triangle_on_the_pieces_hull(tmp_path):
    result, _ = make_result()
    environment, _ = write_openrave(result, tmp_path)
    root = etree.parse(str(environment)).getroot()
    crate = root.find("kinbody[@name='crate']/body/geom/vertices")
    numbers = np.array(crate.text.split(), dtype=float)
    assert numbers.size == 12 * 9
    corners = numbers.reshape(-1, 3)
    np.testing.assert_allclose(np.unique(corners, axis=0), np.unique(result["pieces"][1]["vertices"], axis=0))


def test_openrave_valve_is_a_hinge_at_its_origin(tmp_path):
    environment, _ = write_openrave(make_result()[0], tmp_path)
    joint = etree.parse(str(environment)).find("kinbody[@name='valve']/joint")
    assert joint.get("type") == "hinge"
    assert [body.text for body in joint.findall("body")] == ["base", "valve"]
    np.testing.assert_allclose(np.array(joint.findtext("anchor").split(), dtype=float), VALVE)
    np.testing.assert_allclose(np.array(joint.findtext("axis").split(), dtype=float), [-1, 0, 0])


def openrave_trajectory(path):
    root = etree.parse(str(path)).getroot()
    groups = {group.get("name"): group for group in root.iterfind("configuration/group")}
    data = root.find("data")
    table = np.array(data.text.split(), dtype=float).reshape(int(data.get("count")), -1)
    return root, groups, table


def test_openrave_trajectory_rows_are_base_joints_valve_and_time_steps(tmp_path):
    result, _ = make_result()
    root, groups, table = openrave_trajectory(write_openrave(result, tmp_path)[1])
    assert root.get("type") == "GenericTrajectory"
    assert set(groups) == {"joint_values boxer 0", "affine_transform boxer 39", "joint_values valve 0", "deltatime"}

    def columns(name):
        offset, dof = int(groups[name].get("offset")), int(groups[name].get("dof"))
        return table[:, offset : offset + dof]

    positions = np.array(result["trajectory"]["positions"])
    np.testing.assert_allclose(columns("affine_transform boxer 39"), positions[:, :7], atol=1e-8)
    np.testing.assert_allclose(columns("joint_values boxer 0"), positions[:, 7:], atol=1e-8)
    np.testing.assert_allclose(columns("joint_values valve 0")[-1], TURN, atol=1e-8)
    assert columns("deltatime")[0] == 0.0
    np.testing.assert_allclose(np.cumsum(columns("deltatime")), result["trajectory"]["times"], atol=1e-7)


def test_openrave_trajectory_of_a_fixed_base_has_joints_only(tmp_path):
    result, _ = make_result()
    result["trajectory"]["joint_names"] = [f"panda_joint{i}" for i in range(8)]
    _, groups, _ = openrave_trajectory(write_openrave(result, tmp_path)[1])
    assert groups["joint_values boxer 0 1 2 3 4 5 6 7"].get("dof") == "8"
    assert not any(name.startswith("affine_transform") for name in groups)


def test_openrave_without_trajectory_writes_the_environment_only(tmp_path):
    result, _ = make_result()
    result["trajectory"] = None
    assert [path.name for path in write_openrave(result, tmp_path)] == ["environment.xml"]
