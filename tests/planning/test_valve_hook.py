"""The hook in a wheel, measured with geometry of its own: the peg on a spoke, and clear of everything else."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.demands.hands import FREE_BEFORE, HANDS, PEG_FROM_END, PEG_RADIUS
from service.demands.valve.given import read_given_valve
from service.demands.valve.peg import LEAST_RIM_SPACE, PEG_SPACE, PegPlace, place_peg
from service.demands.valve.strokes import find_count, find_least_count, find_net_turn, list_strokes
from service.demands.valve.wheel import GROWTH_M, make_wheel
from service.planner import plan
from service.request.file import parse_request
from service.request.tasks.valve import ValveRequest
from service.result.result import PlanResult, Verdict
from service.tasks.valve.plan import describe_valve

TUBE = 0.015  # half the thickness of a given rim [m]
DEEPEST, FARTHEST = 2e-3, 2e-3  # overlap, and gap of the pressed spoke [m]
SAMPLES = 150  # per phase


def make_request(rng: np.random.Generator, n_spokes: int, turn: float, **more: object) -> dict:
    """A random wheel before the robot, with its spokes."""
    tilt, yaw = np.deg2rad(rng.uniform(-15.0, 15.0, 2))
    axis = [-np.cos(tilt) * np.cos(yaw), -np.cos(tilt) * np.sin(yaw), np.sin(tilt)]
    spin = rng.uniform(0.0, 360.0)
    return {
        "centre": [0.68, float(rng.uniform(0.05, 0.2)), float(rng.uniform(1.0, 1.2))],
        "axis": [float(value) for value in axis],
        "radius": float(rng.uniform(0.12, 0.18)),
        "spokes_deg": [float(spin + 360.0 * k / n_spokes) for k in range(n_spokes)],
        "spoke_width_m": float(rng.uniform(0.012, 0.024)),
        "turn_deg": turn,
        **more,
    }


def plan_valve(valve: dict) -> PlanResult:
    return plan(
        parse_request({"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}, "task": {"valve": valve}})
    )


def measure(result: PlanResult, valve: dict, phase: str) -> list[dict]:
    """Gaps of the peg (a rod with flat ends, taken as a row of balls) at dense samples of a phase, by own geometry."""
    motion = result.motion
    part = next(part for part in motion.phases if part.name == phase)
    model, data = motion.robot.model, motion.robot.model.createData()
    side = "l" if any(getattr(target, "frame", "") == "l_peg" for target in part.targets) else "r"
    axis = np.array(valve["axis"]) / np.linalg.norm(valve["axis"])
    right = np.cross([0.0, 0.0, 1.0], axis)
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    rows = []
    for q in motion.curve(np.linspace(part.first, part.last, SAMPLES)):
        pin.framesForwardKinematics(model, data, q)
        first, last = (data.oMf[model.getFrameId(f"{side}_{name}")].translation for name in ("stub", "tool"))
        rod = first + np.linspace(0.0, 1.0, 120)[:, None] * (last - first) - valve["centre"]
        x, y, z = rod @ right, rod @ up, rod @ axis
        rim = np.hypot(np.hypot(x, y) - valve["radius"], z).min() - TUBE - PEG_RADIUS
        beside, faces = [], []
        for angle in np.deg2rad(valve["spokes_deg"]) + q[-1]:
            along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
            at = np.clip(along, 0.0, valve["radius"])
            spoke = np.sqrt((along - at) ** 2 + across**2 + z**2).min() - 0.5 * valve["spoke_width_m"] - PEG_RADIUS
            beside.append(spoke)
            inside = (np.abs(z) <= TUBE) & (along > 0.0)
            flat = np.abs(across[inside]).min(initial=np.inf) - 0.5 * valve["spoke_width_m"] - PEG_RADIUS
            faces.append((flat, across[inside].mean() if inside.any() else np.nan))
        rows.append({"rim": rim, "spokes": beside, "faces": faces, "tip": z[-1], "front": z[0]})
    return rows


@pytest.fixture(scope="module", params=[(0, 3, 90.0), (1, 5, -120.0)])
def turned(request: pytest.FixtureRequest) -> tuple[PlanResult, dict]:
    seed, n_spokes, turn = request.param
    valve = make_request(np.random.default_rng(seed), n_spokes, turn)
    return plan_valve(valve), valve


def test_on_random_wheels_the_peg_presses_a_spoke_and_overlaps_nothing_by_more_than_2_mm(turned):
    result, valve = turned
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    sense = np.sign(valve["turn_deg"])
    for phase in ("insert", "turn", "retract"):
        for row in measure(result, valve, phase):
            assert row["rim"] >= -DEEPEST
            assert min(row["spokes"]) >= -DEEPEST
            assert min(flat for flat, _ in row["faces"]) >= -DEEPEST
    rows = measure(result, valve, "turn")
    pressed = {int(np.argmin(row["spokes"])) for row in rows}
    assert len(pressed) == 1
    spoke = pressed.pop()
    for row in rows:
        assert row["faces"][spoke][0] <= FARTHEST  # it really touches
        assert sense * row["faces"][spoke][1] < 0.0  # from behind, in the sense of the turn
        assert row["tip"] < -0.01  # through the wheel
        assert row["front"] > TUBE  # the hand before it
        assert min(gap for k, gap in enumerate(row["spokes"]) if k != spoke) > GROWTH_M


def test_only_the_peg_may_touch_and_only_the_pressed_spoke_and_the_rim(turned):
    result, _ = turned
    for phase in result.motion.phases:
        touching = [allowance for allowance in phase.allowances if allowance.first.link in ("l_hook", "r_hook")]
        assert bool(touching) == (phase.name != "reach")
        others = {a.second.body for a in touching if "/rim/" not in str(a.second.body)}
        assert len(others) == (phase.name != "reach")
        assert all("/spoke/" in str(name) for name in others)
        assert all(allowance.depth <= GROWTH_M + DEEPEST for allowance in touching)
        assert not [a for a in phase.allowances if a.first.link in ("l_hand", "r_hand")]


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n_spokes=st.integers(2, 5),
    radius=st.floats(0.1, 0.35),
    width=st.floats(0.006, 0.02),
    sense=st.sampled_from([1.0, -1.0]),
)
def test_a_peg_is_placed_on_the_face_that_it_moves_towards(seed, n_spokes, radius, width, sense):
    valve = make_request(np.random.default_rng(seed), n_spokes, 90.0, radius=radius, spoke_width_m=width)
    wheel = make_wheel(read_given_valve(ValveRequest(**valve)), ValveRequest(**valve))
    for spoke in wheel.spokes:
        held = place_peg(wheel, HANDS["left"], spoke.angle, sense)
        if isinstance(held, str):
            assert "peg of the hook" in held
            continue
        assert isinstance(held, PegPlace)
        radial, tangential = wheel.radial(spoke.angle), sense * np.cross(wheel.axis, wheel.radial(spoke.angle))
        for share in np.linspace(0.0, 1.0, 9):
            middle = held.place + share * held.offset
            gap = -(middle @ tangential) - 0.5 * width - PEG_RADIUS
            assert gap == pytest.approx(PEG_SPACE, abs=1e-9) if share == 0.0 else gap > PEG_SPACE
            flat = np.hypot(middle @ radial, middle @ tangential)
            assert flat + PEG_RADIUS <= wheel.inner_radius - LEAST_RIM_SPACE + 1e-9
        assert held.arm == pytest.approx(held.place @ radial)
        np.testing.assert_allclose(held.push, tangential, atol=1e-9)
        assert held.place @ wheel.axis + FREE_BEFORE > wheel.front > held.place @ wheel.axis - PEG_FROM_END


def test_a_hub_that_leaves_no_room_for_the_peg_is_named():
    result = plan_valve({"centre": [0.68, 0.12, 1.1], "axis": [-1.0, 0.0, 0.0], "radius": 0.05})
    assert result.verdict is Verdict.NOT_FOUND
    assert "between hub and rim are" in result.explanation[0]


def test_unknown_spokes_are_said_and_known_ones_too():
    bare = {"centre": [0.68, 0.12, 1.1], "axis": [-1.0, 0.0, 0.0], "radius": 0.14}
    for spokes, words in (((), "a spoke is assumed to meet the side of the peg"), ((0.0, 180.0), "2 spokes are known")):
        request = ValveRequest(**bare, spokes_deg=spokes)
        valve = read_given_valve(request)
        assert any(words in note for note in describe_valve(valve, make_wheel(valve, request), request))


def list_turns(result: PlanResult) -> list[tuple[float, float, float]]:
    """Angles of the wheel at both ends of each phase that turns it [deg], and the largest force on it [N]."""
    motion = result.motion
    turns = []
    for phase in motion.phases:
        if phase.name.startswith("turn"):
            ends = np.rad2deg(motion.curve(np.array([phase.first, phase.last]))[:, -1])
            turns.append((*ends.tolist(), max(float(np.linalg.norm(load.force)) for load in phase.loads)))
    return turns


def test_an_unknown_sense_is_tried_a_little_each_way_from_both_sides_of_a_spoke():
    valve = make_request(np.random.default_rng(4), 4, 360.0, sense="unknown")
    result = plan_valve(valve)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    turns = list_turns(result)
    np.testing.assert_allclose([turn[:2] for turn in turns], [[0.0, 10.0], [10.0, -10.0]], atol=0.1)
    assert any("the sense of the turn is not known" in note for note in result.notes)
    for phase, sense in (("turn 1", 1.0), ("turn 2", -1.0)):
        for row in measure(result, valve, phase):
            flat, across = row["faces"][int(np.argmin(row["spokes"]))]
            assert flat <= FARTHEST
            assert sense * across < 0.0


def test_a_stuck_wheel_is_rocked_with_twice_the_torque_before_it_is_turned():
    valve = make_request(np.random.default_rng(4), 4, -60.0, stuck=True)
    result = plan_valve(valve)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    turns = list_turns(result)
    np.testing.assert_allclose([turn[:2] for turn in turns], [[0.0, 5.0], [5.0, -5.0], [-5.0, -60.0]], atol=0.1)
    assert turns[0][2] == pytest.approx(turns[1][2]) == pytest.approx(2.0 * turns[2][2])
    assert result.figures["turned_deg"] == pytest.approx(-60.0, abs=0.5)


@settings(max_examples=50, deadline=None)
@given(
    turn=st.floats(-1440.0, 1440.0).filter(lambda turn: abs(turn) >= 10.0),
    stuck=st.booleans(),
    sense=st.sampled_from(["given", "unknown"]),
    count=st.integers(1, 12),
)
def test_strokes_follow_each_other_and_end_where_the_request_has_it(turn, stuck, sense, count):
    request = ValveRequest(turn_deg=turn, stuck=stuck, sense=sense)
    strokes = list_strokes(request, count)
    assert strokes[0].first == 0.0
    assert all(one.last == pytest.approx(after.first) for one, after in pairwise(strokes))
    assert find_count(request, len(strokes)) == (1 if sense == "unknown" else count)
    assert np.rad2deg(strokes[-1].last) == pytest.approx(-10.0 * np.sign(turn) if sense == "unknown" else turn)
    assert find_net_turn(request) == pytest.approx(np.rad2deg(strokes[-1].last))
    assert max(abs(stroke.last - stroke.first) for stroke in list_strokes(request, find_least_count(request))) <= (
        2.0 * np.pi + 1e-9
    )
