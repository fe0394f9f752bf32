"""A new scan of a scene seen before: what did not change stays the very same piece; memory of whole results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from half_spaces import half_spaces

from costs.scene import ConvexPiece
from perception import CONFIDENT, Cloud, Evidence, Perceived, Piece, Reach, perceive, select_wheels
from perception.cleaning.locally import LocalJudge
from perception.cleaning.outliers import surface_points
from perception.convex.freespace import Crossing
from perception.convex.hulls import make_hull
from perception.convex.updated import update_pieces
from perception.ground.floor import FloorPlane
from perception.ground.levels_again import are_there, may_be_level
from perception.memory import Memory, content_key
from perception.simulate import Pose, Room, Scanner, Valve, scan
from perception.updated import update

SENSOR = Pose((0.1, 0.0, 1.6), pitch=0.3)
SCANNER = Scanner(n_lines=60)


def scanned(seed: int, moved: float | None = 0.0, valve: bool = False, board: float = 0.0) -> Cloud:
    """A room with a table, a pipe and a box that was moved so far, or taken away; a board so thick on the table."""
    boxes: list[tuple[tuple[float, float, float], tuple[float, float, float]]]
    boxes = [((0.6, -1.1, 0.0), (0.9, -0.7, 0.5)), ((0.9, -0.2, 0.7), (1.2, 0.3, 0.75))]
    if moved is not None:
        boxes.append(((0.2 + moved, 1.2, 0.0), (0.7 + moved, 1.7, 0.9)))
    if board:
        boxes.append(((0.95, -0.1, 0.75), (1.15, 0.15, 0.75 + board)))
    room = Room(wall_x=1.4, pipes=((1.1, 0.7, 0.05),), boxes=tuple(boxes))
    parts = [*room.meshes(), *(Valve((0.8, 0.1, 1.1)).meshes() if valve else ())]
    return scan(parts, SENSOR, SCANNER, seed=seed)


def inside(points: np.ndarray, pieces: tuple[ConvexPiece, ...], margin: float = 0.0) -> np.ndarray:
    mask = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        faces = half_spaces(piece.vertices)
        mask |= (points @ faces[:, :3].T + faces[:, 3] <= margin).all(axis=1)
    return mask


def meets(piece: ConvexPiece, lower: tuple[float, ...], upper: tuple[float, ...]) -> bool:
    return bool((piece.lower <= np.array(upper)).all() and (piece.upper >= np.array(lower)).all())


def is_a_few_points(piece: ConvexPiece) -> bool:
    """Whether noise may bring or take it: points at the edge of a pipe, say, that rays may pass the next time."""
    return bool(np.ptp(piece.vertices, axis=0).max() <= 0.1)


@pytest.fixture(scope="module")
def before() -> Perceived:
    return perceive(scanned(1))


def test_a_second_scan_of_the_same_scene_keeps_every_piece(before: Perceived) -> None:
    for seed in (2, 3):
        again = update(before, scanned(seed))
        kept = {id(piece) for piece in again.scene.pieces}
        assert [piece.name for piece in before.scene.pieces if id(piece) not in kept] == []
        # What is new is noise of a few points, if anything.
        new = again.scene.pieces[len(before.scene.pieces) :]
        assert len(new) <= 1
        assert all(np.ptp(piece.vertices, axis=0).max() < 0.15 for piece in new)


def test_the_very_same_scan_changes_nothing(before: Perceived) -> None:
    again = update(before, scanned(1))
    assert len(again.scene.pieces) == len(before.scene.pieces)
    assert all(one is other for one, other in zip(again.scene.pieces, before.scene.pieces, strict=True))


def test_only_the_pieces_of_a_box_that_moved_are_new(before: Perceived) -> None:
    after = update(before, scanned(4, moved=0.35))
    old = {id(piece) for piece in before.scene.pieces}
    kept = {id(piece) for piece in after.scene.pieces} & old
    lower, upper = (0.1, 1.1, 0.0), (1.15, 1.8, 1.0)
    for piece in before.scene.pieces:
        if piece.kind != "floor" and not meets(piece, lower, upper) and not is_a_few_points(piece):
            assert id(piece) in kept, piece.name
    new = [piece for piece in after.scene.pieces if id(piece) not in old and not is_a_few_points(piece)]
    assert new
    assert all(meets(piece, lower, upper) for piece in new)


def test_a_box_that_moved_leaves_free_space_and_is_covered_where_it_is(before: Perceived) -> None:
    cloud = scanned(4, moved=0.35)
    after = update(before, cloud)
    rng = np.random.default_rng(0)
    pieces = tuple(piece for piece in after.scene.pieces if piece.kind != "floor")
    front = np.column_stack([rng.uniform(0.22, 0.45, 200), np.full(200, 1.2), rng.uniform(0.1, 0.85, 200)])
    assert inside(front, before.scene.pieces, 0.01).mean() > 0.99
    assert not inside(front, pieces).any()
    moved = front + np.array([0.45, 0.0, 0.0])
    assert inside(moved, pieces, 0.01).mean() > 0.99
    assert inside(after.view.obstacles, after.scene.pieces, 0.02).mean() > 0.99


def test_a_box_that_was_taken_away_is_gone(before: Perceived) -> None:
    after = update(before, scanned(5, moved=None))
    assert not any(meets(piece, (0.25, 1.25, 0.1), (0.65, 1.65, 0.8)) for piece in after.scene.pieces)


@pytest.mark.parametrize("thickness", [0.03, 0.035])
def test_what_is_as_thin_as_the_noise_of_points_is_new(before: Perceived, thickness: float) -> None:
    after = update(before, scanned(5, board=thickness))
    rng = np.random.default_rng(0)
    top = np.column_stack([rng.uniform(0.97, 1.13, 200), rng.uniform(-0.08, 0.13, 200), np.full(200, 0.75 + thickness)])
    assert inside(top, before.scene.pieces, 0.01).mean() < 0.1
    assert inside(top, after.scene.pieces, 0.01).mean() > 0.95


@pytest.mark.parametrize("height", [0.588, 0.592, 0.596, 0.6])
@pytest.mark.parametrize("thickness", [0.022, 0.025, 0.03])
def test_a_plate_that_rays_go_through_is_gone_wherever_it_lies_between_cells(height: float, thickness: float) -> None:
    corners = np.array(list(np.ndindex(2, 2, 2))) * (0.4, 0.4, thickness) + (0.8, -0.2, height)
    shape = ConvexPiece("clutter/0", corners, "clutter")
    plate = Piece(shape, np.arange(0), Evidence(0, 0.0, 0.5), make_hull(corners).simplified)
    ends = np.stack(np.meshgrid(np.arange(0.6, 1.6, 0.02), np.arange(-0.5, 0.5, 0.02), [0.0]), axis=-1).reshape(-1, 3)
    through = np.array([0.0, 0.0, 1.6]), ends
    assert not update_pieces([plate], np.zeros((0, 3)), np.zeros((0, 3)), through).pieces
    assert update_pieces([plate], np.zeros((0, 3)), np.zeros((0, 3)), (through[0], ends[:0])).pieces


def test_a_piece_goes_when_only_mixed_pixels_hide_that_rays_went_through_it() -> None:
    corners = np.array(list(np.ndindex(2, 2, 2))) * 0.3 + (0.8, -0.15, 0.5)
    shape = ConvexPiece("clutter/0", corners, "clutter")
    body = Piece(shape, np.arange(0), Evidence(0, 0.0, 0.5), make_hull(corners).simplified)
    ends = np.stack(np.meshgrid(np.arange(1.0, 2.4, 0.02), np.arange(-0.5, 0.5, 0.02), [0.0]), axis=-1).reshape(-1, 3)
    start, inner = np.array([0.0, 0.0, 1.6]), np.stack(np.meshgrid(*[np.arange(0.01, 0.3, 0.02)] * 3), axis=-1)
    pixels = inner.reshape(-1, 3) + corners[0]
    starts = np.broadcast_to(start, pixels.shape)
    for is_surface in (False, True):
        judge = lambda asked, told=is_surface: np.full(len(asked), told)  # noqa: E731
        made = update_pieces([body], pixels, starts, (start, ends), judge=judge)
        assert [piece.name for piece in made.pieces] == ["clutter/0"] * is_surface


def test_it_is_left_off_where_what_is_new_asks_for_something_else_first() -> None:
    points = flat(0.3, 0.03)
    starts = np.broadcast_to(np.array([0.0, 0.0, 1.6]), points.shape)
    asked = []
    made = update_pieces([], points, starts, (starts, points), is_enough=lambda new: not asked.append(len(new)))
    assert asked == [len(points)]
    assert made.is_left_off
    assert not made.pieces
    whole = update_pieces([], points, starts, (starts, points))
    assert whole.pieces
    assert not whole.is_left_off


def boxes_only(seed: int, *corners: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Cloud:
    """Boxes on a floor, nothing behind them."""
    return scan(Room(wall_x=None, boxes=corners).meshes(), SENSOR, SCANNER, seed=seed, misses=True)


def standing(perceived: Perceived) -> list[ConvexPiece]:
    """All pieces but the floor's."""
    return [piece.shape for piece in perceived.pieces]


RIGHT = ((0.8, -1.3, 0.0), (1.2, -0.9, 0.6))
LEFT = ((0.8, 1.2, 0.0), (1.2, 1.6, 0.8))


def test_the_outermost_thing_is_gone_once_rays_pass_where_it_was() -> None:
    seen = perceive(boxes_only(1, RIGHT, LEFT))
    after = update(seen, boxes_only(2, RIGHT))
    assert any(meets(piece, *LEFT) for piece in standing(seen))
    assert not any(meets(piece, *LEFT) for piece in standing(after))
    kept = {id(piece) for piece in standing(after)}
    assert all(id(piece) in kept for piece in standing(seen) if meets(piece, *RIGHT))


def test_a_scan_without_obstacles_leaves_what_it_cannot_see() -> None:
    seen = perceive(boxes_only(1, RIGHT, LEFT))
    empty = boxes_only(2)
    right = empty.select(empty.points[:, 1] < 0.0)
    half = replace(right, misses=right.misses[right.misses[:, 1] < 0.0])
    after = update(seen, half)
    assert not any(meets(piece, *RIGHT) for piece in standing(after))
    assert any(meets(piece, *LEFT) for piece in standing(after))
    assert not update(seen, empty).pieces


def test_new_pieces_take_names_that_were_never_taken(before: Perceived) -> None:
    after = update(before, scanned(4, moved=0.35))
    old = {id(piece) for piece in before.scene.pieces}
    names = {piece.name for piece in before.scene.pieces}
    assert not names & {piece.name for piece in after.scene.pieces if id(piece) not in old}
    back = update(after, scanned(6))
    assert len({piece.name for piece in back.scene.pieces}) == len(back.scene.pieces)


def test_a_piece_that_the_new_scan_cannot_see_stays(before: Perceived) -> None:
    full = scanned(2)
    # Half of the directions are gone: nothing is known of what lies there.
    half = full.select(full.points[:, 1] < 0.9)
    after = update(before, half)
    kept = {id(piece) for piece in after.scene.pieces}
    beyond = [piece for piece in before.scene.pieces if piece.lower[1] > 1.0]
    assert beyond
    assert all(id(piece) in kept for piece in beyond)


def test_the_points_of_updated_pieces_are_those_of_the_new_view(before: Perceived) -> None:
    after = update(before, scanned(4, moved=0.35))
    for piece in after.pieces:
        faces = half_spaces(piece.shape.vertices)
        points = after.view.obstacles[piece.points]
        assert (points @ faces[:, :3].T + faces[:, 3]).max(initial=0.0) <= 0.01 + 1e-6


def test_a_valve_stays_found_and_out_of_the_pieces() -> None:
    seen = perceive(scanned(1, valve=True), kinds=("wheel",))
    (wheel,) = select_wheels(seen.detections)
    assert wheel.confidence >= CONFIDENT
    again = update(seen, scanned(2, valve=True))
    assert again.detections is seen.detections
    rim = wheel.centre + np.array([0.0, 0.12, 0.0])
    assert not inside(rim[None], again.scene.pieces).any()
    assert {piece.name for piece in again.scene.pieces} >= {"stem"}


def test_unknown_space_is_made_anew_when_it_was_asked_for() -> None:
    reach = Reach(radius=2.0, top=2.0)
    seen = perceive(scanned(1), reach=reach, unknown="occupied")
    after = update(seen, scanned(5, moved=None))
    hidden = np.array([[0.45, 1.5, 0.4]])
    assert inside(hidden, tuple(p for p in seen.scene.pieces if p.kind == "unknown")).all()
    assert not inside(hidden, tuple(p for p in after.scene.pieces if p.kind == "unknown")).any()


def small(seed: int = 0) -> Cloud:
    return Cloud(np.random.default_rng(seed).uniform(0.5, 0.8, (200, 3)), np.zeros(3))


def test_the_same_cloud_is_perceived_once() -> None:
    memory = Memory()
    first = memory.perceive(small())
    copy = Cloud(small().points.copy(), np.zeros(3))
    assert memory.perceive(copy) is first
    assert len(memory) == 1


def test_another_point_or_setting_is_another_key() -> None:
    cloud = small()
    moved = replace(cloud, points=cloud.points + np.array([0.0, 0.0, 1e-9]))
    keys = {
        content_key(cloud, {"seed": 0}), content_key(cloud, {"seed": 1}), content_key(cloud, {}),
        content_key(moved, {"seed": 0}), content_key(replace(cloud, misses=np.ones((1, 3))), {"seed": 0}),
        content_key(cloud, {"reach": Reach(radius=2.0)}), content_key(cloud, {"reach": Reach(radius=3.0)}),
        content_key(cloud, {"soles": [np.zeros((4, 3))]}), content_key(cloud, {"robot_hulls": [np.zeros((4, 3))]}),
        content_key(cloud, {"soles": [np.zeros((2, 3)), np.zeros((2, 3))]}),
    }  # fmt: skip
    assert len(keys) == 10


def test_memory_forgets_what_was_used_least_recently() -> None:
    one = Memory()
    one.perceive(small(0))
    memory = Memory(most_bytes=int(2.5 * one.n_bytes))
    first, second = (memory.perceive(small(seed)) for seed in (0, 1))
    assert memory.perceive(small(0)) is first
    memory.perceive(small(2))
    assert len(memory) == 2
    assert memory.n_bytes <= memory.most_bytes
    assert memory.perceive(small(0)) is first
    assert memory.perceive(small(1)) is not second


def test_a_result_too_large_to_remember_is_still_given() -> None:
    memory = Memory(most_bytes=10)
    assert memory.perceive(small()).pieces
    assert len(memory) == 0


def test_the_floor_stays_the_very_same_planes(before: Perceived) -> None:
    after = update(before, scanned(2))
    assert before.view.floors
    assert after.view.floors is before.view.floors


def test_a_platform_put_there_becomes_a_level_of_the_floor() -> None:
    seen = perceive(boxes_only(1, RIGHT))
    after = update(seen, boxes_only(2, RIGHT, ((0.8, -0.6, 0.0), (1.7, 0.6, 0.2))))
    assert len(seen.view.floors) == 1
    heights = [float(floor.height(np.array([[1.2, 0.0]]))[0]) for floor in after.view.floors]
    assert any(abs(height - 0.2) < 0.01 for height in heights)


def test_a_platform_in_place_of_a_box_becomes_a_level_of_the_floor() -> None:
    lower, upper = (0.8, -0.6, 0.0), (1.7, 0.6, 0.6)
    seen = perceive(boxes_only(1, (lower, upper)))
    after = update(seen, boxes_only(2, (lower, (*upper[:2], 0.2))))
    assert len(seen.view.floors) == 1
    assert any(abs(floor.offset - 0.2) < 0.01 for floor in after.view.floors)


def flat(height: float, step: float) -> np.ndarray:
    """Points in rows on 0.8 m x 0.8 m."""
    return np.stack(np.meshgrid(np.arange(1.0, 1.8, step), np.arange(0.0, 0.8, step), [height]), -1).reshape(-1, 3)


def floor_seen(share: float, height: float, tilt: float = 0.0) -> bool:
    """Whether a level of 4 m^2 at zero height is there where a scan saw a share of it so high and tilted."""
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(0.0, 2.0 * share, 4000), rng.uniform(-1.0, 1.0, 4000), np.zeros(4000)])
    points[:, 2] = height + tilt * points[:, 0] + rng.normal(0.0, 0.004, 4000)
    level = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.004, 4.0)
    return are_there((level,), points, (np.broadcast_to([0.0, 0.0, 1.6], points.shape), points), Reach())


def test_the_floor_is_there_where_it_was_however_little_of_it_is_seen() -> None:
    assert floor_seen(1.0, 0.0)
    assert floor_seen(0.2, 0.0)


def test_a_floor_that_sank_or_rose_is_not_where_it_was() -> None:
    for share in (0.2, 1.0):
        for height in (-0.2, -0.05, -0.02, 0.012):
            assert not floor_seen(share, height), (share, height)
    assert not floor_seen(1.0, 0.005)


def test_a_small_level_that_noise_tilts_is_where_it_was() -> None:
    rng = np.random.default_rng(6)
    ground = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.004, 4.0)
    corners = np.array([[1.0, 0.0], [1.4, 0.0], [1.4, 0.5], [1.0, 0.5]])
    tread = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.2, 0.01, 0.2, (corners,))
    low = np.column_stack([rng.uniform(-1.0, 1.0, (4000, 2)), rng.normal(0.0, 0.004, 4000)])
    for tilt, is_there in ((0.02, True), (0.08, False)):
        high = np.column_stack([rng.uniform(corners[0], corners[2], (400, 2)), rng.normal(0.2, 0.004, 400)])
        high[:, 2] += tilt * (high[:, 0] - 1.2)
        points = np.concatenate([low, high])
        rays = np.broadcast_to([0.0, 0.0, 1.6], points.shape), points
        assert are_there((ground, tread), points, rays, Reach()) is is_there


def test_what_is_flat_and_low_may_be_a_level_unless_the_floor_is_seen_under_it() -> None:
    floor = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.005, 4.0)
    tail = flat(0.025, 0.03)
    assert may_be_level(tail, [floor], tail[:0])
    assert may_be_level(tail, [floor], flat(0.0, 0.02) + np.array([0.9, 0.0, 0.0]))
    assert not may_be_level(tail, [floor], flat(0.0, 0.02))
    assert not may_be_level(flat(0.6, 0.03), [floor], tail[:0])


def test_what_an_earlier_piece_stands_for_is_no_new_level() -> None:
    floor = FloorPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.005, 4.0)
    low = make_hull(np.array(list(np.ndindex(2, 2, 2))) * (0.8, 0.8, 0.3) + (1.0, 0.0, 0.0))
    assert may_be_level(flat(0.3, 0.03), [floor], np.zeros((0, 3)))
    assert not may_be_level(flat(0.3, 0.03), [floor], np.zeros((0, 3)), [low])


def test_noise_above_the_floor_is_no_new_piece() -> None:
    cloud = boxes_only(1, RIGHT)
    seen = perceive(cloud)
    rng = np.random.default_rng(0)
    low = boxes_only(2, RIGHT)
    noisy = low.points.copy()
    noisy[:, 2] += np.where(noisy[:, 2] < 0.03, rng.normal(0.0, 0.008, len(noisy)), 0.0)
    after = update(seen, replace(low, points=noisy))
    old = {id(piece) for piece in standing(seen)}
    assert sum(id(piece) not in old for piece in standing(after)) <= 1


def test_points_asked_about_are_judged_as_when_all_are() -> None:
    cloud = scanned(3)
    candidates = cloud.points[:, 2] > 0.03
    whole = surface_points(cloud.points, cloud.starts, candidates)
    strays = np.flatnonzero(candidates & ~whole)
    chosen = np.random.default_rng(0).choice(np.flatnonzero(whole), 300, replace=False)
    asked = np.sort(np.concatenate([strays, chosen]))
    told = LocalJudge.of(cloud.points, cloud.starts, candidates).surface_among(asked)
    assert (told == whole[asked]).mean() > 0.95


def test_cells_in_boxes_are_told_as_when_all_are() -> None:
    cloud = scanned(3)
    lower, upper = np.array([0.0, -1.5, 0.0]), np.array([1.5, 1.8, 2.0])
    crossing = Crossing.of(cloud.starts, cloud.points, lower, upper, 0.02)
    whole = crossing.mark_free(cloud.points)
    box = np.array([[[0.6, -0.4, 0.5], [1.1, 0.4, 1.0]]])
    some = crossing.mark_free(cloud.points, box)
    first, last = np.rint((box[0] - lower) / 0.02).astype(int)
    within = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
    assert whole.free[within].any()
    np.testing.assert_array_equal(some.free[within], whole.free[within])
    assert some.free.sum() < whole.free.sum()
