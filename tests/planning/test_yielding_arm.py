"""An arm that yields where its mechanism has moved, by itself: how far it follows, and when it says that it cannot."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from opened_door import compile_opening

from costs.kinematics import KinematicsEngine, locate_links
from service.demands.phase import FrameMotion, TaskPhase
from service.tasks.held_tool import bring_tool
from service.tasks.rest.compliance import CannotFollowError, _yield_arm

LEAF_AXES = np.eye(3)


@pytest.fixture(scope="module")
def holding() -> tuple[KinematicsEngine, TaskPhase, FrameMotion, np.ndarray]:
    """The robot with its peg in the handle of a door: its pose twice."""
    compiler, specs = compile_opening()
    spec = next(spec for spec in specs if 0 in spec.moving)
    assert spec.hand is not None
    assert spec.hand.slide is None
    guess = np.concatenate([compiler.solver.body.nominal[: compiler.columns[0]], spec.first])
    prescribed = np.isin(np.arange(compiler.robot.n), compiler.columns)
    q = bring_tool(compiler.solver.body, spec.frames, guess[None], prescribed)
    return compiler.solver.body.engine, spec, spec.hand, np.repeat(q, 2, axis=0)


def offset_in_leaf(engine: KinematicsEngine, hand: FrameMotion, q: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Offset of the tool from a place of the leaf, in the leaf's axes [m]."""
    poses = locate_links(engine, q, [hand.tool, str(hand.link)])
    pose_leaf_tool = np.linalg.inv(poses[str(hand.link)]) @ poses[hand.tool]
    return pose_leaf_tool[:3, 3] - place


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("may_lean", [False, True])
def test_an_arm_that_does_not_reach_says_by_how_many_millimetres_whichever_way_that_is(holding, axis, may_lean):
    engine, spec, hand, q = holding
    far = replace(hand, place=hand.place + 4.0 * LEAF_AXES[axis])
    if may_lean:
        far = replace(far, aim_rad=np.pi, tilt_rad=np.pi)
    with pytest.raises(CannotFollowError, match="does not follow") as error:
        _yield_arm(engine, spec, far, q)
    missing = re.search(r"it stays ([\d.]+) mm", str(error.value))
    assert missing is not None
    assert float(missing[1]) > 1500.0  # 4 m less what an arm reaches to both sides of where the hand was


@pytest.mark.parametrize("axis", range(3))
def test_an_arm_follows_its_place_by_a_centimetre_any_way(holding, axis):
    engine, spec, hand, q = holding
    moved = replace(hand, place=hand.place + 0.01 * LEAF_AXES[axis])
    for followed in _yield_arm(engine, spec, moved, q):
        assert np.linalg.norm(offset_in_leaf(engine, hand, followed, moved.place)) <= np.sqrt(3.0) * hand.tolerance_m


@pytest.mark.parametrize("axis", range(3))
def test_a_hand_that_may_slide_goes_along_only_by_what_is_beyond_its_slide(holding, axis):
    # it may be 30 mm from its place along its slide, of which 2 mm are kept for the curve between the knots
    engine, spec, hand, q = holding
    for distance_m, expected_m in ((0.02, 0.0), (-0.02, 0.0), (0.04, 0.012), (-0.04, -0.012)):
        way = LEAF_AXES[axis]
        sliding = replace(hand, place=hand.place + distance_m * way, slide=0.03 * way)
        before = offset_in_leaf(engine, hand, q[0], hand.place)
        for followed in _yield_arm(engine, spec, sliding, q):
            after = offset_in_leaf(engine, hand, followed, hand.place)
            np.testing.assert_allclose(after - before, expected_m * way, atol=1.5e-3)
