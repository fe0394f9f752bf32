"""Wrenches of hand loads from the mechanism's coordinates, and the regions that a planner finds for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from still_door import HINGE, motion_of, with_door
from tiny_robots import atlas

from costs.curve import Curve
from costs.scene import Scene
from service.body.aims import Aims
from service.body.forces.loaded_regions import plan_regions
from service.body.whole_body import WholeBody
from service.verify import WORLD, HandLoad, VerifyError
from service.verify.forces.equilibrium import RecordedRegion, prove_equilibrium
from service.verify.forces.hand_loads import bound_coordinate, list_load_cases, list_load_wrenches, measure_retreat
from service.verify.forces.loaded_balance import find_normals, place_contact_points


@given(seed=st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_a_coordinate_is_bounded_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curve = Curve(np.array([0.0, 1.0, 2.5, 3.0]), rng.normal(size=(4, 2)), 3.0 * rng.normal(size=(4, 2)))
    first, last = np.sort(rng.uniform(0.0, 3.0, 2))
    low, high = bound_coordinate(curve, 1, first, last)
    dense = curve(np.linspace(first, last, 4001))[:, 1]
    assert low <= dense.min() + 1e-12
    assert dense.max() <= high + 1e-12
    assert high - dense.max() < 1e-4
    assert dense.min() - low < 1e-4
    onward = dense if dense[-1] >= dense[0] else -dense
    back = (np.maximum.accumulate(onward) - onward).max()
    assert back - 1e-12 <= measure_retreat(curve, 1, first, last) < back + 2e-4


def test_a_coordinate_that_swings_back_between_two_knots_retreats() -> None:
    curve = Curve(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [0.5], [1.0]]), np.array([[0.0], [-1.0], [0.0]]))
    assert measure_retreat(curve, 0, 0.0, 2.0) == pytest.approx(0.148, abs=0.01)
    assert measure_retreat(curve, 0, 0.0, 0.5) == 0.0


@given(
    first=st.floats(0.0, 0.6), turn=st.floats(0.05, 0.9), share=st.floats(0.0, 1.0), sizes=st.tuples(
        st.floats(0.0, 1.0), st.floats(0.0, 1.0)
    ), lever=st.floats(0.0, 0.6),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_every_load_on_a_stretch_is_in_the_hull_of_its_corners(
    first: float, turn: float, share: float, sizes: tuple[float, float], lever: float
) -> None:
    push = HandLoad(
        "l_tool", "leaf", np.array([-0.05, 0.8, 1.0]), np.array([40.0, 5.0, 0.0]), np.array([0.0, 0.1, 0.0])
    )
    press = HandLoad("l_tool", "lever", np.array([0.0, -0.1, 0.01]), np.array([0.0, -1.0, -20.0]))
    values = np.array([[first, lever], [first + turn, lever]])
    motion = motion_of(values)
    corners = list_load_wrenches(motion, (push, press), 0.0, 1.0)
    q = motion.curve(np.array([share]))
    moved = replace(push, place=push.place + (2.0 * share - 1.0) * push.slide, slide=None)
    cases = list_load_cases(motion.robot, q, (moved, press))
    wrench = sizes[0] * cases[2].wrench[0] + sizes[1] * cases[1].wrench[0]
    assert _distance(wrench, corners) < 1e-6


@given(
    share=st.floats(0.0, 1.0), along=st.floats(-1.0, 1.0), turn=st.floats(0.0, 6.3), across=st.floats(0.0, 1.0),
    twist=st.floats(-1.0, 1.0),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_a_tool_s_force_in_any_direction_across_it_is_in_the_hull_of_its_corners(
    share: float, along: float, turn: float, across: float, twist: float
) -> None:
    """A drill that is pushed into a wall ahead, anywhere on a way of 20 cm, and cuts sideways."""
    load = HandLoad(
        "l_tool", WORLD, np.array([0.8, 0.1, 1.1]), np.array([15.0, 0.0, 0.0]), np.array([0.0, 0.1, 0.0]), 0.0, 8.0, 0.5
    )
    corners = np.vstack([np.zeros(6), list_load_wrenches(motion_of(np.zeros((2, 2))), (load,), 0.0, 1.0)])
    force = share * load.force + across * 8.0 * np.array([0.0, np.cos(turn), np.sin(turn)])
    point = load.place + along * load.slide
    wrench = np.concatenate([force, np.cross(point, force) + 0.5 * twist * np.eye(3)[0]])
    assert _distance(-wrench, corners) < 1e-6
    beyond = np.array([0.0, 0.0, 0.0, 1.6, 0.0, 0.0])
    assert _distance(-beyond, corners) > 1e-3


def test_two_joints_that_move_at_once_cannot_be_followed() -> None:
    load = HandLoad("l_tool", "lever", np.zeros(3), np.array([0.0, 0.0, -20.0]))
    with pytest.raises(VerifyError, match="opening, turning move at once"):
        list_load_wrenches(motion_of(np.array([[0.0, 0.0], [0.3, 0.3]])), (load,), 0.0, 1.0)


def test_a_load_that_slides_acts_where_the_tool_is() -> None:
    motion = motion_of(np.array([[0.3, 0.0], [0.3, 0.0]]))
    q = motion.curve(np.array([0.5]))
    model, data = motion.robot.model, motion.robot.model.createData()
    pin.framesForwardKinematics(model, data, q[0])
    leaf, tool = (data.oMf[model.getFrameId(name)] for name in ("leaf", "l_tool"))
    off = leaf.rotation.T @ (tool.translation - leaf.translation)
    along = off / np.linalg.norm(off)
    force = np.cross(along, [0.0, 0.0, 1.0])
    for beyond, wanted in ((0.05, 0.05), (-0.05, -0.05), (0.3, 0.1)):  # on the slide, and past its end
        load = HandLoad("l_tool", "leaf", off - beyond * along, force, 0.1 * along)
        ((_, parts),) = ((case.wrench, case.parts) for case in list_load_cases(motion.robot, q, (load,))[1:])
        place = leaf.rotation @ (load.place + wanted * along) + leaf.translation
        np.testing.assert_allclose(parts[0][1][0, 3:], np.cross(place, -leaf.rotation @ force), atol=1e-9)


@pytest.mark.parametrize(("tool", "link"), [("l_tool", "no leaf"), ("no tool", "leaf")])
def test_a_load_with_a_frame_that_nobody_has_is_refused(tool: str, link: str) -> None:
    robot = motion_of(np.zeros((2, 2))).robot
    load = HandLoad(tool, link, np.zeros(3), np.array([50.0, 0.0, 0.0]))
    with pytest.raises(VerifyError, match="unknown frame 'no"):
        list_load_cases(robot, np.zeros((1, robot.n)), (load,))


def test_a_load_by_hand() -> None:
    """A push of 50 N on a shut leaf: the robot feels the opposite at that place."""
    load = HandLoad("l_tool", "leaf", np.array([0.0, 0.8, 1.0]), np.array([50.0, 0.0, 0.0]))
    wrenches = list_load_wrenches(motion_of(np.zeros((2, 2))), (load,), 0.0, 1.0)
    place, force = HINGE + load.place, np.array([-50.0, 0.0, 0.0])
    np.testing.assert_allclose(wrenches[np.abs(wrenches).sum(axis=1).argmax()], [*force, *np.cross(place, force)])
    assert (np.abs(wrenches).sum(axis=1) == 0.0).any()


def test_the_planners_regions_are_proven_by_the_verifier_for_the_loads_of_the_motion() -> None:
    robot = with_door()
    body = WholeBody.standing(
        robot, Scene(), np.append(atlas().postures["stand"], [0.0, 0.0]), ("l_foot", "r_foot"), Aims()
    )
    contacts = body.planted
    load = HandLoad("l_tool", "leaf", np.array([-0.05, 0.8, 1.0]), np.array([40.0, 0.0, 0.0]))
    values = np.linspace([0.0, 0.0], [1.2, 0.0], 9)
    motion = motion_of(values)
    mass = float(pin.computeTotalMass(robot.model))
    corners = place_contact_points(contacts)
    friction, cap = np.full(len(corners), contacts[0].friction), np.full(len(corners), contacts[0].force_cap_n)
    regions = plan_regions(body.engine, contacts, (load,), values, body.nominal)
    assert [region.first for region in regions][1:] == [region.last for region in regions][:-1]
    for planned in regions:
        region = planned.region
        recorded = RecordedRegion(
            corners, find_normals(contacts), friction, cap, region.wrenches, region.vertices, region.witnesses
        )
        loads = list_load_wrenches(motion, (load,), float(planned.first), float(planned.last))
        assert prove_equilibrium(recorded, mass, loads, drift_m=0.021).is_proven
        assert not prove_equilibrium(recorded, mass, 1.3 * loads, drift_m=0.021).is_proven


def _distance(wrench: np.ndarray, corners: np.ndarray) -> float:
    """Distance (largest component) of a wrench from the hull of corners."""
    n = len(corners)
    rows = np.block([[corners.T, -np.ones((6, 1))], [-corners.T, -np.ones((6, 1))]])
    total = np.append(np.ones(n), 0.0)[None]
    solved = linprog(np.append(np.zeros(n), 1.0), rows, np.concatenate([wrench, -wrench]), total, [1.0], method="highs")
    return float(solved.fun)
