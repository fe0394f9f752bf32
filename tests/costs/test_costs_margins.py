"""Which pairs are asked to keep what distance: allowances, overrides, exempt links, relaxed margins."""

import numpy as np
import pytest
from convex_distance import box
from swept_scenes import checker_of, state_of
from tiny_robots import Segment, atlas, atlas_with_wheel, chain

from costs.allowance import Allowance, BodyRef
from costs.collision import PairMargins, SweptCollisionChecker
from costs.kinematics import KinematicsEngine
from costs.scene import ConvexPiece, Scene

LINK, PIECE = BodyRef.of_link, BodyRef.of_piece
RIM = ("valve/rim/0", "valve/rim/1")
SCENE = Scene(
    tuple(
        ConvexPiece(name, box(centre, [0.1, 0.1, 0.1]))
        for name, centre in (
            ("valve/rim/0", [2, 0, 0]),
            ("valve/rim/1", [3, 0, 0]),
            ("valve/stem", [4, 0, 0]),
            ("floor", [5, 0, 0]),
        )
    )
)


def body_index(robot, name):
    return [body.name for body in robot.bodies].index(name)


def own_margin(robot, margins, a, b):
    wanted = {body_index(robot, a), body_index(robot, b)}
    (row,) = [k for k, pair in enumerate(margins.self_pairs.tolist()) if set(pair) == wanted]
    return margins.own[row]


def test_all_pairs_are_asked_for_the_margin():
    margins = PairMargins.of(atlas(), SCENE, 0.03)
    assert margins.world.shape == (len(atlas().bodies), 4)
    assert (margins.world == 0.03).all()
    assert (margins.own == 0.03).all()
    assert (PairMargins.of(atlas(), SCENE, 0.03, self_margin=0.01).own == 0.01).all()


def test_an_allowance_asks_for_no_more_than_its_depth_of_its_pairs_only():
    robot = atlas()
    margins = PairMargins.of(robot, SCENE, 0.03, [Allowance(LINK("l_hand"), PIECE(rim), 0.005) for rim in RIM])
    hand = body_index(robot, "l_hand")
    np.testing.assert_array_equal(margins.world[hand], [-0.005, -0.005, 0.03, 0.03])
    others = np.delete(margins.world, hand, axis=0)
    assert (others == 0.03).all()
    assert (margins.own == 0.03).all()


def test_an_allowance_by_link_covers_all_its_bodies_and_one_by_body_only_that():
    robot = atlas()
    bodies = [k for k, body in enumerate(robot.bodies) if body.link == "utorso"]
    assert len(bodies) == 3
    by_link = PairMargins.of(robot, SCENE, 0.03, [Allowance(LINK("utorso"), PIECE("floor"), 0.0)])
    np.testing.assert_array_equal(by_link.world[bodies, 3], [0.0, 0.0, 0.0])
    second = BodyRef("robot", "utorso", "utorso/1")
    by_body = PairMargins.of(robot, SCENE, 0.03, [Allowance(second, PIECE("floor"), 0.0)])
    np.testing.assert_array_equal(by_body.world[bodies, 3], [0.03, 0.0, 0.03])


@pytest.mark.parametrize("names", [("l_hand", "r_hand"), ("r_hand", "l_hand")])
def test_links_may_be_allowed_to_touch_in_either_order(names):
    robot = atlas()
    margins = PairMargins.of(robot, SCENE, 0.03, [Allowance(*map(LINK, names), 0.002)])
    assert own_margin(robot, margins, "l_hand", "r_hand") == -0.002
    assert (margins.own != 0.03).sum() == 1


def test_overrides_set_single_margins_and_allowances_win_over_them():
    robot = atlas()
    head, hand, floor = LINK("head"), LINK("l_hand"), PIECE("floor")
    overrides = [*((head, PIECE(rim), 0.2) for rim in RIM), (hand, floor, 0.1), (hand, head, 0.05)]
    margins = PairMargins.of(robot, SCENE, 0.03, [Allowance(hand, floor, 0.01)], overrides)
    np.testing.assert_array_equal(margins.world[body_index(robot, "head")], [0.2, 0.2, 0.03, 0.03])
    np.testing.assert_array_equal(margins.world[body_index(robot, "l_hand")], [0.03, 0.03, 0.03, -0.01])
    assert own_margin(robot, margins, "l_hand", "head") == 0.05


def test_links_of_a_mechanism_meet_the_robot_but_not_the_scene():
    robot = atlas_with_wheel()
    margins = PairMargins.of(robot, SCENE, 0.03)
    rim = body_index(robot, "valve/rim")
    assert (margins.world[rim] == -np.inf).all()
    assert np.isfinite(np.delete(margins.world, rim, axis=0)).all()
    assert own_margin(robot, margins, "l_hand", "valve/rim") == 0.03


BASED = (Segment((1.0, 0.0, 0.0), size=(0.2, 0.2, 0.2), kind="prismatic"),)


def test_links_that_no_joint_moves_are_not_checked_against_the_scene(tmp_path):
    from costs.robot import load_robot

    solid = '<link name="{}"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>'
    urdf = tmp_path / "post.urdf"
    urdf.write_text(
        f'<robot name="post">{solid.format("base")}{solid.format("arm")}<joint name="slide" type="prismatic">'
        '<parent link="base"/><child link="arm"/><origin xyz="1 0 0"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>'
    )
    robot = load_robot(urdf=urdf)
    around = Scene((ConvexPiece("around", box([0.0, 0.0, 0.0], [3.0, 3.0, 3.0])),))
    margins = PairMargins.of(robot, around, 0.03)
    np.testing.assert_array_equal(margins.world[:, 0], [-np.inf, 0.03])
    contacts = state_of(robot, SweptCollisionChecker(robot, around, margins))(np.zeros((1, 1))).contacts
    np.testing.assert_array_equal(contacts.body, [1])


def test_relaxed_margins_are_what_a_fixed_configuration_leaves():
    robot = chain(BASED)  # a cube from q to q + 0.2
    walls = Scene(
        (
            ConvexPiece("near", box([0.5, 0.0, 0.0], [0.1, 1.0, 1.0])),  # from 0.45
            ConvexPiece("far", box([-0.5, 0.0, 0.0], [0.1, 1.0, 1.0])),  # to -0.45
        )
    )
    checker = checker_of(robot, walls, 0.03)
    engine = KinematicsEngine(robot)
    relaxed = checker.margins.relax_to(checker(engine(np.array([[0.24]]))), reserve=0.002)
    np.testing.assert_allclose(relaxed.world[0], [0.008, 0.03], atol=1e-9)  # 1 cm away, less the reserve
    np.testing.assert_allclose(checker.margins.world[0], [0.03, 0.03])  # the old margins stand
    inside = checker.margins.relax_to(checker(engine(np.array([[0.26]]))), reserve=0.0)
    np.testing.assert_allclose(inside.world[0, 0], -0.01, atol=1e-9)
    contacts = checker.with_margins(relaxed)(engine(np.array([[0.24]])))
    np.testing.assert_allclose(contacts.margin - contacts.distance, [-0.002], atol=1e-9)


def test_a_pair_that_may_touch_gives_way_no_farther_than_its_own_reserve():
    robot = chain(BASED)  # a cube from q to q + 0.2
    wall = Scene((ConvexPiece("near", box([0.5, 0.0, 0.0], [0.1, 1.0, 1.0])),))  # from 0.45
    margins = PairMargins.of(
        robot, wall, 0.03, [Allowance(BodyRef.of_link(robot.bodies[0].link), BodyRef.of_piece("near"), 0.004)]
    )
    checker = SweptCollisionChecker(robot, wall, margins)
    deep = checker(KinematicsEngine(robot)(np.array([[0.255]])))  # 5 mm inside, 4 mm are allowed
    np.testing.assert_allclose(margins.relax_to(deep, 0.002).world[0, 0], -0.007, atol=1e-9)
    np.testing.assert_allclose(margins.relax_to(deep, 0.002, -0.001).world[0, 0], -0.004, atol=1e-9)
    deeper = checker(KinematicsEngine(robot)(np.array([[0.26]])))
    np.testing.assert_allclose(margins.relax_to(deeper, 0.002, -0.001).world[0, 0], -0.009, atol=1e-9)


def test_relaxed_margins_of_links_are_found_whichever_of_them_sweeps():
    robot = atlas()
    checker = checker_of(robot, Scene(), 0.5)
    contacts = checker(KinematicsEngine(robot)(robot.postures["stand"][None]))
    assert (contacts.body > contacts.other).any()
    assert (contacts.body < contacts.other).any()
    relaxed = checker.margins.relax_to(contacts, reserve=0.001)
    for body, other, distance in zip(contacts.body, contacts.other, contacts.distance, strict=True):
        asked = own_margin(robot, relaxed, robot.bodies[body].name, robot.bodies[other].name)
        assert asked == pytest.approx(min(0.5, distance - 0.001))


def test_margins_of_other_pairs_are_refused():
    checker = checker_of(atlas(), SCENE, 0.03)
    with pytest.raises(ValueError, match="own pairs"):
        checker.with_margins(PairMargins.of(atlas_with_wheel(), SCENE, 0.03))


@pytest.mark.parametrize("depth", [-0.01, np.inf, np.nan])
def test_an_allowance_states_its_depth(depth):
    with pytest.raises(ValueError, match="depth must be finite and not negative"):
        Allowance(LINK("l_hand"), PIECE("floor"), depth)
