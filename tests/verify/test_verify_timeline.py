"""From path parameter to time, and how phases must cover the curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from small_robots import robot_of

from costs.curve import Curve, TimeLaw
from costs.scene import Scene
from service.verify import Motion, Phase, VerifyError, VerifySettings
from service.verify.limits import check_positions
from service.verify.prepared_motion import PreparedMotion
from service.verify.timeline import edges_within, find_time, find_times, list_phases, split_at_phases

# Up to speed 2 in 1 s, on at 2 for 1 s, down in 1 s, a pause of 3 s, and 1 s at ever greater speed.
LAW = TimeLaw(
    np.array([0.0, 1.0, 2.0, 3.0, 6.0, 7.0]),
    np.array([0.0, 1.0, 3.0, 4.0, 4.0, 5.0]),
    np.array([0.0, 2.0, 2.0, 0.0, 0.0, 2.0]),
)


def _motion(knots: list[float], phases: tuple[Phase, ...] = ()) -> Motion:
    model = pin.Model()
    for kind, name in ((pin.JointModelPX, "slide"), (pin.JointModelRZ, "turn")):
        joint = model.addJoint(model.njoints - 1, kind(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    at = np.array(knots)
    return Motion(robot_of(model, []), Scene(), Curve(at, np.zeros((len(at), 2)), np.zeros((len(at), 2))), None, phases)


@pytest.mark.parametrize(
    ("s", "time"),
    [
        (0.0, 0.0), (0.25, 0.5), (0.64, 0.8), (1.0, 1.0), (2.0, 1.5), (3.0, 2.0), (3.75, 2.5), (3.96, 2.8),
        (4.0, 3.0), (4.25, 6.5), (5.0, 7.0), (-1.0, 0.0), (5.5, 7.0),
    ],
)  # fmt: skip
def test_a_place_is_reached_when_the_law_by_hand_says(s: float, time: float) -> None:
    assert find_time(LAW, s) == pytest.approx(time, abs=1e-9)
    assert find_times(LAW, np.array([s, s])) == pytest.approx([time, time], abs=1e-9)
    assert find_time(None, s) is None


def test_a_slow_start_takes_the_root_of_the_way() -> None:
    slow = TimeLaw(np.array([0.0, 4.0]), np.array([0.0, 1.0]), np.array([0.0, 0.5]))
    assert find_times(slow, np.array([1.0 / 16.0, 0.25, 1.0])) == pytest.approx([1.0, 2.0, 4.0])
    brief = TimeLaw(np.array([0.0, 0.25]), np.array([0.0, 1.0]), np.array([8.0, 0.0]))
    assert find_times(brief, np.array([0.75, 1.0])) == pytest.approx([0.125, 0.25])


def test_times_never_run_back_nor_beyond_their_step() -> None:
    s = np.linspace(0.0, 5.0, 10_001)
    times = find_times(LAW, s)
    assert np.all(np.diff(times) > 0.0)
    # A law that lies about its speeds is read no further than the step's end.
    lazy = TimeLaw(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]), np.array([0.1, 0.1, 5.0]))
    assert find_times(lazy, np.array([0.5, 1.0, 2.0])) == pytest.approx([0.5, 1.0, 2.0])


def test_without_phases_the_whole_curve_is_one_that_promises_nothing() -> None:
    (phase,) = list_phases(_motion([0.5, 1.0, 2.5]))
    assert phase == Phase("motion", 0.5, 2.5)


@pytest.mark.parametrize(
    ("borders", "message"),
    [
        ([(0.5, 1.0), (1.0, 2.5)], None),
        ([(0.5, 1.0), (1.0 + 5e-13, 2.5)], None),
        ([(0.5, 1.0), (1.0 - 5e-13, 2.5 + 1e-12)], None),
        ([(0.6, 2.5)], r"phase '0' must begin at 0.5 .* got 0.6"),
        ([(0.4, 2.5)], r"phase '0' must begin at 0.5"),
        ([(0.5, 1.0), (1.1, 2.5)], r"phase '1' must begin at 1.0 .* got 1.1"),
        ([(0.5, 1.0), (0.9, 2.5)], r"phase '1' must begin at 1.0 .* got 0.9"),
        ([(0.5, 1.0), (1.0 + 1e-11, 2.5)], r"phase '1' must begin"),
        ([(0.5, 0.5), (0.5, 2.5)], r"phase '0' must .* have a length"),
        ([(0.5, 0.4), (0.4, 2.5)], r"phase '0' must .* have a length"),
        ([(0.5, 2.0)], r"the last phase ends at 2.0, the curve at 2.5"),
        ([(0.5, 3.0)], r"the last phase ends at 3.0, the curve at 2.5"),
        ([(0.5, 2.5 + 1e-11)], r"the last phase ends"),
    ],
)
def test_phases_must_cover_the_curve_one_after_another(borders: list[tuple[float, float]], message: str | None) -> None:
    phases = tuple(Phase(str(k), first, last) for k, (first, last) in enumerate(borders))
    motion = _motion([0.5, 1.0, 2.5], phases)
    if message is None:
        assert list_phases(motion) == phases
    else:
        with pytest.raises(VerifyError, match=message):
            list_phases(motion)


def test_borders_far_along_the_curve_may_differ_by_what_their_digits_do() -> None:
    phases = (Phase("a", 0.0, 1000.0), Phase("b", 1000.0 + 5e-10, 2000.0 + 1e-9))
    assert list_phases(_motion([0.0, 2000.0], phases)) == phases


def test_edges_are_knots_and_borders_each_stretch_with_its_phase() -> None:
    phases = (Phase("a", 0.5, 0.8), Phase("b", 0.8, 2.0), Phase("c", 2.0, 2.5))
    edges, rows = split_at_phases(_motion([0.5, 1.0, 2.5], phases), phases)
    np.testing.assert_array_equal(edges, [0.5, 0.8, 1.0, 2.0, 2.5])
    np.testing.assert_array_equal(rows, [0, 1, 1, 2])
    np.testing.assert_array_equal(edges_within(edges, phases[1]), [0.8, 1.0, 2.0])
    np.testing.assert_array_equal(edges_within(edges, Phase("d", 0.8 + 5e-10, 2.0 - 5e-10)), [0.8, 1.0, 2.0])
    part = Phase("d", 0.8 + 2e-9, 2.0 - 3e-9)
    np.testing.assert_array_equal(edges_within(edges, part), [part.first, 1.0, part.last])


def test_a_phase_far_along_the_curve_has_its_borders_but_for_their_digits() -> None:
    edges = np.array([1000.0, 1500.0, 2000.0])
    np.testing.assert_array_equal(edges_within(edges, Phase("d", 1000.0 + 1e-6, 2000.0 - 1e-6)), edges)
    part = Phase("d", 1000.0 + 1e-5, 2000.0 - 1e-5)
    np.testing.assert_array_equal(edges_within(edges, part), [part.first, edges[1], part.last])


@pytest.mark.parametrize(
    ("peak", "lower", "upper", "excess"),
    [(1.0, -2.0, 0.9, 0.1), (-1.0, -0.9, 2.0, 0.1), (1.0, -0.5, 1.5, 4.0 / 27.0 - 0.5), (1.0, -1.0, 1.0 - 5e-10, 5e-10),
     (1.0, -1.0, 1.0 - 2e-9, 2e-9)],
)  # fmt: skip
def test_the_extreme_between_two_knots_is_held_against_both_limits(
    peak: float, lower: float, upper: float, excess: float
) -> None:
    # From 0 to 0 with slopes 4 and -4: a parabola of height 1 over the second interval.
    motion = _motion([0.0, 1.0, 2.0])
    motion.curve.tangents[1:, 1] = [4.0 * peak, -4.0 * peak]
    motion.curve.tangents[0, 1] = 0.0
    curve = Curve(np.array([0.0, 0.25, 1.25]), motion.curve.positions, motion.curve.tangents)
    curve.positions[0, 1] = 0.0
    robot = replace(motion.robot, lower=np.array([-9.0, lower]), upper=np.array([9.0, upper]))
    (check,) = check_positions(PreparedMotion(replace(motion, curve=curve, robot=robot)), VerifySettings())
    assert check.name == "limits.position"
    assert check.value == pytest.approx(excess, abs=1e-12)
    assert check.ok == (excess < 1e-9)
    assert check.where is not None
    # The knot interval; the dip of -4/27 is in the first.
    assert (check.where.s, check.where.time_s) == (0.25 if excess > 0.0 else 0.0, None)
    assert check.where.names == ("joint1",)
    verb = "comes nearest" if check.ok else "exceeds"
    assert check.text.startswith(f"joint1 {verb}")
    assert check.limit == 0.0
