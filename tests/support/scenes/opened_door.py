"""Atlas at a pulled door, and the phases in which its peg opens the leaf."""

from __future__ import annotations

import numpy as np
from given_doors import door_request

from service.body.monitor import Monitor
from service.demands.door.demand import make_door, measure_peg, read_given_door
from service.demands.door.phases import DoorChoice, make_door_phases
from service.demands.hands import list_robot_hands
from service.demands.phase import TaskPhase
from service.planner import _make_solver
from service.request.file import parse_request
from service.setup.prepare import prepare
from service.tasks.phase_compiler import PhaseCompiler
from service.tasks.sequence import add_mechanism

ANGLE = np.deg2rad(30.0)


def compile_opening() -> tuple[PhaseCompiler, tuple[TaskPhase, ...]]:
    """The robot with the door, and the phases in which its left peg opens the leaf by 30 degrees."""
    request = parse_request(door_request("pull", "pull", x=0.75))
    setup = prepare(request)
    assert request.task is not None
    assert request.task.door is not None
    door = make_door(request.task.door, read_given_door(request.task.door, setup.start[:3]))
    solver = add_mechanism(_make_solver(setup, Monitor(60.0), None), door.mechanism)
    hand = next(hand for hand in list_robot_hands(solver.body.robot) if hand.side == "left")
    choice = DoorChoice(hand, measure_peg(solver.body.robot, hand), 0.0, 1.0, ANGLE)
    return PhaseCompiler(solver, door.mechanism), make_door_phases(door, choice)
