"""A tool brought to its place, and led along with a mechanism, before anything is optimised."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from opened_door import compile_opening

from costs.kinematics import locate_links
from costs.stopping import Stopped, stops_when
from service.body.comfort import RESERVE_M
from service.body.forces.loaded_regions import PlannedRegion
from service.demands.phase import TaskPhase
from service.demands.rest.earlier_motion import EarlierMotion
from service.demands.stance import BALANCE_RESERVE
from service.tasks.held_tool import INSIDE_RESERVE, INSIDE_SHARE, bring_tool, follow_in_balance, follow_tool
from service.tasks.phase_compiler import PhaseCompiler
from service.tasks.phase_terms import list_together
from service.tasks.sequence import PhaseSequence
from service.verify import HandLoad


@pytest.fixture(scope="module")
def opening() -> tuple[PhaseCompiler, tuple[TaskPhase, ...]]:
    """A robot at a pulled door, and the phases in which its peg opens the leaf by 30 degrees."""
    return compile_opening()


@pytest.fixture(scope="module")
def held(opening: tuple[PhaseCompiler, tuple[TaskPhase, ...]]) -> tuple[PhaseCompiler, TaskPhase]:
    """The phase in which the leaf moves."""
    compiler, specs = opening
    return compiler, next(spec for spec in specs if 0 in spec.moving)


def _list_prescribed(compiler: PhaseCompiler) -> np.ndarray:
    prescribed = np.zeros(compiler.robot.n, dtype=bool)
    prescribed[compiler.columns] = True
    return prescribed


def _measure_off(compiler: PhaseCompiler, spec: TaskPhase, q: np.ndarray) -> tuple[float, float]:
    """Return how far a tool is from its place [m], and its axis from its direction [rad]."""
    hand = spec.hand
    assert hand is not None
    assert hand.link is not None
    assert hand.turns_with is not None
    poses = locate_links(compiler.solver.body.engine, q, [hand.tool, hand.link, hand.turns_with])
    place = poses[hand.link] @ [*hand.place, 1.0]
    axis = poses[hand.turns_with][:3, :3] @ hand.axis
    off = poses[hand.tool][:3, 3] - place[:3]
    if hand.slide is not None:
        along = poses[hand.link][:3, :3] @ hand.slide / np.linalg.norm(hand.slide)
        off = off - (off @ along) * along
    return float(np.linalg.norm(off)), float(np.arccos(np.clip(poses[hand.tool][:3, 2] @ axis, -1.0, 1.0)))


def test_a_tool_is_brought_to_its_place_from_far_away(held: tuple[PhaseCompiler, TaskPhase]) -> None:
    compiler, spec = held
    body = compiler.solver.body
    assert spec.hand is not None
    guess = np.concatenate([body.nominal[: compiler.columns[0]], spec.first])
    before, _ = _measure_off(compiler, spec, guess)
    (found,) = bring_tool(body, spec.frames, guess[None], _list_prescribed(compiler))
    off, lean = _measure_off(compiler, spec, found)
    assert before > 0.15
    assert off < 2e-4
    assert lean < 2e-4
    for foot in body.planted:
        poses = [locate_links(body.engine, q, [foot.link])[foot.link] for q in (guess, found)]
        np.testing.assert_allclose(poses[0], poses[1], atol=2e-4)
    assert (found >= body.robot.lower).all()
    assert (found <= body.robot.upper).all()
    np.testing.assert_array_equal(found[compiler.columns], spec.first)


def test_a_place_out_of_reach_leaves_the_guess(held: tuple[PhaseCompiler, TaskPhase]) -> None:
    compiler, spec = held
    assert spec.hand is not None
    far = np.array(compiler.solver.body.nominal)

    beyond = replace(spec.hand, place=spec.hand.place + np.array([5.0, 0.0, 0.0]))
    (found,) = bring_tool(compiler.solver.body, (beyond,), far[None], _list_prescribed(compiler))
    np.testing.assert_array_equal(found, far)


@pytest.mark.parametrize("is_backwards", [False, True])
def test_a_path_follows_the_mechanism(held: tuple[PhaseCompiler, TaskPhase], is_backwards: bool) -> None:
    compiler, spec = held
    body, count = compiler.solver.body, compiler.count_waypoints(spec)
    assert spec.hand is not None
    end = -1 if is_backwards else 0
    values = spec.values(count)
    guess = np.concatenate([body.nominal[: compiler.columns[0]], values[end]])
    (at,) = bring_tool(body, spec.frames, guess[None], _list_prescribed(compiler))
    start = np.tile(at, (count, 1))
    start[:, compiler.columns] = values
    path = follow_tool(body, spec.frames, start, _list_prescribed(compiler), is_backwards=is_backwards)
    assert path is not None
    np.testing.assert_array_equal(path[end], at)
    np.testing.assert_array_equal(path[:, compiler.columns], values)
    assert max(_measure_off(compiler, spec, start[-1 - end])) > 0.1
    for q in path:
        assert max(_measure_off(compiler, spec, q)) < 1.5e-3
    assert np.abs(np.diff(path, axis=0)).max() < 0.5


def test_a_path_that_leans_is_brought_into_the_regions_of_its_loads(held: tuple[PhaseCompiler, TaskPhase]) -> None:
    compiler, spec = held
    body, count = compiler.solver.body, compiler.count_waypoints(spec)
    assert spec.hand is not None
    values = spec.values(count)
    guess = np.concatenate([body.nominal[: compiler.columns[0]], values[0]])
    (at,) = bring_tool(body, spec.frames, guess[None], _list_prescribed(compiler))
    start = np.tile(at, (count, 1))
    start[:, compiler.columns] = values
    path = follow_tool(body, spec.frames, start, _list_prescribed(compiler))
    assert path is not None
    middle = body.engine.place(path).com[:, :2].mean(axis=0)
    # the region of the loads, moved so far that the whole path leans out of it by a few centimetres
    (region, *_) = compiler.find_regions(spec, values)
    vertices = region.region.vertices
    edge = vertices[:, 0].max() - middle[0] - 0.02
    moved = replace(region.region, vertices=vertices - np.array([edge, 0.0]))
    regions = (replace(region, first=0, last=count - 1, region=moved),)
    is_fixed = np.arange(count) == 0
    before = moved.polygon.margin(body.engine.place(path).com[:, :2])
    prescribed = _list_prescribed(compiler)
    turned = body.robot.joint_names.index("r_arm_wry")  # as a gripper's finger is kept
    prescribed[turned] = True
    inside = follow_in_balance(body, spec.frames, path, regions, is_fixed, prescribed)
    np.testing.assert_array_equal(inside[:, turned], path[:, turned])
    after = moved.polygon.margin(body.engine.place(inside).com[:, :2])
    assert before[1:].min() < body.aims.balance_margin + region.shift_m - 0.01
    assert after[1:].min() > body.aims.balance_margin + region.shift_m
    enough = min(RESERVE_M, INSIDE_SHARE * (moved.polygon.depth - region.shift_m))
    assert enough > body.aims.balance_margin + 0.01
    assert after[1:].min() > enough + region.shift_m - 2e-3
    np.testing.assert_array_equal(inside[0], path[0])
    np.testing.assert_array_equal(inside[:, compiler.columns], values)
    assert (inside[1:] >= body.robot.lower).all()
    assert (inside[1:] <= body.robot.upper).all()
    for q in inside:
        assert max(_measure_off(compiler, spec, q)) < 1.5e-3
    for foot in body.planted:
        poses = [locate_links(body.engine, q, [foot.link])[foot.link] for q in (path[-1], inside[-1])]
        np.testing.assert_allclose(poses[0], poses[1], atol=1e-3)


def test_work_can_stop_before_every_region(held: tuple[PhaseCompiler, TaskPhase]) -> None:
    compiler, spec = held
    polls = list[int]()
    with stops_when(lambda: bool(polls.append(1))):
        regions = compiler.find_regions(spec, spec.values(compiler.count_waypoints(spec)))
    assert len(polls) >= len(regions) > 0
    with pytest.raises(Stopped), stops_when(lambda: True):
        compiler.find_regions(spec, spec.values(compiler.count_waypoints(spec)))


def test_a_path_that_leaves_the_reach_is_none(held: tuple[PhaseCompiler, TaskPhase]) -> None:
    compiler, spec = held

    assert spec.hand is not None
    line = replace(spec.hand, offset=np.array([0.0, 0.0, 4.0]), leaves=True)
    guess = np.concatenate([compiler.solver.body.nominal[: compiler.columns[0]], spec.first])
    (at,) = bring_tool(compiler.solver.body, spec.frames, guess[None], _list_prescribed(compiler))
    assert follow_tool(compiler.solver.body, (line,), np.tile(at, (5, 1)), _list_prescribed(compiler)) is None


@pytest.mark.parametrize(("length_m", "is_led"), [(0.9e-3, True), (1.1e-3, False)])
def test_a_path_that_misses_a_place_by_more_than_a_millimetre_is_none(
    held: tuple[PhaseCompiler, TaskPhase], length_m: float, is_led: bool
) -> None:
    compiler, spec = held
    body = compiler.solver.body
    assert spec.hand is not None
    guess = np.concatenate([body.nominal[: compiler.columns[0]], spec.first])
    (at,) = bring_tool(body, spec.frames, guess[None], _list_prescribed(compiler))
    line = replace(spec.hand, offset=np.array([0.0, length_m, 0.0]), leaves=True)
    # no joint may move: the tool stays where the line begins
    path = follow_tool(body, (line,), np.tile(at, (2, 1)), np.ones(compiler.robot.n, dtype=bool))
    assert (path is not None) is is_led


def test_a_line_gets_more_waypoints_where_its_certificate_asks_for_them(
    opening: tuple[PhaseCompiler, tuple[TaskPhase, ...]],
) -> None:
    compiler, specs = opening
    phases, stuck = PhaseSequence(compiler.solver, compiler.mechanism, specs).plan(compiler.solver.body.nominal)
    assert stuck is None
    line, last = specs[-1].hand, phases[-1]
    assert line is not None
    assert line.is_line
    denser = np.insert(last.q, 3, 0.7 * last.q[2] + 0.3 * last.q[3], axis=0)
    again = last.solve_again(denser)
    assert again is not None
    assert again.is_feasible
    shares = []
    for q in again.q:
        poses = locate_links(compiler.solver.body.engine, q, [line.tool, str(line.link)])
        place = np.linalg.inv(poses[str(line.link)]) @ poses[line.tool][:, 3]
        shares.append((place[:3] - line.place) @ line.offset / (line.offset @ line.offset))
        assert np.linalg.norm(place[:3] - line.place - shares[-1] * line.offset) < 1e-3
    np.testing.assert_allclose(np.array(shares)[[0, 1, 2, 4, 5]], np.linspace(0.0, 1.0, 5), atol=0.02)
    assert shares[3] == pytest.approx(0.575, abs=0.05)


def square_region(region: PlannedRegion, middle: np.ndarray, half: float, shift_m: float, last: int) -> PlannedRegion:
    """A square for all waypoints."""
    corners = middle + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return replace(region, first=0, last=last, shift_m=shift_m, region=replace(region.region, vertices=corners))


# Position servos want 45 mm, a small region gives three quarters of its depth less the shift, and the margin of the
# plan with its reserves is kept at least.
@pytest.mark.parametrize(
    ("half", "shift_m", "inside_m"),
    [(0.2, 0.0, 0.045), (0.2, 0.02, 0.065), (0.06, 0.02, 0.02 + 0.75 * 0.04), (0.025, 0.0, None)],
)
def test_a_path_is_brought_inside_as_far_as_servos_want_or_a_small_region_allows_and_no_farther(
    held: tuple[PhaseCompiler, TaskPhase], half: float, shift_m: float, inside_m: float | None
) -> None:
    compiler, spec = held
    body = compiler.solver.body
    assert spec.hand is not None
    guess = np.concatenate([body.nominal[: compiler.columns[0]], spec.first])
    path = np.repeat(bring_tool(body, spec.frames, guess[None], _list_prescribed(compiler)), 3, axis=0)
    least = body.aims.balance_margin + BALANCE_RESERVE + INSIDE_RESERVE
    wanted = least + shift_m if inside_m is None else inside_m
    # the centre of mass is 5 mm less inside than that at one edge, and far from the others
    at = body.engine.place(path).com[0, :2]
    middle = at - [half - wanted + 0.005, 0.0]
    (any_region, *_) = compiler.find_regions(spec, spec.values(3))
    region = square_region(any_region, middle, half, shift_m, last=2)
    is_fixed = np.array([True, False, False])
    inside = follow_in_balance(body, spec.frames, path, [region], is_fixed, _list_prescribed(compiler))
    margin = region.region.polygon.margin(body.engine.place(inside).com[:, :2])
    np.testing.assert_allclose(margin, [wanted - 0.005, wanted, wanted], atol=5e-4)


def test_waypoints_between_equal_ones_of_an_earlier_motion_are_where_the_mechanism_is_not_where_the_time_is(
    held: tuple[PhaseCompiler, TaskPhase],
) -> None:
    compiler, spec = held
    (moving,) = spec.moving
    column, rates = int(compiler.columns[moving]), np.linspace(-1.0, 1.0, compiler.robot.n)
    for ends in ((spec.first, spec.last), (spec.last, spec.first)):  # opened, and shut
        # the robot's joints follow the leaf, which the earlier motion moves slowly at first
        shares = np.linspace(0.0, 1.0, 9)[:, None] ** 2
        leaf = (1.0 - shares) * ends[0][moving] + shares * ends[1][moving]
        known = leaf * rates
        known[:, compiler.columns] = (1.0 - shares) * ends[0] + shares * ends[1]
        again = replace(spec, first=ends[0], last=ends[1], joints={})
        sixth = replace(compiler, earlier=EarlierMotion({spec.name: known})).with_hints(turn_step=np.deg2rad(6.5))
        q = sixth.resample_earlier(again)
        assert q is not None
        np.testing.assert_allclose(q[:, compiler.columns], np.linspace(*ends, 6), atol=1e-12)
        own = np.setdiff1d(np.arange(compiler.robot.n), compiler.columns)
        np.testing.assert_allclose(q[:, own], (q[:, [column]] * rates)[:, own], atol=1e-12)


def test_loads_of_one_tool_act_together_and_those_of_two_do_not() -> None:
    one, two = ([HandLoad(tool, "leaf", np.zeros(3), np.array([1.0, 0.0, k])) for k in range(3)] for tool in "ab")
    # all of one tool, and both tools' mixed up
    for loads, count in ((one, 7), ([one[0], two[0], one[1], two[1], one[2]], 7 + 3)):
        together = list(list_together(loads))
        sets = [{id(load) for load in some} for some in together]
        of_tools = ([load for load in loads if load.tool == tool] for tool in "ab")
        expected = [{id(load) for load in some} for of in of_tools for n in (1, 2, 3) for some in combinations(of, n)]
        assert len(sets) == len(expected) == count
        assert all(some in sets for some in expected)
        assert [len(some) for some in together] == sorted(len(some) for some in together)
