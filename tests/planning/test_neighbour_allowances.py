"""Allowances of a mechanism: its neighbours at the start by their overlap and 3 mm, bearings over their range."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_robots import CUBE, box, robot_of

from costs.allowance import Allowance, BodyRef
from costs.robot import MechanismJoint, RobotModel, with_mechanism
from costs.robot.model import LinkBody
from costs.scene import ConvexPiece, Scene
from service.demands.neighbours import NEAR, SLACK, make_neighbour_allowances

UP = np.array([0.0, 0.0, 1.0])
STEP = 1.1e-4  # depths are rounded up
LEAF = np.array([0.4, 0.02, 0.5])  # half sides


def _robot() -> RobotModel:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([0.0, -5.0, 0.0])), "slide")
    return robot_of(model, [LinkBody("slider", "slider", joint, 0.05 * CUBE, 0.05 * CUBE)])


def _leaf(**more: object) -> RobotModel:
    """A leaf 0.8 m wide about the origin, hinged at x = -0.4."""
    bodies = {"leaf/slab": LEAF * CUBE}
    return with_mechanism(
        _robot(), [MechanismJoint("hinge", "leaf", np.array([-0.4, 0.0, 0.0]), UP, bodies, **{"upper": 1.5, **more})]
    )


def _distance(first: np.ndarray, second: np.ndarray) -> float:
    """Signed distance of two boxes along the axes: minus the least overlap of a side where they overlap."""
    gap = np.maximum(first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0))
    return float(np.linalg.norm(np.maximum(gap, 0.0)) if gap.max() > 0.0 else gap.max())


@settings(max_examples=60, deadline=None)
@given(
    centre=st.tuples(*[st.floats(-0.8, 0.8)] * 3),
    half=st.tuples(*[st.floats(0.01, 0.3)] * 3),
)
def test_a_piece_is_a_neighbour_within_5_cm_and_may_be_overlapped_by_3_mm_more(centre, half) -> None:
    piece = box("post", centre, half)
    distance = _distance(LEAF * CUBE, piece.vertices)
    made = make_neighbour_allowances(_leaf(), Scene((piece,)), np.zeros(2))
    if abs(distance - NEAR) < 1e-6:
        return
    assert len(made) == (distance < NEAR)
    for allowance in made:
        assert (allowance.first, allowance.second) == (
            BodyRef("mechanism", "leaf", "leaf/slab"),
            BodyRef.of_piece("post"),
        )
        more = allowance.depth - max(-distance, 0.0)
        assert SLACK - 1e-6 <= more <= SLACK + STEP


def test_an_ajar_leaf_has_the_neighbours_of_its_start() -> None:
    post = box("post", (-0.4, 0.55, 0.0), (0.1, 0.1, 0.1))  # where the free edge is at 90 deg
    robot = _leaf(start=np.pi / 2 - 0.1)
    assert make_neighbour_allowances(robot, Scene((post,)), np.zeros(2)) == ()
    assert len(make_neighbour_allowances(robot, Scene((post,)), np.array([0.0, np.pi / 2]))) == 1


def test_a_robot_without_a_mechanism_has_none() -> None:
    assert make_neighbour_allowances(_robot(), Scene((box("post", (0.0, -5.0, 0.0), (1, 1, 1)),)), np.zeros(1)) == ()


def _wheel(upper: float) -> RobotModel:
    """A square of 10 cm that turns about its middle."""
    bodies = {"wheel/square": 0.05 * CUBE}
    return with_mechanism(_robot(), [MechanismJoint("turn", "wheel", np.zeros(3), UP, bodies, lower=-1, upper=upper)])


def _bracket(gap: float) -> ConvexPiece:
    """A wall at a distance from the square's side."""
    return box("wall", (0.05 + gap + 0.5, 0.0, 0.0), (0.5, 1.0, 1.0))


CORNER = 0.05 * (np.sqrt(2.0) - 1.0)  # by which a corner reaches farther than a side


def test_a_wheel_may_overlap_what_it_overlaps_at_the_start_by_as_much_as_in_a_whole_turn() -> None:
    (made,) = make_neighbour_allowances(_wheel(upper=7.0), Scene((_bracket(-0.01),)), np.zeros(2))
    assert made.depth == pytest.approx(0.01 + CORNER + SLACK, abs=1.1e-3)


@pytest.mark.parametrize(("upper", "gap", "overlap"), [(7.0, 0.005, 0.0), (1.0, -0.01, 0.01)])
def test_neither_a_piece_beside_a_wheel_nor_that_of_a_leaf_is_a_bearing(upper, gap, overlap) -> None:
    (made,) = make_neighbour_allowances(_wheel(upper), Scene((_bracket(gap),)), np.zeros(2))
    assert made.depth == pytest.approx(overlap + SLACK, abs=STEP)


def _bar(parent: str | None) -> tuple[Allowance, ...]:
    """A bar that slides by 3 cm into a block in which it is by 1 cm."""
    axis = np.array([1.0, 0.0, 0.0])
    block = MechanismJoint("block_turn", "block", np.zeros(3), UP, {"block/b": 0.2 * CUBE})
    bar = {"bar/b": np.array([-0.29, 0.0, 0.0]) + 0.1 * CUBE}
    slide = MechanismJoint("bar_slide", "bar", np.zeros(3), axis, bar, "prismatic", parent, lower=0.0, upper=0.03)
    return make_neighbour_allowances(with_mechanism(_robot(), [block, slide]), Scene(), np.zeros(3))


def test_links_around_a_joint_may_overlap_over_its_range_and_others_as_at_the_start() -> None:
    (bearing,) = _bar("block")
    (beside,) = _bar(None)
    assert bearing.depth == pytest.approx(0.04 + SLACK, abs=1.1e-3)
    assert beside.depth == pytest.approx(0.01 + SLACK, abs=STEP)
