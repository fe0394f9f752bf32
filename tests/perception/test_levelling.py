"""Levelling: upwards is found in clouds of any orientation, and the transform puts the floor at zero."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception import Cloud, read_cloud
from perception.files.pcd import write_pcd
from perception.files.placing import rigid_pose
from perception.levelling.level import find_levelling, make_level, move_cloud, propose_level
from perception.simulate import DepthCamera, Pose, box, scan

_CAMERA = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
_OPENGL = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])
_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_SENSOR = (0.0, 0.0, 1.4)


@cache
def _room() -> Cloud:
    """A depth image of a floor, two walls, a table and a carton, in the world."""
    meshes = [
        box((-1.0, -3.0, -0.1), (4.0, 3.0, 0.0)),
        box((3.0, -3.0, 0.0), (3.1, 3.0, 2.5)),
        box((-1.0, 2.0, 0.0), (4.0, 2.1, 2.5)),
        box((1.4, -0.6, 0.68), (2.2, 0.6, 0.72)),
        box((1.5, -0.2, 0.72), (1.8, 0.1, 1.0)),
    ]
    return scan(
        meshes, Pose(_SENSOR, pitch=0.5), DepthCamera(width=200, height=150, matching=0.02, step=1.0 / 128.0), seed=1
    )


def _turned(rotation: Float[np.ndarray, "3 3"]) -> Cloud:
    cloud = _room()
    return Cloud((cloud.points - _SENSOR) @ rotation.T, np.zeros(3))


@pytest.mark.parametrize("axes", [np.eye(3), _CAMERA, _OPENGL, _Y_UP], ids=["z-up", "camera", "opengl", "y-up"])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, -0.5, 0.2), (-0.6, 0.1, 0.3)])
def test_upwards_is_found_in_any_frame(axes: Float[np.ndarray, "3 3"], turn: tuple[float, float, float]) -> None:
    rotation = Rotation.from_rotvec(turn).as_matrix() @ axes
    levelling = find_levelling(_turned(rotation))
    assert levelling is not None
    assert np.degrees(np.arccos(min(1.0, levelling.pose[2, :3] @ rotation[:, 2]))) < 1.0
    assert abs(levelling.lift - 1.4) < 0.03


@pytest.mark.parametrize("axes", [_CAMERA, _OPENGL], ids=["camera", "opengl"])
def test_a_door_that_fills_the_view_of_a_near_camera_is_no_floor(axes: Float[np.ndarray, "3 3"]) -> None:
    meshes = [box((0.5, -1.0, 0.0), (0.6, 1.0, 2.0)), box((0.43, -0.1, 0.98), (0.45, 0.04, 1.0))]
    cloud = scan(meshes, Pose((0.0, 0.0, 1.1), pitch=0.1), DepthCamera(width=200, height=150), seed=1)
    levelling = find_levelling(Cloud((cloud.points - (0.0, 0.0, 1.1)) @ axes.T, np.zeros(3)))
    assert levelling is not None
    assert levelling.pose[2, :3] @ axes[:, 2] > np.cos(np.radians(8.0))


def test_the_proposed_transform_makes_the_cloud_level(tmp_path: Path) -> None:
    path = tmp_path / "camera.pcd"
    write_pcd(path, _turned(_CAMERA).points)
    (note,) = (note for note in read_cloud(path).notes if "ask for levelling" in note)
    words = note.split("the transform ")[1].split()[:7]
    pose = rigid_pose([float(word) for word in words])
    moved = read_cloud(path, transform=pose)
    levelled = read_cloud(path, level=True)
    np.testing.assert_allclose(moved.points, levelled.points, atol=2e-3)
    floor = levelled.points[levelled.points[:, 2] < 0.1]
    assert abs(np.median(floor[:, 2])) < 0.02
    assert np.median(levelled.points[:, 0]) > 1.0
    assert not any("ask for levelling" in note for note in levelled.notes)


def test_a_level_cloud_gets_no_proposal() -> None:
    assert propose_level(_room()) == ()


def test_a_cloud_upside_down_is_named() -> None:
    (note,) = propose_level(_turned(np.diag([1.0, -1.0, -1.0])))
    assert note.startswith("looks upside down")


def test_walls_give_upwards_without_a_floor() -> None:
    walls = [box((2.0, -1.5, -1.0), (2.1, 1.5, 3.0)), box((0.5, 1.2, -1.0), (2.0, 1.3, 3.0))]
    cloud = scan(walls, Pose(_SENSOR), DepthCamera(width=160, height=120, matching=0.02, step=1.0 / 128.0), seed=2)
    turned = move_cloud(cloud, rigid_pose([0.0, 0.0, 0.0, 0.0, 0.25, 0.15]))
    levelling = find_levelling(turned)
    assert levelling is not None
    error = levelling.pose[:3, :3] @ rigid_pose([0.0, 0.0, 0.0, 0.0, 0.25, 0.15])[:3, 2]
    assert np.degrees(np.arccos(min(1.0, error[2]))) < 2.0
    assert "walls" in levelling.reason
    assert "no floor is in view" in levelling.reason


def test_a_ramp_is_not_taken_for_the_floor() -> None:
    ramp = box((0.0, -1.0, -0.05), (2.5, 1.0, 0.0)).place(rigid_pose([1.2, 0.0, 0.0, 0.0, -0.2, 0.0]))
    meshes = [box((-1.0, -3.0, -0.1), (4.5, 3.0, 0.0)), ramp, box((3.8, -3.0, 0.0), (3.9, 3.0, 2.5))]
    cloud = scan(
        meshes, Pose(_SENSOR, pitch=0.4), DepthCamera(width=200, height=150, matching=0.02, step=1.0 / 128.0), seed=3
    )
    levelling = find_levelling(cloud)
    assert levelling is not None
    assert levelling.tilt_deg < 1.0


def test_a_cloud_without_a_flat_surface_stays_as_it_is() -> None:
    points = np.random.default_rng(0).normal(size=(3000, 3))
    levelled = make_level(Cloud(points, np.zeros(3)))
    np.testing.assert_array_equal(levelled.points, points)
    assert "not levelled" in levelled.notes[-1]


def test_a_cloud_that_the_file_says_up_of_is_turned_by_it() -> None:
    up = Rotation.from_rotvec([0.2, 0.1, 0.0]).as_matrix()[:, 2]
    levelling = find_levelling(_turned(np.eye(3)), up)
    assert levelling is not None
    np.testing.assert_allclose(levelling.pose[2, :3], up, atol=1e-9)
