"""Random errors of the physics: repeatable, of the stated size, and none below the robot's first pose."""

from dataclasses import replace

import numpy as np
import pytest
from small_plan import small_plan

from costs.allowance import Allowance, BodyRef
from costs.robot.carried import MovableObject
from costs.robot.elements.inertia import LinkInertia
from costs.scene import ConvexPiece, Scene
from service.errors import RequestError
from service.simulation.options import SimulationOptions
from service.simulation.perturb import FRICTION, JOINT_RAD, MASS_SHARE, PLACE_M, draw_perturbation, group_pieces

BOX = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.2, 0.2) for z in (-0.1, 0.0)])


@pytest.fixture(scope="module")
def motion():
    made = small_plan().motion
    below = BOX + made.phases[0].contacts[0].points.mean(axis=0)
    pieces = (ConvexPiece("below", below), ConvexPiece("aside", BOX + np.array([2.0, 0.0, 1.0])))
    return replace(made, scene=replace(made.scene, pieces=pieces))


def draw(motion, seed, size=1.0):
    return draw_perturbation(motion, np.array([True, False]), SimulationOptions(perturb=size, seed=seed))


def test_errors_are_those_of_their_seed_and_within_their_size(motion):
    drawn = [draw(motion, seed) for seed in range(20)]
    again = draw(motion, 3)
    np.testing.assert_array_equal(again.places["aside"], drawn[3].places["aside"])
    places = np.array([error.places["aside"] for error in drawn])
    assert 0.8 * PLACE_M < np.abs(places).max() <= PLACE_M
    masses = np.array([list(error.masses.values()) for error in drawn])
    assert 0.8 * MASS_SHARE < np.abs(masses - 1.0).max() <= MASS_SHARE
    assert 0.5 * FRICTION < max(abs(error.friction) for error in drawn) <= FRICTION
    start = np.abs([error.start for error in drawn]).max(axis=0)
    assert start[0] <= JOINT_RAD
    assert start[1] <= 0.1 * JOINT_RAD


def test_what_carries_the_first_pose_stays_where_it_is(motion):
    assert not draw(motion, 1).places["below"].any()


def test_without_errors_nothing_changes(motion):
    error = draw(motion, 1, 0.0)
    assert not error.places["aside"].any()
    assert not error.start.any()
    assert error.friction == 0.0
    assert set(error.masses.values()) == {1.0}


def test_a_negative_size_is_refused():
    with pytest.raises(RequestError, match="perturb"):
        SimulationOptions(perturb=-1.0)


def test_what_an_object_may_touch_together_is_displaced_as_one(motion):
    def touch(item, *names):
        return tuple(Allowance(BodyRef.of_link(item), BodyRef.of_piece(name), 1e-3) for name in names)

    item = MovableObject("peg", BOX, LinkInertia(1.0, np.zeros(3), np.eye(3)), np.eye(4))
    names = ("shelf", "left", "right", "table", "post")
    pieces = tuple(ConvexPiece(name, BOX + np.array([2.0 + k, 0.0, 1.0])) for k, name in enumerate(names))
    first, last = motion.phases
    phases = (
        replace(first, allowances=(*touch("peg", "table", "left"), *touch("r_hand", "post", "shelf"))),
        replace(last, allowances=touch("peg", "right", "left")),
    )
    own = replace(motion, objects=(item,), scene=Scene(pieces), phases=phases)
    assert group_pieces(own) == [["left", "right", "table"]]
    places = draw(own, 2).places
    np.testing.assert_array_equal(places["left"], places["table"])
    np.testing.assert_array_equal(places["left"], places["right"])
    assert len({tuple(place) for place in places.values()}) == 3
