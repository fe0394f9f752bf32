"""Forces of a hold: the pressure of a peg, its friction, and what a bar draws along a leaf."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from given_doors import door_request

from costs.robot import load_robot
from service.demands.door.demand import read_given_door
from service.demands.door.door import Door
from service.demands.door.phases import PEG_ACROSS, PULL_TILT, DoorChoice, hold_handle, make_door_phases
from service.demands.hands import HANDS, PEG_RADIUS
from service.demands.valve.given import read_given_valve
from service.demands.valve.peg import place_peg
from service.demands.valve.strokes import list_peg_loads
from service.demands.valve.wheel import make_wheel
from service.request.fields import HAND_FRICTION
from service.request.file import parse_request

AXIS = np.array([-1.0, 0.0, 0.0])


def make_door(**request: object) -> Door:
    task = parse_request(door_request(**request)).task
    assert task is not None
    assert task.door is not None
    robot = load_robot("atlas")
    geometry = read_given_door(task.door, robot.postures["stand"][:3])
    assert geometry is not None
    release = float(np.deg2rad(task.door.release_deg))
    return Door(geometry, release, task.door.lever_nm, task.door.hinge_nm, task.door.push_bar_n)


def sum_moments(loads: tuple, point: np.ndarray, axis: np.ndarray) -> float:
    """Return the moment of forces that act at one point about an axis through the origin [N m]."""
    return float(np.cross(point, sum(load.force for load in loads)) @ axis)


@pytest.mark.parametrize("turn", [90.0, -90.0])
@pytest.mark.parametrize("spokes", [{}, {"spokes_deg": [10.0, 130.0, 250.0], "spoke_width_m": 0.016}])
def test_a_peg_presses_its_spoke_and_drags_it_outwards(turn: float, spokes: dict[str, object]) -> None:
    """Whatever the sense; with the friction at the spoke's face both together make the torque of the request."""
    valve = {"centre": [0.7, 0.1, 1.1], "axis": AXIS.tolist(), "radius": 0.15, "turn_deg": turn, **spokes}
    task = parse_request({"robot": {"name": "atlas"}, "task": {"valve": valve}}).task
    assert task is not None
    assert task.valve is not None
    wheel = make_wheel(read_given_valve(task.valve), task.valve)
    entry, sense = wheel.list_entries("hook")[0], float(np.sign(turn))
    held = place_peg(wheel, HANDS["left"], entry, sense)
    assert not isinstance(held, str)
    pressure, friction = loads = list_peg_loads(wheel, HANDS["left"], held, 10.0)
    assert np.linalg.norm(friction.force) == pytest.approx(HAND_FRICTION[1] * np.linalg.norm(pressure.force))
    assert abs(friction.force @ pressure.force) < 1e-9
    assert abs(friction.force @ wheel.axis) < 1e-9
    out = held.place - (held.place @ wheel.axis) * wheel.axis
    assert friction.force @ out > 0.9 * np.linalg.norm(friction.force) * np.linalg.norm(out)
    at_face = held.place + PEG_RADIUS * held.push
    torque = sense * sum_moments(loads, at_face, wheel.axis)
    if spokes:  # the face is behind the middle of the spoke, where friction helps: the pressure alone is enough
        assert sense * sum_moments((pressure,), held.place, wheel.axis) == pytest.approx(10.0)
        assert torque > 10.0
    else:
        assert torque == pytest.approx(10.0)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_bar_draws_a_peg_that_leans_along_the_leaf(sense: float) -> None:
    """At the largest lean the sum of both loads is square to the peg, and turns the leaf with the hinge's torque."""
    door = make_door(opens="pull", kind="pull")
    held = hold_handle(door, DoorChoice(HANDS["left"], 0.065, 0.0, sense, 0.5))
    on_leaf = held.on_leaf(0.0)
    turns, draws = loads = held.open_loads(on_leaf, presses=False)
    hinge = door.geometry.hinge_axis
    assert sum_moments((turns,), on_leaf.place, hinge) == pytest.approx(door.hinge_nm)
    assert sum_moments((draws,), on_leaf.place, hinge) == pytest.approx(0.0, abs=1e-9)
    assert draws.force @ held.axis > 0.0  # the bar would slip off the peg's end if the hand did not hold it
    angle = float(np.arctan2(np.linalg.norm(draws.force), np.linalg.norm(turns.force)))
    assert angle == pytest.approx(float(PEG_ACROSS + PULL_TILT))
    assert np.linalg.norm(sum(load.force for load in loads)) == pytest.approx(
        np.linalg.norm(turns.force) / np.cos(angle)
    )


def test_one_force_presses_a_bar_and_pushes_its_leaf() -> None:
    door = make_door(kind="push_bar")
    for stated in (67.0, 5.0):
        strong = replace(door, push_bar_n=stated)
        phases = make_door_phases(strong, DoorChoice(HANDS["left"], 0.065, 0.0, 1.0, 0.5))
        (load,) = next(phase for phase in phases if phase.name == "open").loads
        turning = door.hinge_nm / float(np.linalg.norm(load.place[:2]))
        assert np.linalg.norm(load.force) == pytest.approx(max(stated, turning))
