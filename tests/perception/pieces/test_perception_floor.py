"""The floor: found where it is, at all its levels, and not claimed where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perception import (
    Cloud,
    FloorPlane,
    Reach,
    find_floor_points,
    find_floors,
    floor_piece,
    floor_pieces,
    make_view,
    on_floor,
    on_floors,
)

EYE = np.array([0.0, 0.0, 1.6])
NOISE = 0.007


def find_floor(points: np.ndarray) -> FloorPlane | None:
    """The level under the robot."""
    return next(iter(find_floors(points)), None)


def floor_points(slope_deg: float, height: float, rng: np.random.Generator, n: int = 6000) -> np.ndarray:
    """A noisy floor that rises along x, seen in a 4 m square."""
    xy = rng.uniform(-2, 2, (n, 2))
    z = height + np.tan(np.radians(slope_deg)) * xy[:, 0] + rng.normal(0, 0.008, n)
    return np.column_stack([xy, z])


@pytest.mark.parametrize("slope_deg", [0.0, 2.0, 4.5])
@pytest.mark.parametrize("height", [0.0, -0.3])
def test_the_floor_is_found_though_a_table_holds_more_points(slope_deg: float, height: float) -> None:
    rng = np.random.default_rng(2)
    table = np.column_stack([rng.uniform(0.5, 1.5, 9000), rng.uniform(-0.5, 0.5, 9000), rng.normal(0.75, 0.008, 9000)])
    wall = np.column_stack([np.full(5000, 1.8), rng.uniform(-2, 2, 5000), rng.uniform(height, 2, 5000)])
    floor = find_floor(np.concatenate([floor_points(slope_deg, height, rng), table, wall]))
    assert floor is not None
    tilt = np.radians(slope_deg)
    angle = np.degrees(np.arccos(min(1.0, float(floor.normal @ [-np.sin(tilt), 0, np.cos(tilt)]))))
    assert angle < 0.2
    assert abs(floor.height(np.zeros((1, 2)))[0] - height) < 0.003


def test_no_floor_is_claimed_where_there_is_none() -> None:
    rng = np.random.default_rng(3)
    wall = np.column_stack([np.full(5000, 1.5), rng.uniform(-2, 2, 5000), rng.uniform(0, 2, 5000)])
    assert find_floor(wall) is None
    assert find_floor(np.concatenate([wall, wall[:, [1, 0, 2]], rng.uniform(0, 2, (3000, 3))])) is None
    assert find_floor(floor_points(20.0, 0.0, rng)) is None
    assert find_floor(np.zeros((0, 3))) is None


def test_a_table_with_things_under_it_is_no_floor() -> None:
    rng = np.random.default_rng(6)
    table = np.column_stack([rng.uniform(0.5, 1.5, 9000), rng.uniform(-0.5, 0.5, 9000), rng.normal(0.75, 0.008, 9000)])
    legs = np.column_stack([rng.choice([0.5, 1.5], 800), rng.choice([-0.5, 0.5], 800), rng.uniform(0.0, 0.7, 800)])
    assert find_floor(np.concatenate([table, legs])) is None


def test_what_lies_three_centimetres_over_the_floor_under_a_sole_is_floor() -> None:
    floor = find_floor(floor_points(0.0, 0.0, np.random.default_rng(4)))
    assert floor is not None
    sole = np.array([[-0.1, -0.05, 0], [0.1, -0.05, 0], [0.1, 0.05, 0], [-0.1, 0.05, 0]])[[2, 0, 3, 1]]
    points = np.array(
        [[0, 0, 0.028], [0.3, 0, 0.028], [0, 0, 0.04], [0.3, 0, 0.01], [0, 0, -0.2], [0.09, 0.049, 0.028]]
    )
    assert on_floor(points, floor, [sole]).tolist() == [True, False, False, True, True, True]
    assert on_floor(points, floor).tolist() == [False, False, False, True, True, False]


def test_the_floor_piece_lies_under_the_plane_and_reaches_beyond_the_reach() -> None:
    floor = find_floor(floor_points(3.0, 0.1, np.random.default_rng(5)))
    assert floor is not None
    piece = floor_piece(floor, Reach(x=0.5, radius=2.0))
    above = floor.above(piece.vertices)
    assert above.max() < 1e-9
    assert (above > -0.21).all()
    assert piece.lower[0] == -2.5
    assert piece.upper[0] == 3.5
    assert piece.name == piece.kind == "floor"


def patch(
    rng: np.random.Generator, x: tuple[float, float], y: tuple[float, float], z: float, slope_deg: float = 0.0
) -> np.ndarray:
    """Noisy points of a rectangle, 1,500 per square metre, that rises along x from its near side."""
    n = int(1500 * (x[1] - x[0]) * (y[1] - y[0]))
    xy = rng.uniform([x[0], y[0]], [x[1], y[1]], (n, 2))
    rise = np.tan(np.radians(slope_deg)) * (xy[:, 0] - x[0])
    return np.column_stack([xy, z + rise + rng.normal(0.0, NOISE, n)])


def upright(rng: np.random.Generator, x: float, y: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
    n = int(1500 * (y[1] - y[0]) * (z[1] - z[0]))
    return np.column_stack([x + rng.normal(0, NOISE, n), rng.uniform(*y, n), rng.uniform(*z, n)])


def stairs(rng: np.random.Generator, rise: float, depth: float, n_steps: int) -> np.ndarray:
    """Ground up to 0.8 m ahead, then treads and risers 1.2 m wide."""
    parts = [patch(rng, (-2, 0.8), (-2, 2), 0.0), patch(rng, (0.8, 3), (0.6, 2), 0.0)]
    for i in range(n_steps):
        x = 0.8 + depth * i
        parts.append(upright(rng, x, (-0.6, 0.6), (rise * i, rise * (i + 1))))
        parts.append(patch(rng, (x, x + depth), (-0.6, 0.6), rise * (i + 1)))
    return np.concatenate(parts)


@pytest.mark.parametrize("slope_deg", [5.0, 10.0, 14.5])
def test_a_ramp_is_a_level_as_far_as_it_goes(slope_deg: float) -> None:
    rng = np.random.default_rng(1)
    ground, ramp = patch(rng, (-2, 1), (-2, 2), 0.0), patch(rng, (1, 2.6), (-0.6, 0.6), 0.0, slope_deg)
    floors = find_floors(np.concatenate([ground, ramp]))
    assert len(floors) == 2
    assert floors[0].slope_deg < 0.3
    assert floors[0].outlines == ()
    assert floors[1].slope_deg == pytest.approx(slope_deg, abs=0.4)
    corners = np.concatenate(floors[1].outlines)
    assert 0.7 < corners[:, 0].min() < 1.2
    np.testing.assert_allclose([corners[:, 0].max(), np.abs(corners[:, 1]).max()], [2.6, 0.6], atol=0.08)
    # No kerb is left where the ramp begins.
    assert on_floors(ramp, floors).mean() > 0.98


def test_a_ramp_steeper_than_a_robot_walks_is_no_floor() -> None:
    rng = np.random.default_rng(2)
    steep = patch(rng, (1, 2.6), (-0.6, 0.6), 0.0, 22.0)
    floors = find_floors(np.concatenate([patch(rng, (-2, 1), (-2, 2), 0.0), steep]))
    assert len(floors) == 1
    assert on_floors(steep, floors).mean() < 0.15


@pytest.mark.parametrize(("rise", "depth"), [(0.1, 0.3), (0.2, 0.28), (0.3, 0.4)])
def test_every_tread_of_stairs_is_a_level_at_its_height(rise: float, depth: float) -> None:
    floors = find_floors(stairs(np.random.default_rng(3), rise, depth, 4))
    heights = sorted(float(floor.height(np.array([[1.0, 0.0]]))[0]) for floor in floors)
    np.testing.assert_allclose(heights, rise * np.arange(5), atol=0.006)
    assert max(floor.slope_deg for floor in floors) < 1.5
    for floor in floors[1:]:
        corners = np.concatenate(floor.outlines)
        near = 0.8 + depth * (round(floor.height(np.array([[1.0, 0.0]]))[0] / rise) - 1)
        np.testing.assert_allclose(corners[:, 0].min(), near, atol=0.05)
        np.testing.assert_allclose(corners[:, 0].max(), near + depth, atol=0.05)


@settings(max_examples=8)
@given(st.floats(-3.1, 3.1), st.integers(0, 3))
def test_stairs_are_stairs_from_any_side(yaw: float, seed: int) -> None:
    turned = stairs(np.random.default_rng(seed), 0.18, 0.3, 3) @ Rotation.from_euler("z", yaw).as_matrix().T
    floors = find_floors(turned)
    np.testing.assert_allclose(
        sorted(float(floor.height(np.zeros((1, 2)))[0]) for floor in floors), 0.18 * np.arange(4), atol=0.02
    )
    covered = sum(_area(outline) for floor in floors[1:] for outline in floor.outlines)
    assert covered == pytest.approx(3 * 0.3 * 1.2, rel=0.25)


def _area(outline: np.ndarray) -> float:
    x, y = outline.T
    return float(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def test_a_step_too_high_to_take_is_no_level() -> None:
    rng = np.random.default_rng(4)
    bench = patch(rng, (1, 2), (-0.6, 0.6), 0.5)
    floors = find_floors(np.concatenate([patch(rng, (-2, 1), (-2, 2), 0.0), bench]))
    assert len(floors) == 1
    assert not on_floors(bench, floors).any()


def test_a_platform_ends_where_rays_go_down_beside_it() -> None:
    rng = np.random.default_rng(5)
    top = patch(rng, (-1.5, 1.0), (-1.2, 1.2), 0.0)
    below = patch(rng, (-3.5, 3.5), (-3.5, 3.5), -0.6)
    hidden = (np.abs(below[:, 1]) < 1.9) & (below[:, 0] > -2.3) & (below[:, 0] < 1.6)
    view = make_view(Cloud(np.concatenate([top, below[~hidden]]), EYE), reach=Reach(radius=4.0, bottom=-1.0))
    assert len(view.floors) == 2
    assert view.floor is view.floors[0]
    corners = np.concatenate(view.floors[0].outlines)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-1.5, -1.2], [1.0, 1.2]], atol=0.06)
    assert any("2 levels" in note for note in view.notes)
    pieces = floor_pieces(view.floors, view.reach)
    assert [piece.kind for piece in pieces] == ["floor"] * len(pieces)
    assert [piece.name for piece in pieces[:2]] == ["floor", "floor/1"]
    assert pieces[0].upper[0] < 1.07


def test_the_floor_goes_on_in_a_shadow() -> None:
    rng = np.random.default_rng(6)
    ground = patch(rng, (-2, 3), (-2, 2), 0.0)
    shadow = (ground[:, 0] > 1.0) & (np.abs(ground[:, 1]) < 0.5)
    crate = upright(rng, 1.0, (-0.4, 0.4), (0.0, 0.8))
    view = make_view(Cloud(np.concatenate([ground[~shadow], crate]), EYE))
    assert len(view.floors) == 1
    assert view.floors[0].outlines == ()
    assert floor_pieces(view.floors, view.reach)[0].upper[0] == 4.0


def test_a_table_alone_is_no_floor_whatever_its_size() -> None:
    assert floor_pieces((), Reach()) == []
    assert find_floors(patch(np.random.default_rng(7), (0.5, 2.5), (-1.5, 1.5), 0.75)) == ()


def test_a_board_with_the_ground_before_it_is_no_floor_unless_the_feet_are_at_its_height() -> None:
    rng = np.random.default_rng(21)
    board = patch(rng, (0.65, 1.05), (-0.5, 0.5), 0.1)
    ground = patch(rng, (0.55, 0.64), (-0.5, 0.5), 0.0)  # too narrow a strip to be a level
    seen = np.concatenate([board, np.repeat(ground, 4, axis=0) + rng.normal(0, 1e-3, (4 * len(ground), 3))])
    assert find_floor(board) is not None
    assert find_floor(seen) is None
    standing = find_floors(seen, stand=np.array([0.0, 0.0, 0.1]))
    assert abs(standing[0].height(np.zeros((1, 2)))[0] - 0.1) < 0.003


def test_the_robot_stands_where_its_soles_are() -> None:
    rng = np.random.default_rng(8)
    low, high = patch(rng, (-2, 0.4), (-2, 2), 0.0), patch(rng, (0.4, 3), (-2, 2), 0.3)
    points = np.concatenate([low, high])
    soles = [np.array([[1.5, y, 0.3], [1.8, y, 0.3], [1.8, y + 0.1, 0.3], [1.5, y + 0.1, 0.3]]) for y in (-0.2, 0.1)]
    on_top = make_view(Cloud(points, EYE + np.array([1.6, 0, 0.3])), reach=Reach(x=1.6), soles=soles)
    on_ground = make_view(Cloud(points, EYE))
    assert on_top.floor is not None
    assert on_ground.floor is not None
    assert float(on_top.floor.height(np.array([[1.6, 0.0]]))[0]) == pytest.approx(0.3, abs=0.01)
    assert float(on_ground.floor.height(np.zeros((1, 2)))[0]) == pytest.approx(0.0, abs=0.01)


def test_a_slope_under_the_robot_is_its_floor() -> None:
    slope = patch(np.random.default_rng(9), (-2, 2), (-2, 2), -np.tan(np.radians(10.0)) * 2.0, 10.0)
    floors = find_floors(slope)
    assert len(floors) == 1
    assert floors[0].slope_deg == pytest.approx(10.0, abs=0.2)


def test_what_stands_under_a_tread_is_no_floor() -> None:
    square = np.array([[1.0, -0.5], [1.5, -0.5], [1.5, 0.5], [1.0, 0.5]])
    up = np.array([0.0, 0.0, 1.0])
    floors = (FloorPlane(up, 0.0, 0.01, 4.0), FloorPlane(up, 0.3, 0.01, 0.5, (square,)))
    points = np.array([[1.2, 0, 0.31], [1.2, 0, 0.15], [1.2, 0.52, 0.3], [1.2, 0.6, 0.3], [0, 0, 0.01], [0, 0, 0.05]])
    assert on_floors(points, floors).tolist() == [True, False, True, False, True, False]


def test_a_level_ends_where_rays_went_between_its_parts() -> None:
    rng = np.random.default_rng(10)
    turned = Rotation.from_euler("z", 0.4).as_matrix()
    one, other = (patch(rng, (0.9, 1.5), y, 0.2) @ turned.T for y in ((-0.55, -0.05), (0.15, 0.65)))
    ground = patch(rng, (-2, 3), (-2, 2), 0.0)
    at_height = EYE + (ground - EYE) * ((EYE[2] - 0.2) / (EYE[2] - ground[:, 2]))[:, None]
    back = at_height @ turned
    hidden = (
        (back[:, 0] > 0.9) & (back[:, 0] < 1.5) & (np.abs(back[:, 1] - 0.05) < 0.6) & (np.abs(back[:, 1] - 0.05) > 0.1)
    )
    view = make_view(Cloud(np.concatenate([one, other, ground[~hidden]]), EYE))
    assert len(view.floors) == 2
    through = at_height[~hidden]
    inside = [_share_within(outline, through[:, :2], 0.03) for outline in view.floors[1].outlines]
    assert max(inside) == 0.0
    assert on_floors(np.concatenate([one, other]), view.floors).mean() > 0.98


def _share_within(outline: np.ndarray, xy: np.ndarray, depth: float) -> float:
    """Share of the places that lie deeper than this inside a convex, counter-clockwise outline."""
    sides = np.roll(outline, -1, axis=0) - outline
    outwards = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1)[:, None]
    return float((xy @ outwards.T - (outline * outwards).sum(axis=1) < -depth).all(axis=1).mean())


def test_upper_faces_at_one_height_with_gaps_between_them_are_no_level() -> None:
    rng = np.random.default_rng(11)
    ground = patch(rng, (-2, 3), (-2, 2), 0.0)
    beams = [patch(rng, (0.8, 1.8), (y, y + 0.09), 0.09) for y in (-0.28, -0.14, 0.0, 0.14)]
    in_shadow = (ground[:, 0] > 0.8) & (ground[:, 0] < 1.85) & ((ground[:, 1] + 0.28) % 0.14 < 0.09)
    in_shadow &= np.abs(ground[:, 1] + 0.025) < 0.26
    heap = np.concatenate([ground[~in_shadow], *beams])
    assert len(find_floors(heap)) == 1
    crate = patch(rng, (0.8, 1.2), (0.24, 0.64), 0.09)
    under = (np.abs(heap[:, 0] - 1.0) < 0.2) & (np.abs(heap[:, 1] - 0.44) < 0.2)
    floors = find_floors(np.concatenate([heap[~under], crate]))
    assert len(floors) == 2
    assert on_floors(crate, floors).mean() > 0.98
    assert on_floors(np.concatenate(beams[:2]), floors).mean() < 0.05


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.floats(0.011, 0.016), st.floats(-0.1, 0.1))
def test_noise_above_a_floor_is_the_floors_but_what_lies_on_it_is_not(seed: int, noise: float, slope: float) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1, 1, (20_000, 2))
    on_board = (np.abs(xy[:, 0]) < 0.3) & (np.abs(xy[:, 1]) < 0.2)
    plane = FloorPlane(np.array([-slope, 0.0, 1.0]) / np.hypot(1.0, slope), 0.0, noise, 4.0)
    above = rng.normal(0.0, noise, len(xy)) + 0.032 * on_board
    points = np.column_stack([xy, plane.height(xy)]) + above[:, None] * plane.normal
    stray = np.column_stack([xy[:20], plane.height(xy[:20]) + 0.07])
    found = find_floor_points(np.concatenate([points, stray]), [plane])
    beside = ~on_board & (np.abs(xy) > [0.4, 0.3]).any(axis=1)
    assert found[: len(xy)][beside].mean() > 0.995
    # Of the board no more is lost than a clearance of 2 cm takes anyway, and some of its rim.
    assert found[: len(xy)][on_board].mean() <= on_floor(points[on_board], plane).mean() + 0.03
    assert not found[len(xy) :].any()


def test_without_points_below_it_a_floor_is_not_taken_to_be_noisy() -> None:
    xy = np.random.default_rng(0).uniform(-1, 1, (20_000, 2))
    plane = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.002, 4.0)
    gravel = np.random.default_rng(1).random(len(xy)) < 0.05
    points = np.column_stack([xy, 0.03 * gravel])
    assert not find_floor_points(points, [plane])[gravel].any()


def test_a_level_reaches_three_centimetres_beyond_its_outline_whatever_the_length_of_its_edges() -> None:
    outline = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.25], [0.0, 0.25]])
    floor = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.005, 1.0, outlines=(outline,))
    beyond = [0.029, 0.031]
    xy = [[4.0 + d, 0.1] for d in beyond] + [[-d, 0.1] for d in beyond]
    xy += [[2.0, 0.25 + d] for d in beyond] + [[2.0, -d] for d in beyond]
    assert on_floor(np.array([[x, y, 0.0] for x, y in xy]), floor).tolist() == [True, False] * 4


def test_what_lies_under_the_border_of_a_sole_is_under_it() -> None:
    floor = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.005, 9.0)
    sole = np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.25, 0.125, 0.0], [0.0, 0.125, 0.0]])
    under = np.array([[0.0, 0.0625], [0.25, 0.0625], [0.125, 0.0], [0.125, 0.125], [0.125, 0.126]])
    assert on_floor(np.column_stack([under, np.full(5, 0.029)]), floor, [sole]).tolist() == [True] * 4 + [False]


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_slab_that_is_seen_from_both_sides_is_one_floor(share: float) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-2.5, 2.5, (20_000, 2))
    z = np.where(rng.random(len(xy)) < share, -0.05, 0.0) + rng.normal(0.0, 0.004, len(xy))
    (floor,) = find_floors(np.column_stack([xy, z]))
    assert abs(floor.offset) < 0.005
    assert floor.slope_deg < 0.3
