"""A tool brought to its place, and led along with a mechanism, before anything is optimised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from given_doors import door_request

from costs.kinematics import locate_links
from costs.stopping import Stopped, stops_when
from service.body.monitor import Monitor
from service.body.whole_body import RESERVE_M
from service.demands.door import DoorChoice, make_door_phases
from service.demands.door_demand import make_door, measure_peg, read_given_door
from service.demands.hands import list_robot_hands
from service.demands.phase_spec import PhaseSpec
from service.planner import _make_solver
from service.request.file import parse_request
from service.setup.prepare import prepare
from service.tasks.held_tool import INSIDE_SHARE, bring_tool, follow_in_balance, follow_tool
from service.tasks.phase_compiler import PhaseCompiler
from service.tasks.sequence import PhaseSequence, add_mechanism

ANGLE = np.deg2rad(30.0)


@pytest.fixture(scope="module")
def opening() -> tuple[PhaseCompiler, tuple[PhaseSpec, ...]]:
    """A robot at a pulled door, and the phases in which its peg opens the leaf by 30 degrees."""
    request = parse_request(door_request("pull", "pull", x=0.75))
    setup = prepare(request)
    assert request.task is not None
    assert request.task.door is not None
    door = make_door(request.task.door, read_given_door(request.task.door, setup.start[:3]))
    solver = add_mechanism(_make_solver(setup, Monitor(60.0), None), door.mechanism)
    hand = next(hand for hand in list_robot_hands(solver.body.robot) if hand.side == "left")
    choice = DoorChoice(hand, measure_peg(solver.body.robot, hand), 0.0, 1.0, ANGLE)
    return PhaseCompiler(solver, door.mechanism, {}), make_door_phases(door, choice)


@pytest.fixture(scope="module")
def held(opening: tuple[PhaseCompiler, tuple[PhaseSpec, ...]]) -> tuple[PhaseCompiler, PhaseSpec]:
    """The phase in which the leaf moves."""
    compiler, specs = opening
    return compiler, next(spec for spec in specs if spec.is_anchor)


def _list_prescribed(compiler: PhaseCompiler) -> np.ndarray:
    prescribed = np.zeros(compiler.robot.n, dtype=bool)
    prescribed[compiler.columns] = True
    return prescribed


def _measure_off(compiler: PhaseCompiler, spec: PhaseSpec, q: np.ndarray) -> tuple[float, float]:
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


def test_a_tool_is_brought_to_its_place_from_far_away(held: tuple[PhaseCompiler, PhaseSpec]) -> None:
    compiler, spec = held
    body = compiler.solver.body
    assert spec.hand is not None
    guess = np.concatenate([body.nominal[: compiler.columns[0]], spec.first])
    before, _ = _measure_off(compiler, spec, guess)
    (found,) = bring_tool(body, spec.hand, guess[None], _list_prescribed(compiler))
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


def test_a_place_out_of_reach_leaves_the_guess(held: tuple[PhaseCompiler, PhaseSpec]) -> None:
    compiler, spec = held
    assert spec.hand is not None
    far = np.array(compiler.solver.body.nominal)

    beyond = replace(spec.hand, place=spec.hand.place + np.array([5.0, 0.0, 0.0]))
    (found,) = bring_tool(compiler.solver.body, beyond, far[None], _list_prescribed(compiler))
    np.testing.assert_array_equal(found, far)


@pytest.mark.parametrize("is_backwards", [False, True])
def test_a_path_follows_the_mechanism(held: tuple[PhaseCompiler, PhaseSpec], is_backwards: bool) -> None:
    compiler, spec = held
    body, count = compiler.solver.body, spec.n_waypoints
    assert spec.hand is not None
    end = -1 if is_backwards else 0
    values = spec.values(count)
    guess = np.concatenate([body.nominal[: compiler.columns[0]], values[end]])
    (at,) = bring_tool(body, spec.hand, guess[None], _list_prescribed(compiler))
    start = np.tile(at, (count, 1))
    start[:, compiler.columns] = values
    path = follow_tool(body, spec.hand, start, _list_prescribed(compiler), is_backwards=is_backwards)
    assert path is not None
    np.testing.assert_array_equal(path[end], at)
    np.testing.assert_array_equal(path[:, compiler.columns], values)
    assert max(_measure_off(compiler, spec, start[-1 - end])) > 0.1
    for q in path:
        assert max(_measure_off(compiler, spec, q)) < 1.5e-3
    assert np.abs(np.diff(path, axis=0)).max() < 0.5


def test_a_path_that_leans_is_brought_into_the_regions_of_its_loads(held: tuple[PhaseCompiler, PhaseSpec]) -> None:
    compiler, spec = held
    body, count = compiler.solver.body, spec.n_waypoints
    assert spec.hand is not None
    values = spec.values(count)
    guess = np.concatenate([body.nominal[: compiler.columns[0]], values[0]])
    (at,) = bring_tool(body, spec.hand, guess[None], _list_prescribed(compiler))
    start = np.tile(at, (count, 1))
    start[:, compiler.columns] = values
    path = follow_tool(body, spec.hand, start, _list_prescribed(compiler))
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
    inside = follow_in_balance(body, spec.hand, path, regions, is_fixed, prescribed)
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


def test_work_can_stop_before_every_region(held: tuple[PhaseCompiler, PhaseSpec]) -> None:
    compiler, spec = held
    polls = list[int]()
    with stops_when(lambda: bool(polls.append(1))):
        regions = compiler.find_regions(spec, spec.values(spec.n_waypoints))
    assert len(polls) >= len(regions) > 0
    with pytest.raises(Stopped), stops_when(lambda: True):
        compiler.find_regions(spec, spec.values(spec.n_waypoints))


def test_a_path_that_leaves_the_reach_is_none(held: tuple[PhaseCompiler, PhaseSpec]) -> None:
    compiler, spec = held

    assert spec.hand is not None
    line = replace(spec.hand, offset=np.array([0.0, 0.0, 4.0]), leaves=True)
    guess = np.concatenate([compiler.solver.body.nominal[: compiler.columns[0]], spec.first])
    (at,) = bring_tool(compiler.solver.body, spec.hand, guess[None], _list_prescribed(compiler))
    assert follow_tool(compiler.solver.body, line, np.tile(at, (5, 1)), _list_prescribed(compiler)) is None


def test_a_line_gets_more_waypoints_where_its_certificate_asks_for_them(
    opening: tuple[PhaseCompiler, tuple[PhaseSpec, ...]],
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
