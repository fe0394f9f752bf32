"""Robots of many makers, from the package example-robot-data (extra ``robots``)."""

from __future__ import annotations

import sys
from pathlib import Path

import coal
import numpy as np
import pytest

from costs.robot import read_robot_visuals
from costs.robot.mesh import read_vertices
from service import parse_request, plan


@pytest.fixture(name="share", scope="module")
def _share() -> Path:
    for entry in sys.path:
        folder = Path(entry) / "cmeel.prefix" / "share"
        if (folder / "example-robot-data").is_dir():
            return folder
    pytest.skip("example-robot-data is not installed (pip install 'scopt[robots]')")


def test_the_stock_panda_is_certified_with_its_gripper(share: Path) -> None:
    urdf = share / "example-robot-data" / "robots" / "panda_description" / "urdf" / "panda.urdf"
    start = {"panda_joint4": -1.5, "panda_joint6": 1.5, "panda_finger_joint1": 0.02}
    data = {
        "robot": {"urdf": str(urdf), "package_dirs": [str(share)]},
        "start": {"joints": start},
        "goal": {"joints": {"panda_joint1": 0.3, "panda_finger_joint1": 0.04}},
    }
    result = plan(parse_request(data, folder=urdf.parent))
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert result.robot.n == 8
    looks = read_robot_visuals(result.robot)
    assert len(looks) == 11
    assert sum(len(look.triangles) for look in looks) < 70_000


def test_collada_files_of_others_have_the_vertices_that_another_reader_finds(share: Path) -> None:
    robots = share / "example-robot-data" / "robots"
    for name in ("hyq_description/meshes/leg/upperleg.dae", "panda_description/meshes/visual/link3.dae"):
        path = robots / name
        if not path.is_file():
            pytest.skip(f"this version of example-robot-data has no {name}")
        ours = read_vertices(path, "link")
        theirs = np.array(coal.MeshLoader().load(str(path), np.ones(3)).vertices()).reshape(-1, 3)
        np.testing.assert_allclose(ours.min(axis=0), theirs.min(axis=0), atol=1e-6)
        np.testing.assert_allclose(ours.max(axis=0), theirs.max(axis=0), atol=1e-6)
