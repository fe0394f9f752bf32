"""Link poses for the viewer: forward kinematics with quaternions that do not flip."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.robot import load_robot
from service.viewer import LinkPlacements, place_links, write_viewer
from service.viewer.placements import align_signs


def test_placements_agree_with_pinocchio_at_every_sample():
    robot = load_robot("atlas")
    rng = np.random.default_rng(5)
    q = robot.postures["stand"] + rng.uniform(-0.3, 0.3, (4, robot.n))
    placements = place_links(robot, q, ["l_hand", "pelvis"])
    data = robot.model.createData()
    for sample in range(4):
        pin.framesForwardKinematics(robot.model, data, q[sample])
        placement = data.oMf[robot.model.getFrameId("l_hand")]
        x, y, z, qw, qx, qy, qz = placements.poses[sample, 0]
        np.testing.assert_allclose((x, y, z), placement.translation, atol=1e-12)
        np.testing.assert_allclose(pin.Quaternion(qw, qx, qy, qz).matrix(), placement.rotation, atol=1e-9)


def test_an_unknown_link_is_named():
    robot = load_robot("atlas")
    with pytest.raises(ValueError, match="'third_arm'"):
        place_links(robot, robot.postures["stand"][None], ["pelvis", "third_arm"])


@given(st.integers(0, 2**32 - 1))
def test_continuous_keeps_rotations_and_never_jumps_to_the_far_side(seed):
    rng = np.random.default_rng(seed)
    angle = np.cumsum(rng.uniform(-0.5, 0.5, 40))
    poses = np.zeros((40, 1, 7))
    poses[:, 0, 3], poses[:, 0, 6] = np.cos(angle / 2), np.sin(angle / 2)
    flipped = poses.copy()
    flipped[..., 3:] *= rng.choice([-1.0, 1.0], (40, 1, 1))
    mended = align_signs(flipped)[:, 0, 3:]
    assert np.all(np.sum(mended[1:] * mended[:-1], axis=1) > 0.9)
    np.testing.assert_allclose(np.abs(np.sum(mended * poses[:, 0, 3:], axis=1)), 1.0, atol=1e-12)


@pytest.mark.parametrize("poses", [np.zeros((3, 1, 7)), np.full((3, 2, 7), np.nan)])
def test_placements_of_wrong_shape_or_nan_are_refused(poses):
    with pytest.raises(ValueError, match="poses must"):
        LinkPlacements(("a", "b"), poses)


def test_atlas_with_two_thousand_samples_stays_below_three_megabytes(tmp_path):
    robot = load_robot("atlas")
    u = np.linspace(0.0, 1.0, 2000)[:, None]
    stand = robot.postures["stand"]
    q = stand + u * (robot.postures["reach_ready"] - stand)
    links = sorted({body.link for body in robot.bodies})
    rng = np.random.default_rng(0)
    result = {
        "verdict": "CERTIFIED",
        "robot": {"name": "atlas"},
        "trajectory": {"times": np.linspace(0.0, 66.0, 2000).tolist()},
        "bodies": [{"name": b.name, "link": b.link, "vertices": b.vertices.tolist()} for b in robot.bodies],
        "pieces": [{"name": f"p{i}", "vertices": rng.normal(size=(32, 3)).tolist()} for i in range(80)],
        "waypoints": list(range(0, 2000, 40)),
        "com": np.zeros((2000, 3)).tolist(),
        "zmp": np.zeros((2000, 2)).tolist(),
        "cloud": rng.uniform(-2.0, 2.0, (60_000, 3)).tolist(),
    }
    path = tmp_path / "viewer.html"
    write_viewer(result, place_links(robot, q, links), path)
    assert path.stat().st_size < 3_000_000
