"""Which link pairs are left out of the self-collision check."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from robot_files import LIMIT, joint, link, robot, write_urdf

from costs.robot import RobotModel, load_robot
from costs.robot.self_pairs import (
    count_contacts,
    draw_poses,
    find_adjacent_pairs,
    find_same_joint_pairs,
    sort_pair,
)

WIDE = LIMIT.replace('"-1"', '"-3"').replace('upper="1"', 'upper="3"')
BOX = '<box size="0.4 0.1 0.1"/>'


def _rates(model: RobotModel, seed: int, count: int = 200) -> dict[tuple[str, str], float]:
    """Share of random poses in which each pair of links overlaps."""
    links = sorted({body.link for body in model.bodies})
    poses = draw_poses(model.model, model.lower, model.upper, count, seed)
    counts = count_contacts(model.model, model.bodies, [sort_pair(a, b) for a, b in combinations(links, 2)], poses)
    return {pair: hits / count for pair, hits in counts.items()}


def _near(model: RobotModel) -> frozenset[tuple[str, str]]:
    return find_same_joint_pairs(model.bodies) | find_adjacent_pairs(model.model, model.bodies)


def test_neighbours_are_ignored_also_across_links_without_a_body(tmp_path: Path) -> None:
    text = robot(
        link("base", BOX), link("hub"), link("arm", BOX), link("tip", BOX), link("cap", BOX),
        joint("j1", "base", "hub"), joint("j2", "hub", "arm"), joint("j3", "arm", "tip"),
        joint("weld", "tip", "cap", "fixed", "", "0 0 5"),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    # "cap" is welded to "tip", 5 m from the joint between "tip" and "arm": it may meet "arm".
    assert model.ignored_pairs == {("arm", "base"), ("arm", "tip"), ("cap", "tip")}
    assert model.ignored_reasons == {
        ("arm", "base"): "adjacent",
        ("arm", "tip"): "adjacent",
        ("cap", "tip"): "adjacent",
    }


def test_what_is_welded_to_a_neighbour_near_the_joint_is_a_neighbour_too(tmp_path: Path) -> None:
    text = robot(
        link("base", BOX), link("arm", BOX), link("tip", BOX), link("cap", BOX),
        joint("j1", "base", "arm"), joint("j2", "arm", "tip"), joint("weld", "tip", "cap", "fixed", "", "0 0 0.02"),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    assert ("arm", "cap") in model.ignored_pairs


def test_what_is_fixed_to_the_world_is_a_neighbour_of_nothing_but_what_it_carries(tmp_path: Path) -> None:
    text = robot(
        link("base", BOX), link("post", BOX), link("arm", BOX),
        joint("weld", "base", "post", "fixed", "", "0 0 0.1"), joint("j1", "base", "arm", xyz="0 0 0.1"),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    assert ("arm", "base") in model.ignored_pairs
    assert ("arm", "post") in model.ignored_pairs  # they overlap however the arm turns
    assert model.ignored_reasons["arm", "post"] == "derived"
    apart = robot(
        link("base", BOX), link("post", BOX), link("arm", BOX),
        joint("weld", "base", "post", "fixed", "", "0 0.2 0"), joint("j1", "base", "arm", inside=WIDE, xyz="0 0 0"),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, apart))
    assert model.ignored_pairs == {("arm", "base"), ("base", "post")}


def test_pair_that_always_overlaps_is_ignored_and_one_that_does_at_zero_only_is_not(tmp_path: Path) -> None:
    shifted = '<collision><origin xyz="2 0 0"/><geometry><box size="0.4 0.1 0.1"/></geometry></collision>'
    text = robot(
        link("base", BOX), link("mid", BOX), link("spin", BOX), f'<link name="far">{shifted}</link>',
        '<link name="post"><collision><origin xyz="2 0 0"/><geometry><box size="0.4 0.1 0.1"/></geometry>'
        "</collision></link>",
        joint("j1", "base", "mid", inside=WIDE, xyz="0 0 0"), joint("j2", "mid", "spin", inside=WIDE, xyz="0 0 0"),
        joint("j3", "mid", "far", inside=WIDE, xyz="0 0 0"), joint("weld", "base", "post", "fixed", "", "0 0 0"),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    assert ("base", "spin") in model.ignored_pairs  # both turn about one axis that runs through them
    assert _rates(model, 3)[("far", "post")] > 0.0
    assert ("far", "post") not in model.ignored_pairs  # they overlap at the zero pose, but can part


def test_pair_that_overlaps_in_most_poses_stays_checked(tmp_path: Path) -> None:
    slide = '<axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/>'
    arm = joint("j2", "mid", "arm", "prismatic", slide, "0 0 -9").replace('<axis xyz="0 0 1"/>', "", 1)
    text = robot(link("base", '<box size="1 1 1"/>'), link("mid", BOX), link("arm", '<box size="0.7 0.1 0.1"/>'),
                 joint("j1", "base", "mid", xyz="0 0 9", inside=LIMIT.replace("1", "0.01")), arm)  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text))
    assert 0.75 < _rates(model, 3)[("arm", "base")] < 0.92  # they part when the arm slides out by 0.85 of 1 m
    assert ("arm", "base") not in model.ignored_pairs


def test_pairs_of_an_srdf_are_taken_as_they_stand(tmp_path: Path) -> None:
    text = robot(
        link("a", BOX), link("b", BOX), link("c", BOX), link("d", BOX),
        joint("j1", "a", "b"), joint("j2", "b", "c"), joint("w", "c", "d", "fixed", ""),
    )  # fmt: skip
    srdf = tmp_path / "robot.srdf"
    srdf.write_text('<robot name="sample"><disable_collisions link1="c" link2="a" reason="User"/></robot>')
    model = load_robot(urdf=write_urdf(tmp_path, text), srdf=srdf)
    assert model.ignored_pairs == {("a", "c"), ("c", "d")}
    assert model.ignored_reasons == {("a", "c"): "srdf (User)", ("c", "d"): "same joint"}


@pytest.mark.parametrize("which", ["atlas", "panda", "drcsim"])
def test_ignored_pairs_are_neighbours_or_nearly_always_overlap(which: str, request: pytest.FixtureRequest) -> None:
    if which == "atlas":
        model = load_robot("atlas")
    else:
        robots = request.getfixturevalue("shared_data") / "robots"
        folder = robots / ("panda" if which == "panda" else "atlas_drcsim_v5_simple")
        model = load_robot(urdf=next(folder.glob("*.urdf")), root="fixed" if which == "panda" else "floating")
    rates = _rates(model, seed=7)
    near = _near(model)
    assert near <= model.ignored_pairs
    for pair in model.ignored_pairs - near:
        assert rates[pair] > 0.92, pair
    # A pair that overlaps now and then stays checked.
    assert all(pair not in model.ignored_pairs for pair, rate in rates.items() if rate < 0.9 and pair not in near)
    assert any(0.0 < rate < 0.9 for pair, rate in rates.items() if pair not in near)


def test_atlas_checks_every_pair_but_its_neighbours() -> None:
    atlas = load_robot("atlas")
    # Pelvis and middle torso overlap in every pose around the lower torso, which is inside both.
    assert atlas.ignored_pairs == _near(atlas) | {("mtorso", "pelvis")}
    links = {body.link for body in atlas.bodies}
    assert len(links) * (len(links) - 1) // 2 - len(atlas.ignored_pairs) == 402


def test_sampled_poses_lie_within_the_limits_and_turn_unbounded_joints(tmp_path: Path) -> None:
    text = robot(
        link("a"), link("b"), link("c"), joint("j1", "a", "b"),
        joint("j2", "b", "c", "continuous", '<limit velocity="1" effort="1"/>'),
    )  # fmt: skip
    model = load_robot(urdf=write_urdf(tmp_path, text), root="floating")
    poses = draw_poses(model.model, model.lower, model.upper, 500)
    assert np.all(poses[:, :6] == 0.0)
    assert np.abs(poses[:, 6]).max() <= 1.0
    assert 3.0 < np.abs(poses[:, 7]).max() <= np.pi
