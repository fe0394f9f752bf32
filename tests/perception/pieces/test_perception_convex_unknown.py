"""Unknown space on request: what no ray has seen is occupied, what a ray has seen is not."""

from __future__ import annotations

import numpy as np
import pytest
from half_spaces import half_spaces

from costs.scene import ConvexPiece
from perception import Cloud, Perceived, Reach, perceive
from perception.convex.hulls import MAX_VERTICES
from perception.simulate import Pose, Room, Scanner, scan

REACH = Reach(radius=2.0, top=2.0)
WORLD = Room(wall_x=None, boxes=(((0.8, -0.4, 0.0), (1.0, 0.4, 1.1)),)).meshes()
BEHIND = np.array([[x, y, z] for x in (1.1, 1.2, 1.3) for y in (-0.2, 0.0, 0.2) for z in (0.1, 0.3, 0.5)])
# A torso about the origin, over the floor up to under the sensor.
TORSO = np.array([[x, y, z] for x in (-0.15, 0.1) for y in (-0.2, 0.2) for z in (0.0, 1.3)])


def inside(points: np.ndarray, pieces: list[ConvexPiece]) -> np.ndarray:
    mask = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        faces = half_spaces(piece.vertices)
        mask |= (points @ faces[:, :3].T + faces[:, 3] <= 0.0).all(axis=1)
    return mask


def unknown(perceived: Perceived) -> list[ConvexPiece]:
    return [piece for piece in perceived.scene.pieces if piece.kind == "unknown"]


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    return scan(WORLD, Pose((0.1, 0.0, 1.6), pitch=0.3), Scanner(n_lines=90), seed=1)


@pytest.fixture(scope="module")
def seen(cloud: Cloud) -> Perceived:
    return perceive(cloud, reach=REACH, unknown="occupied")


def test_what_lies_behind_a_box_is_occupied(seen: Perceived) -> None:
    assert inside(BEHIND, unknown(seen)).all()


def test_unknown_space_is_left_open_unless_requested(cloud: Cloud) -> None:
    plain = perceive(cloud, reach=REACH)
    assert not unknown(plain)
    assert not inside(BEHIND, list(plain.scene.pieces)).any()


def test_no_place_that_a_ray_has_seen_is_unknown(cloud: Cloud, seen: Perceived) -> None:
    starts, ends = cloud.rays
    length = np.linalg.norm(ends - starts, axis=1, keepdims=True)
    fraction = np.random.default_rng(0).uniform(0.0, 1.0, (len(ends), 6))
    t = fraction * np.maximum(1.0 - 0.05 / length, 0.0)
    places = (starts[:, None] + t[:, :, None] * (ends - starts)[:, None]).reshape(-1, 3)
    places = places[REACH.contains(places)]
    assert len(places) > 50_000
    assert not inside(places, unknown(seen)).any()


def test_unknown_pieces_are_few_and_small_and_lie_in_reach(seen: Perceived) -> None:
    pieces = unknown(seen)
    assert 1 <= len(pieces) <= 150
    for i, piece in enumerate(pieces):
        assert piece.name == f"unknown/{i}"
        assert len(piece.vertices) <= MAX_VERTICES
        assert np.abs(piece.vertices[:, :2]).max() <= REACH.radius + 0.05
        # Below the floor nothing is asked.
        assert piece.vertices[:, 2].min() >= -0.06


def test_most_of_what_no_ray_has_seen_is_covered(seen: Perceived) -> None:
    # The box's shadow, as the sensor's place and the box's edges make it.
    rng = np.random.default_rng(2)
    places = rng.uniform([1.05, -0.6, 0.0], [1.9, 0.6, 1.1], (20_000, 3))
    sensor = np.array([0.1, 0.0, 1.6])
    t = (0.8 - sensor[0]) / (places[:, 0] - sensor[0])
    at_front = sensor + t[:, None] * (places - sensor)
    t = (1.0 - sensor[0]) / (places[:, 0] - sensor[0])
    at_back = sensor + t[:, None] * (places - sensor)
    is_hidden = (np.abs(at_front[:, 1]) < 0.4) & (at_back[:, 2] < 1.1)
    places = places[is_hidden & (np.hypot(*places[:, :2].T) < 1.95)]
    assert len(places) > 2_000
    # The rest is a border of two cells next to what was seen.
    assert inside(places, unknown(seen)).mean() > 0.75


def test_the_robot_s_own_place_is_not_unknown(cloud: Cloud) -> None:
    hulls, sole = [TORSO], np.array([[x, y, 0.0] for x in (0.2, 0.45) for y in (0.05, 0.2)])
    rng = np.random.default_rng(3)
    within = rng.uniform(TORSO.min(axis=0), TORSO.max(axis=0), (500, 3))
    over_sole = rng.uniform([0.2, 0.05, 0.0], [0.45, 0.2, 0.1], (200, 3))
    # A sensor that looks only ahead sees neither.
    ahead = cloud.select(cloud.points[:, 0] > 0.75)
    blind = unknown(perceive(ahead, reach=REACH, unknown="occupied"))
    assert inside(within, blind).any()
    assert inside(over_sole, blind).any()
    aware = unknown(perceive(ahead, reach=REACH, unknown="occupied", robot_hulls=hulls, soles=[sole]))
    assert not inside(within, aware).any()
    assert not inside(over_sole, aware).any()
