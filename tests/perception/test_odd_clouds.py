"""Clouds that show little, or something odd: no invented pieces or objects, and a line that names what is odd."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from perception import Cloud, Perceived, perceive, read_cloud, write_pcd
from perception.simulate import Mesh, Pose, Scanner, box, capsule, scan

POSE = Pose((0.1, 0.0, 1.5), pitch=0.2)
FLOOR = box((-3.0, -3.0, -0.1), (4.0, 3.0, 0.0))
BELOW = box((-3.0, -3.0, -3.1), (4.0, 3.0, -3.0))
WALL = box((2.0, -2.0, 0.0), (2.1, 2.0, 2.5))
CRATE = box((1.0, -0.5, 0.0), (1.5, 0.5, 0.8))
PERSON = [
    capsule((1.5, 0.0, 0.9), (1.5, 0.0, 1.5), 0.18),
    capsule((1.5, -0.1, 0.05), (1.5, -0.1, 0.9), 0.09),
    capsule((1.5, 0.1, 0.05), (1.5, 0.1, 0.9), 0.09),
    capsule((1.5, 0.3, 0.9), (1.5, 0.25, 1.4), 0.05),
]


def _scan(*meshes: Mesh) -> Cloud:
    return scan(meshes, POSE, Scanner(n_lines=40, sigma=0.005), seed=1)


def _seen(path: Path, cloud: Cloud, change: np.ndarray, kinds: tuple[str, ...] = ("valve", "door")) -> Perceived:
    """What a file shows whose points and sensor were changed alike."""
    write_pcd(path / "a.pcd", cloud.points * change, (*(cloud.origin * change), 1.0, 0.0, 0.0, 0.0))
    return perceive(read_cloud(path / "a.pcd"), kinds=kinds)


@pytest.mark.parametrize(
    ("meshes", "change", "most", "says"),
    [
        ((WALL,), (1.0, 1.0, 1.0), 2, "no floor was found"),
        (tuple(PERSON), (1.0, 1.0, 1.0), 40, "no floor was found"),
        ((BELOW, WALL, CRATE), (1.0, 1.0, 1.0), 12, "no floor was found"),
        ((FLOOR, WALL, CRATE), (1.0, -1.0, -1.0), 12, "looks upside down"),
        ((FLOOR, WALL, CRATE), (3.28084, 3.28084, 3.28084), 240, "is its unit ft"),
    ],
    ids=["wall", "person", "glass floor", "upside down", "feet"],
)
def test_an_odd_cloud_is_named_and_nothing_is_found_in_it(
    tmp_path: Path, meshes: tuple[Mesh, ...], change: tuple[float, ...], most: int, says: str
) -> None:
    seen = _seen(tmp_path, _scan(*meshes), np.array(change))
    assert len(seen.scene.pieces) <= most
    assert all(hit.confidence < 0.5 for hit in seen.detections)
    assert any(says in note for note in seen.notes)


def test_a_mirrored_cloud_has_mirrored_pieces(tmp_path: Path) -> None:
    cloud = _scan(FLOOR, WALL, box((1.0, 0.3, 0.0), (1.5, 0.8, 0.8)))
    seen = _seen(tmp_path, cloud, np.array([1.0, -1.0, 1.0]), kinds=())
    crate = [
        piece.vertices for piece in seen.scene.pieces if piece.kind != "floor" and piece.vertices[:, 0].max() < 1.8
    ]
    assert crate
    assert np.concatenate(crate)[:, 1].max() < 0.0
