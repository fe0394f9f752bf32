"""Levers and cranks of valves: the peg pushes beside the bar or the grip, within the stops; measured independently."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import CONFIDENT, LeverDetection, Reach, detect, make_view, perceive, select_turnable
from perception.detect.valve.lever_valve import find_grip
from perception.sightlines import Sightlines, index_of
from perception.simulate import Pose, Room, Scanner, scan
from perception.simulate.scenes.valves import LeverValve
from service.demands.hands import FREE_BEFORE, HANDS, PEG_FROM_END, PEG_RADIUS
from service.demands.valve.given import read_given_valve
from service.demands.valve.peg import PEG_SPACE, PegPlace, place_peg
from service.demands.valve.wheel import STOP_ROUNDING, make_wheel, make_wheel_mechanism
from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request
from service.request.tasks.valve import ValveRequest
from service.result.result import PlanResult, Verdict
from service.scan.scene_file import lever_from_sizes
from service.tasks.valve.plan import refuse_lever

DEEPEST, FARTHEST = 2e-3, 2e-3  # overlap, and gap of the pressed bar [m]
LEVER = {
    "centre": [0.7, -0.25, 1.1], "axis": [-1.0, 0.0, 0.0], "turn_deg": 90.0, "hand": "right",
    "lever": {"direction": [0.0, 0.2, 1.0], "length_m": 0.24},
}  # fmt: skip
TILT = np.deg2rad(34.0)
TILTED = (-np.cos(TILT), 0.05, np.sin(TILT))
CRANK = {
    "centre": [0.66, -0.2, 1.0], "axis": [-np.cos(TILT), 0.0, np.sin(TILT)], "turn_deg": -180.0, "hand": "right",
    "lever": {"direction": [0.0, 1.0, 0.0], "length_m": 0.16, "grip_m": 0.1},
}  # fmt: skip


def request_of(valve: dict) -> dict:
    return {"robot": {"name": "atlas"}, "start": {"posture": "reach_ready"}, "task": {"valve": valve}}


@pytest.fixture(scope="module")
def turned() -> PlanResult:
    return plan(parse_request(request_of(LEVER)))


def measure_gaps(result: PlanResult, valve: dict) -> tuple[np.ndarray, np.ndarray]:
    """Gaps between the right peg and the bar, a round rod, at samples of the turn; and the bar's angles [m, rad]."""
    motion = result.motion
    part = next(part for part in motion.phases if part.name == "turn")
    model, data = motion.robot.model, motion.robot.model.createData()
    axis = np.array(valve["axis"]) / np.linalg.norm(valve["axis"])
    along = np.array(valve["lever"]["direction"])
    along = along - (along @ axis) * axis
    along /= np.linalg.norm(along)
    across = np.cross(axis, along)
    gaps, angles = [], []
    for q in motion.curve(np.linspace(part.first, part.last, 80)):
        pin.framesForwardKinematics(model, data, q)
        first, last = (data.oMf[model.getFrameId(f"r_{name}")].translation for name in ("stub", "tool"))
        rod = first + np.linspace(0.0, 1.0, 200)[:, None] * (last - first) - valve["centre"]
        bar = np.linspace(0.0, valve["lever"]["length_m"], 400)[:, None] * (
            np.cos(q[-1]) * along + np.sin(q[-1]) * across
        )
        apart = np.linalg.norm(rod[:, None] - bar[None], axis=2).min()
        gaps.append(apart - PEG_RADIUS - 0.013)
        angles.append(q[-1])
    return np.array(gaps), np.array(angles)


def test_the_peg_stays_at_the_bar_all_the_way_to_the_stop(turned):
    assert turned.verdict is Verdict.CERTIFIED, turned.explanation
    assert turned.figures["turned_deg"] == pytest.approx(90.0, abs=1.0)
    gaps, angles = measure_gaps(turned, LEVER)
    assert gaps.min() >= -DEEPEST
    assert gaps.max() <= FARTHEST
    assert angles.min() >= -STOP_ROUNDING
    assert angles.max() <= 0.5 * np.pi + STOP_ROUNDING
    assert any("assumed to stop 0 deg clockwise and 90 deg counter-clockwise" in note for note in turned.notes)


def test_a_crank_on_a_tilted_axis_is_turned_by_its_grip():
    result = plan(parse_request(request_of(CRANK)))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.figures["turned_deg"] == pytest.approx(-180.0, abs=1.0)
    assert any("crank 0.160 m long with a grip of 0.100 m" in note for note in result.notes)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6), length=st.floats(0.09, 0.5), radius=st.floats(0.005, 0.025),
    grip=st.sampled_from([0.0, 0.06, 0.12]), sense=st.sampled_from([-1.0, 1.0]),
)  # fmt: skip
def test_a_peg_is_placed_on_the_side_that_it_pushes(seed, length, radius, grip, sense):
    rng = np.random.default_rng(seed)
    axis, direction = rng.normal(size=(2, 3))
    lever = lever_from_sizes(rng.normal(size=3), axis, direction, length, radius, grip)
    wheel = make_wheel(lever, ValveRequest(turn_deg=45.0 * sense))
    held = place_peg(wheel, HANDS["right"], wheel.spokes[0].angle, sense)
    if isinstance(held, str):
        assert "the lever" in held
        return
    assert isinstance(held, PegPlace)
    local = lever.frame @ held.place
    half = max(radius, lever.grip_radius) if grip else radius
    np.testing.assert_allclose(held.push, sense * lever.frame[1], atol=1e-9)
    assert -sense * local[1] == pytest.approx(half + PEG_RADIUS + PEG_SPACE)
    assert local[0] <= length + 1e-9
    assert held.arm == pytest.approx(local[0])
    tip, front = local[2] - PEG_FROM_END, local[2] + FREE_BEFORE
    assert tip < (grip - 0.02 if grip else 0.0)  # the rod reaches past the bar, or along the grip
    assert front > wheel.front
    assert lever.frame[1] @ held.offset * -sense > 0.0
    assert held.offset @ wheel.axis > 0.0


def test_a_lever_turns_between_its_stops_alone():
    lever = lever_from_sizes(np.zeros(3), np.array([-1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.2, 0.01, 0.0)
    for more, low, high in (
        ({"turn_deg": 60.0}, 0.0, 90.0), ({"turn_deg": -60.0}, -90.0, 0.0), ({"sense": "unknown"}, -90.0, 90.0),
        ({"turn_deg": 60.0, "stuck": True}, -90.0, 90.0), ({"turn_deg": 60.0, "stops_deg": (-10.0, 70.0)}, -10.0, 70.0),
    ):  # fmt: skip
        wheel = make_wheel(lever, ValveRequest(**more))
        (joint,) = make_wheel_mechanism(wheel, 1.0).joints
        assert np.rad2deg(wheel.stops) == pytest.approx([low, high])
        assert (joint.lower, joint.upper) == pytest.approx(
            (wheel.stops[0] - STOP_ROUNDING, wheel.stops[1] + STOP_ROUNDING)
        )
    assert "expected turn_deg within them" in refuse_lever(lever, ValveRequest(turn_deg=180.0))
    assert "expected hook" in refuse_lever(lever, ValveRequest(turn_deg=90.0, mode="grasp"))
    assert refuse_lever(lever, ValveRequest(turn_deg=90.0)) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"turn_deg": 120.0}, "a lever stops after a quarter turn"),
        ({"radius": 0.2}, "radius and lever exclude each other"),
        ({"stops_deg": [0.0, 60.0]}, "expected angles that contain 0 and turn_deg"),
        ({"lever": {"direction": [1.0, 0.0, 0.0], "length_m": 0.2}}, "lever.direction is along axis"),
        ({"lever": {"direction": [0.0, 0.0, 1.0], "length_m": 0.2, "grip_m": 0.01}}, "grip_m is less than 0.04 m"),
    ],
)
def test_what_a_lever_cannot_be_is_said_in_one_line(change, words):
    with pytest.raises(RequestError, match=words):
        parse_request(request_of({**LEVER, **change}))


def test_the_lever_of_a_request_is_the_one_that_is_planned_for():
    valve = read_given_valve(ValveRequest(**{**LEVER, "lever": {"direction": (0.3, 0.2, 1.0), "length_m": 0.24}}))
    assert isinstance(valve, LeverDetection)
    assert valve.direction @ valve.axis == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(RequestError, match="come together"):
        read_given_valve(ValveRequest(lever={"direction": (0.0, 0.0, 1.0), "length_m": 0.2}, turn_deg=90.0))


@pytest.mark.parametrize(
    ("grip", "axis", "direction"),
    [
        (0.0, (-1.0, 0.05, 0.1), (0.1, -0.5, 0.8)), (0.1, TILTED, (0.0, -0.97, 0.2)),
    ],
    ids=["lever", "crank along its pipe"],
)  # fmt: skip
def test_a_scan_shows_a_lever_whose_points_are_no_obstacle(grip, axis, direction):
    lever = LeverValve((0.72, 0.05, 1.1), axis, direction, 0.24, pipe_direction=(0.0, 1.0, 0.0), grip=grip)
    placed = lever.build()
    scanner = Scanner(n_beams=361, fan_deg=90.0, n_lines=110)
    cloud = scan([*Room(wall_x=1.1).meshes(), *placed.meshes], Pose((0.12, 0.0, 1.6), pitch=0.3), scanner, seed=1)
    seen = perceive(cloud, reach=Reach(radius=2.0), kinds=("turnable",))
    best = select_turnable(seen.detections)[0]
    true = placed.truth[0].pose_world_object
    assert isinstance(best, LeverDetection)
    assert best.confidence >= CONFIDENT
    assert np.linalg.norm(best.centre - true[:3, 3]) <= 0.012
    assert best.axis @ true[:3, 2] >= np.cos(np.deg2rad(3.0))
    assert best.direction @ true[:3, 0] >= np.cos(np.deg2rad(3.0))
    assert abs(best.length - 0.24) <= 0.015
    assert abs(best.grip_length - grip) <= 0.02
    middle = true[:3, 3] + 0.15 * true[:3, 0]
    inside = [
        piece.name
        for piece in seen.scene.pieces
        if np.linalg.norm(piece.vertices - middle, axis=1).min() < 0.03 and piece.name != "floor"
    ]
    assert not inside


@pytest.mark.parametrize("n_through", [0, 6])
def test_of_a_grip_that_points_at_the_sensor_the_end_is_enough_unless_rays_pass_behind_it(n_through):
    """The bar lies along x, its grip along z to the sensor; only its end and the bar's end return rays."""
    rng = np.random.default_rng(4)
    sensor = np.array([0.2, 0.0, 1.5])
    cap = np.column_stack(
        [0.2 + rng.uniform(-0.01, 0.01, 40), rng.uniform(-0.01, 0.01, 40), np.linspace(0.1, 0.12, 40)]
    )
    foot = np.column_stack([rng.uniform(0.15, 0.185, 20), rng.uniform(-0.01, 0.01, 20), np.full(20, 0.015)])
    behind = np.column_stack([np.full(n_through, 0.2), np.linspace(-0.3, -0.35, n_through), np.zeros(n_through)])
    side = np.tile([0.2, 0.6, 0.12], (n_through, 1))  # seen through the gap from beside
    points = np.concatenate([cap, foot])
    ends = np.concatenate([points, behind])
    starts = np.concatenate([np.tile(sensor, (len(points), 1)), side])
    length = np.linalg.norm(ends - starts, axis=1)
    index = index_of(Sightlines(starts, (ends - starts) / length[:, None], length))
    tall, along = find_grip(points, np.eye(4), 0.2, 0.012, 0.002, index)
    assert (tall > 0.1) is (n_through == 0)
    assert along == pytest.approx(0.2, abs=0.005)


def test_a_wheel_is_no_lever():
    view = make_view(scan([*Room(wall_x=1.1).meshes()], Pose((0.12, 0.0, 1.6), pitch=0.3), Scanner(n_lines=60), seed=1))
    assert not detect("turnable", view)
