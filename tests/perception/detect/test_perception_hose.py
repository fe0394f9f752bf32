"""Hose ends and standpipes: place and radius against the truth, and no sure hit on pipes that run on."""

from __future__ import annotations

import numpy as np
import pytest

from perception import CONFIDENT, Cloud, View, make_view
from perception.detect.hose.detector import detect_hose
from perception.detect.hose.tips import find_tips
from perception.detect.hose.tube import (
    STRAIGHT,
    Tube,
    meet_tube,
    misfit_of,
    refine_tube,
    settle_tube,
    square_to,
    weigh_tube,
)
from perception.detect.shared.slender import is_flat
from perception.sightlines import Sightlines
from perception.simulate import Mesh, Pose, Scanner, box, cylinder, scan
from perception.simulate.scenes import make_scene
from perception.simulate.scenes.fixtures import Standpipe
from perception.simulate.scenes.loose import can, pot

SENSOR = Pose((0.1, 0.0, 1.5), pitch=0.5)
SCANNER = Scanner(n_beams=721, fan_deg=180.0, n_lines=90)


def view_of(*meshes: Mesh, seed: int = 0) -> View:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((1.3, -3.0, 0.0), (1.4, 3.0, 2.5))]
    return make_view(scan([*room, *meshes], SENSOR, SCANNER, seed))


UP_FRONT = Tube(np.array([1.0, 0.0, 1.0]), np.array([-1.0, 0.0, 0.0]), 0.04)


def rays_to(*ends: tuple[float, float, float], start: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Sightlines:
    offset = np.array(ends) - start
    length = np.linalg.norm(offset, axis=1)
    return Sightlines(np.tile(start, (len(ends), 1)), offset / length[:, None], length)


@pytest.mark.parametrize(
    ("mouth", "out", "radius"),
    [
        ((0.7, 0.1, 1.0), (-0.9, 0.43, 0.0), 0.04),
        ((0.65, -0.1, 0.8), (-0.7, 0.0, 0.7), 0.035),
    ],
)
def test_a_standpipe_with_its_coupling_is_found_where_it_opens(
    mouth: tuple[float, float, float], out: tuple[float, float, float], radius: float
) -> None:
    pipe = Standpipe(mouth, out, radius).build()
    found = detect_hose(view_of(*pipe.meshes))
    truth = pipe.truth[0].pose_world_object
    assert found[0].confidence >= CONFIDENT
    assert sum(one.confidence >= CONFIDENT for one in found) == 1
    assert np.linalg.norm(found[0].pose_world_object[:3, 3] - truth[:3, 3]) <= 0.025
    assert found[0].pose_world_object[:3, 2] @ truth[:3, 2] >= np.cos(np.radians(15.0))
    assert abs(found[0].sizes["radius"] - radius) <= 0.008


def test_pipes_that_run_on_posts_tins_pots_boxes_and_closed_ends_are_none_to_act_on() -> None:
    pipes = [
        cylinder((1.0, 0.8, 0.0), (1.0, 0.8, 2.5), 0.04),
        cylinder((1.1, -3.0, 0.6), (1.1, 3.0, 0.6), 0.03),
        cylinder((1.25, -0.5, 1.3), (0.8, -0.5, 1.3), 0.04),
    ]
    board = [box((0.6, -0.6, 0.75), (1.1, 0.6, 0.8)), box((0.9, -1.2, 0.0), (0.96, -1.14, 0.9))]
    things = [
        *can((0.8, 0.3, 0.8)).meshes,
        *pot((0.8, -0.3, 0.8), 0.06).meshes,
        box((0.7, -0.05, 0.8), (0.9, 0.1, 1.1)),
    ]
    assert all(one.confidence < CONFIDENT for one in detect_hose(view_of(*pipes, *board, *things)))


@pytest.mark.parametrize(
    ("name", "seed", "variant"),
    [("empty_rounds", 1, "dense"), ("empty_rounds", 3, "solid"), ("drill_shelf_away", 0, "solid")],
    ids=["a table's corner", "plates in a rack", "a drill's body over its grip"],
)
def test_what_shows_a_wall_on_some_sides_of_a_gap_is_no_opening(name: str, seed: int, variant: str) -> None:
    view = make_view(make_scene(name, seed).scan(variant))
    assert all(one.confidence < CONFIDENT for one in detect_hose(view))


def test_a_wall_is_seen_in_the_directions_in_which_more_rays_end_on_it_than_pass() -> None:
    tube = Tube(np.array([0.8, 0.0, 1.1]), np.array([-0.8, 0.6, 0.0]), 0.04)
    rays, mine = hollow_rays(tube)
    assert weigh_tube(rays, tube).round > 0.9
    # One in four still ends on the upper half: a few strays make no wall.
    gone = mine & (rays.ends[:, 2] > 1.1) & (np.arange(len(mine)) % 4 > 0)
    holed = Sightlines(rays.start, rays.direction, np.where(gone, 3.0, rays.length))
    assert weigh_tube(holed, tube).round < 0.7


def test_rays_meet_a_tube_on_its_wall_in_its_mouth_or_not_at_all() -> None:
    met = meet_tube(rays_to((2.0, 0.0, 1.0), (1.03, 0.0, 1.0), (2.0, 0.2, 1.0), start=(0.0, 0.0, 1.0)), UP_FRONT)
    assert met.into.tolist() == [True, True, False]
    assert met.through.tolist() == [True, True, False]
    assert met.depth[0] == pytest.approx(1.0 + STRAIGHT)
    from_above = meet_tube(rays_to((1.02, 0.0, 0.5), (1.05, 0.0, 0.5), start=(1.02, 0.0, 2.0)), UP_FRONT)
    assert from_above.on.tolist() == [True, True]
    assert from_above.depth[0] == pytest.approx(0.96)
    ahead = meet_tube(rays_to((0.9, 0.0, 0.5), start=(0.9, 0.0, 2.0)), UP_FRONT)
    assert not ahead.on.any()
    assert not ahead.into.any()
    assert ahead.outside[0] == pytest.approx(0.1)
    slanted = meet_tube(rays_to((1.5, 0.0, 0.5), start=(0.5, 0.0, 1.5)), UP_FRONT)
    # It goes in through the middle at 45 degrees and ends where the wall's inside is a radius down.
    assert slanted.into[0]
    assert not slanted.through[0]
    assert slanted.depth[0] == pytest.approx(np.sqrt(2.0) * (0.5 + 0.04))
    assert slanted.across[0] == pytest.approx(0.0, abs=1e-6)


def hollow_rays(tube: Tube, seed: int = 0) -> tuple[Sightlines, np.ndarray]:
    """What a noisy sensor at (0, 0, 1.5) gives of a tube before a wall at x = 2, and which rays ended on the tube."""
    rng = np.random.default_rng(seed)
    start = np.array([0.0, 0.0, 1.5])
    aim = tube.mouth + rng.uniform(-0.12, 0.12, (1500, 3)) - start
    way = aim / np.linalg.norm(aim, axis=1, keepdims=True)
    rays = Sightlines(np.tile(start, (len(way), 1)), way, 2.0 / way[:, 0])
    met = meet_tube(rays, tube)
    mine = (met.on | (met.into & ~met.through)) & (met.along > -STRAIGHT)
    length = np.where(mine, met.depth + rng.normal(0.0, 0.01, len(way)), rays.length)
    seen = (met.outside > 0.0) | mine | met.through
    return Sightlines(rays.start[seen], way[seen], length[seen]), mine[seen]


def test_the_tube_that_made_the_rays_explains_them_best_and_is_found_from_nearby() -> None:
    tube = Tube(np.array([0.8, 0.0, 1.1]), np.array([-0.8, 0.6, 0.0]), 0.04)
    rays, mine = hollow_rays(tube)
    others = [
        Tube(tube.mouth + np.array([0.02, 0.0, 0.0]), tube.axis, 0.04),
        Tube(tube.mouth, np.array([-1.0, 0.0, 0.0]), 0.04),
        Tube(tube.mouth, tube.axis, 0.055),
    ]
    assert all(misfit_of(rays, mine, tube) < misfit_of(rays, mine, other) for other in others)
    axis = np.array([-0.9, 0.4, 0.2]) / np.linalg.norm([-0.9, 0.4, 0.2])
    found = Tube(tube.mouth + np.array([0.01, -0.01, 0.01]), axis, 0.045)
    for _ in range(3):
        found = refine_tube(rays, mine, found)
    assert np.linalg.norm(found.mouth - tube.mouth) <= 0.01
    assert found.axis @ tube.axis >= np.cos(np.radians(10.0))
    assert found.radius == pytest.approx(0.04, abs=0.004)


def test_evidence_tells_an_open_end_from_one_stopped_up() -> None:
    tube = Tube(np.array([0.8, 0.0, 1.1]), np.array([-0.8, 0.6, 0.0]), 0.04)
    rays, _ = hollow_rays(tube)
    assert weigh_tube(rays, tube).open > 0.8
    plane = meet_tube(rays, tube)
    stopped = Sightlines(rays.start, rays.direction, np.where(plane.into, plane.plane, rays.length))
    assert weigh_tube(stopped, tube).open == 0.0


def test_a_rod_ends_at_its_two_tips_and_a_wall_nowhere() -> None:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.0, 2.0 * np.pi, 150)
    rod = np.column_stack([rng.uniform(0.0, 0.6, 150), 0.03 * np.cos(angle), 0.03 * np.sin(angle)])
    along = [tip for tip in find_tips(rod, rod, 0.08) if abs(tip.axis[0]) > 0.9]
    assert {float(np.sign(tip.axis[0])) for tip in along} == {-1.0, 1.0}
    assert all(np.linalg.norm(tip.place - [0.3 + 0.3 * np.sign(tip.axis[0]), 0.0, 0.0]) < 0.05 for tip in along)
    wall = np.column_stack([np.zeros(4000), rng.uniform(-1.0, 1.0, (4000, 2))])
    assert find_tips(wall, wall[np.abs(wall).max(axis=1) < 0.7][::10], 0.08) == []
    assert is_flat(wall).mean() > 0.9
    assert not is_flat(rod).any()


def test_a_hint_elsewhere_leaves_the_opening_out() -> None:
    pipe = Standpipe((0.7, 0.1, 1.0), (-0.9, 0.43, 0.0), 0.04).build()
    assert detect_hose(view_of(*pipe.meshes), hint=np.array([0.9, -1.2, 1.0])) == []


def test_a_view_without_obstacles_holds_no_hose_end() -> None:
    points = np.random.default_rng(0).uniform((-2.0, -2.0, 0.0), (2.0, 2.0, 0.0), (5000, 3))
    assert detect_hose(make_view(Cloud(points, np.array([0.0, 0.0, 1.5])))) == []


def test_an_end_looked_into_is_settled_to_where_its_returns_end() -> None:
    rng = np.random.default_rng(5)
    true = Tube(np.array([0.9, 0.1, 0.8]), np.array([-0.6, 0.0, 0.8]), 0.035)
    across, over = square_to(true.axis)
    angle, depth = rng.uniform(0.0, 2.0 * np.pi, 300), rng.uniform(0.0, 0.12, 300)
    depth[:80] = 0.0
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * over
    places = true.mouth + 0.033 * ring - depth[:, None] * true.axis
    start = true.mouth + 1.1 * true.axis
    length = np.linalg.norm(places - start, axis=1)
    rays = Sightlines(np.tile(start, (300, 1)), (places - start) / length[:, None], length + rng.normal(0, 0.01, 300))
    tilted = true.axis + 0.2 * across
    rough = Tube(true.mouth + 0.02 * true.axis + 0.008 * over, tilted / np.linalg.norm(tilted), 0.032)
    found = settle_tube(rays, rough)
    assert np.linalg.norm(found.mouth - true.mouth) < 0.005
    assert np.degrees(np.arccos(found.axis @ true.axis)) < 3.0
    assert abs(found.radius - true.radius) < 0.003
