"""Doors and valves of the benchmark: valid requests, equal for equal seeds, and leaves that open freely."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from benchmarks.task_cases import N_DOORS, N_VALVES, make_doors, make_valves
from costs.robot import load_robot, with_mechanism
from service.body.whole_body import Aims, WholeBody
from service.request.file import parse_request
from service.setup.prepare import prepare
from service.tasks.door_sweep import find_blocked_opening
from service.tasks.door_task import find_door

ROBOT = load_robot("atlas")


def test_cases_are_valid_and_the_same_for_the_same_seed() -> None:
    doors, valves = list(make_doors(N_DOORS, 3, 60.0)), list(make_valves(N_VALVES, 3))
    assert doors == list(make_doors(N_DOORS, 3, 60.0))
    assert doors != list(make_doors(N_DOORS, 4, 60.0))
    for case in (*doors, *valves):
        parse_request(case.request)
    assert len({case.name for case in (*doors, *valves)}) == N_DOORS + N_VALVES
    assert set(Counter(case.group for case in doors).values()) == {N_DOORS // 6}
    radii = [case.request["task"]["valve"]["radius"] for case in valves]
    assert (min(radii), max(radii)) == (0.1, 0.25)


@pytest.mark.parametrize("number", range(6))
def test_walls_and_frame_let_the_leaf_open(number: int) -> None:
    case = list(make_doors(number + 1, 0, 60.0))[number]
    request = parse_request(case.request)
    setup = prepare(request, robot=ROBOT, checks_start=False)
    assert request.task is not None
    assert request.task.door is not None
    found = find_door(setup, request.task.door)
    assert not isinstance(found, str)
    door, _ = found
    mechanism = door.mechanism
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims())
    robot = with_mechanism(setup.robot, mechanism.joints)
    body = body.with_robot(robot, np.concatenate([setup.start, mechanism.start]))
    met = find_blocked_opening(body, door, float(np.deg2rad(60.0)))
    assert not any(blocked.is_piece for blocked in met)
