"""Hands that press on a mechanism: what is expected of them together, and how they give way."""

from __future__ import annotations

import numpy as np
import pytest
from still_door import motion_of

from service.errors import ExecutionError
from service.execution.hands.relief import HandRelief, ReliefSettings
from service.verify import HandLoad, HandPush, Phase, limit_loads

PERIOD = 0.01
# On a leaf shut in the plane x = 0.8 that turns about z: its way is along x.  The lever below hangs from it.
PUSH = HandLoad("l_tool", "leaf", np.array([0.0, 0.8, 1.0]), np.array([40.0, 0.0, 0.0]))
DRAG = HandLoad("l_tool", "leaf", np.array([0.0, 0.8, 1.0]), np.array([0.0, 30.0, 0.0]))
PRESS = HandLoad("l_tool", "lever", np.array([0.0, -0.1, 0.0]), np.array([0.0, 0.0, -20.0]))
SETTINGS = ReliefSettings(gain=1e-3, dead_n=15.0, most_m=0.02, fade_s=2.0)


def relief_of(*loads: HandLoad, pushes: tuple[HandPush, ...] = ()) -> HandRelief:
    motion = motion_of(np.zeros((2, 2)))
    phases = (Phase("act", 0.0, 0.5, loads=loads, pushes=pushes), Phase("leave", 0.5, 1.0))
    return HandRelief(motion.robot, phases, ("l_hand", "r_hand"), SETTINGS)


def step(relief: HandRelief, force: list[float], offset: list[float] | None = None, number: int = 0) -> np.ndarray:
    """Return the displacement of the left hand after one step under a measured force on its tool."""
    planned = motion_of(np.zeros((2, 2))).curve(np.array([0.0]))[0]
    offsets = {} if offset is None else {"l_hand": np.array(offset)}
    made = relief.step(offsets, number, planned, {"l_tool": np.array(force)}, PERIOD)
    return made.get("l_hand", np.zeros(3))


def test_the_force_along_the_way_of_the_mechanism_moves_no_hand() -> None:
    np.testing.assert_array_equal(step(relief_of(PUSH), [-300.0, 0.0, 0.0]), np.zeros(3))


def test_a_hand_gives_way_beside_the_way_of_the_mechanism() -> None:
    """100 N across a push of 40 N: 15 N and the friction of the push, 12 N, are left to it."""
    np.testing.assert_allclose(step(relief_of(PUSH), [-40.0, 0.0, 100.0]), [0.0, 0.0, 1e-3 * PERIOD * 73.0], atol=1e-12)


def test_the_friction_that_is_left_to_a_hand_is_the_request_s() -> None:
    """Of 40 N at 0.1 only 4 N are left beside the way."""
    relief = relief_of(PUSH, pushes=(HandPush("door_opening", 1.0, 40.0, (), (0.1, 0.6)),))
    np.testing.assert_allclose(step(relief, [-40.0, 0.0, 100.0]), [0.0, 0.0, 1e-3 * PERIOD * 81.0], atol=1e-12)


def test_a_lever_is_pressed_down_and_gives_way_towards_the_leaf() -> None:
    """The leaf is latched while its lever turns, so that a force on it is no work."""
    moved = step(relief_of(PRESS), [-100.0, 0.0, 20.0])
    np.testing.assert_allclose(moved, [-1e-3 * PERIOD * (100.0 - 15.0 - 6.0), 0.0, 0.0], atol=1e-12)


def test_what_the_plan_itself_expects_beside_the_way_is_left_to_it() -> None:
    relief = relief_of(PUSH, DRAG)
    np.testing.assert_array_equal(step(relief, [-40.0, -30.0, 0.0]), np.zeros(3))
    # 60 N are 30 N more than planned; against the planned sense all of them are too many.
    np.testing.assert_allclose(step(relief, [-40.0, -60.0, 0.0]), [0.0, -1e-3 * PERIOD * 3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(step(relief, [-40.0, 60.0, 0.0]), [0.0, 1e-3 * PERIOD * 33.0, 0.0], atol=1e-12)


def test_a_hand_gives_way_only_so_far_and_comes_back_without_load() -> None:
    relief = relief_of(PUSH)
    far = step(relief, [-40.0, 0.0, 900.0], [0.0, 0.0, 0.0199])
    np.testing.assert_allclose(far, [0.0, 0.0, 0.02])
    np.testing.assert_allclose(
        step(relief, [0.0] * 3, [0.0, 0.0, 0.02], number=1), [0.0, 0.0, 0.02 * (1.0 - PERIOD / 2.0)]
    )
    np.testing.assert_array_equal(step(relief, [0.0] * 3, [0.0, 0.0, 9e-7], number=1), np.zeros(3))


@pytest.mark.parametrize("kwargs", [{"gain": -1.0}, {"fade_s": 0.0}])
def test_settings_that_make_no_sense_are_refused(kwargs: dict[str, float]) -> None:
    with pytest.raises(ExecutionError, match="expected 0 or more"):
        ReliefSettings(**kwargs)


def test_loads_of_one_tool_are_expected_as_one_force() -> None:
    motion = motion_of(np.zeros((2, 2)))
    (both,) = limit_loads(motion, Phase("open", 0.0, 1.0, loads=(PUSH, PRESS)))
    assert both.links == ("leaf", "lever")
    assert both.expected_n == pytest.approx(np.hypot(40.0, 20.0))
    (alone,) = limit_loads(motion, Phase("open", 0.0, 1.0, loads=(PUSH,)))
    assert alone.expected_n == pytest.approx(40.0)
    assert both.abort_n == pytest.approx(0.5 * (both.expected_n + both.cap_n))


def test_a_load_that_works_against_another_may_be_absent() -> None:
    """The force that is expected is the largest of any combination."""
    against = HandLoad("l_tool", "leaf", PUSH.place, -0.5 * PUSH.force)
    (limits,) = limit_loads(motion_of(np.zeros((2, 2))), Phase("open", 0.0, 1.0, loads=(PUSH, against)))
    assert limits.expected_n == pytest.approx(40.0)


def test_tools_are_judged_apart() -> None:
    other = HandLoad("r_tool", "leaf", PUSH.place, PUSH.force)
    limits = limit_loads(motion_of(np.zeros((2, 2))), Phase("open", 0.0, 1.0, loads=(PUSH, other)))
    assert [entry.tool for entry in limits] == ["l_tool", "r_tool"]
    assert all(entry.expected_n == pytest.approx(40.0) for entry in limits)
