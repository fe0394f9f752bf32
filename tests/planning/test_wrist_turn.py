"""How far a wrist stays from its limits while a gripper turns a wheel, against the turn followed in small steps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from costs.kinematics import locate_links
from service.body.monitor import Monitor
from service.body.whole_body import WholeBody
from service.demands.hands import list_robot_hands
from service.demands.phase import TaskPhase
from service.demands.valve.given import read_given_valve
from service.demands.valve.strokes import TurnChoice, list_usable_entries, make_turn_phases
from service.demands.valve.wheel import Wheel, make_wheel
from service.planner import _make_solver
from service.request.file import parse_request
from service.request.tasks.valve import ValveRequest
from service.setup.prepare import prepare
from service.tasks.valve.turn import measure_wrist


def grasp(turn_deg: float) -> tuple[WholeBody, Wheel, ValveRequest]:
    """Atlas with grippers at a wheel that leans away from it."""
    valve = {"centre": [0.68, 0.12, 1.1], "axis": [-1.0, 0.2, 0.1], "radius": 0.14, "mode": "grasp"}
    request = parse_request(
        {
            "robot": {"name": "atlas", "hand": "gripper"},
            "start": {"posture": "reach_ready"},
            "task": {"valve": {**valve, "turn_deg": turn_deg}},
        }
    )
    assert request.task is not None
    assert request.task.valve is not None
    given = read_given_valve(request.task.valve)
    body = _make_solver(prepare(request), Monitor(60.0), None).body
    return body, make_wheel(given, request.task.valve), request.task.valve


def follow_wrist(body: WholeBody, wheel: Wheel, tool: str, column: int, phase: TaskPhase) -> np.ndarray:
    """The wrist's angle in small steps of a turn, with the hand's axis along the wheel's."""

    def turn_of(q: np.ndarray) -> Rotation:
        return Rotation.from_matrix(locate_links(body.engine, q, [tool])[tool][:3, :3])

    turned = body.nominal.copy()
    turned[column] += 0.1
    about_z = (turn_of(body.nominal).inv() * turn_of(turned)).as_rotvec()
    np.testing.assert_allclose(np.abs(about_z), [0.0, 0.0, 0.1], atol=1e-9)  # the last joint turns the hand about z
    pointed = turn_of(body.nominal)
    axis = pointed.apply([0.0, 0.0, 1.0])
    across = np.cross(axis, -wheel.axis)
    pointed = Rotation.from_rotvec(across / np.linalg.norm(across) * np.arccos(axis @ -wheel.axis)) * pointed
    assert phase.hand is not None
    held = Rotation.from_matrix(phase.hand.rotation)
    turns = []
    for angle in np.linspace(phase.first[0], phase.last[0], 60):
        off = (pointed.inv() * Rotation.from_rotvec(angle * wheel.axis) * held).as_rotvec()
        np.testing.assert_allclose(off[:2], 0.0, atol=1e-6)
        turns.append(off[2])
    return body.nominal[column] + np.sign(about_z[2]) * np.unwrap(turns)


def list_choices(wheel: Wheel, request: ValveRequest, body: WholeBody, count: int) -> Iterator[TurnChoice]:
    for hand in list_robot_hands(body.robot):
        for entry in list_usable_entries(wheel, hand, "grasp", np.sign(request.turn_deg)):
            for is_flipped in (False, True):
                yield TurnChoice(hand, entry, count, is_flipped)


@pytest.mark.parametrize(("turn_deg", "count"), [(100.0, 1), (-100.0, 1), (300.0, 3)])
def test_the_wrists_margin_is_the_least_of_the_turn_begun_at_the_best_of_its_whole_turns(turn_deg, count):
    body, wheel, request = grasp(turn_deg)
    margins = []
    for choice in list_choices(wheel, request, body, count):
        tool = choice.hand.tool
        column = body.robot.joint_names.index(f"{tool[0]}_arm_wry2")
        lower, upper = body.robot.lower[column], body.robot.upper[column]
        phases = [phase for phase in make_turn_phases(wheel, request, choice) if phase.moving]
        assert len(phases) == count
        expected = []
        for phase in phases:
            wrist = follow_wrist(body, wheel, tool, column, phase)
            begun = [wrist + whole for whole in (-2.0 * np.pi, 0.0, 2.0 * np.pi)]
            expected.append(max(min((w - lower).min(), (upper - w).min()) for w in begun))
        margins.append(measure_wrist(body, wheel, request, choice))
        assert margins[-1] == pytest.approx(min(expected), abs=1e-6)
    assert len(margins) >= 8
    assert np.ptp(margins) > 0.5
