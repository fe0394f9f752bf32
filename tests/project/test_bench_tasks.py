"""Doors and valves of the benchmark: valid requests, equal for equal seeds, and leaves that open freely."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from benchmarks.tasks.given_cases import N_DOORS, N_VALVES, make_doors, make_valves
from benchmarks.tasks.scanned import displace, make_request
from benchmarks.tasks.scanned_cases import make_scanned_doors, make_scanned_valves
from costs.robot import load_robot, with_mechanism
from service.body.aims import Aims
from service.body.whole_body import WholeBody
from service.request.file import parse_request
from service.setup.prepare import prepare
from service.tasks.door.plan import find_door
from service.tasks.door.sweep import find_blocked_opening

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


def test_scanned_cases_are_valid_and_the_same_for_the_same_seed() -> None:
    valves, doors = list(make_scanned_valves(8, 3)), list(make_scanned_doors(16, 3))
    for made, again in ((valves, make_scanned_valves(8, 3)), (doors, make_scanned_doors(16, 3))):
        assert [(case.name, case.true, case.seen) for case in made] == [(c.name, c.true, c.seen) for c in again]
    assert [case.group for case in valves[:4]] == ["hook", "lever", "grasp", "crank"]
    for case in (*valves, *doors):
        for task in (case.true, case.seen):
            parse_request(make_request(case, task, 0))
    axes = [np.array(case.true["valve"]["axis"]) for case in valves if case.group == "crank"]
    assert [float(np.rad2deg(np.arcsin(axis[2]))) for axis in axes] == pytest.approx([34.0, 34.0], abs=0.01)
    bars = [case for case in doors if case.group == "push push_bar"]
    assert [case.seen["door"]["hinge"] for case in bars] == ["right", "left"]


@pytest.mark.parametrize("kind", ["valve", "door"])
def test_an_object_is_moved_by_as_much_as_stated(kind: str) -> None:
    case = next(iter(make_scanned_valves(2, 1) if kind == "valve" else make_scanned_doors(1, 1)))
    moved = displace(case.true, np.random.default_rng(0))[kind]
    true = case.true[kind]
    if kind == "door":
        shifts = [
            np.subtract(moved[a][b], true[a][b]) for a, b in (("leaf", "hinge"), ("leaf", "edge"), ("handle", "centre"))
        ]
        np.testing.assert_allclose(shifts, np.tile(shifts[0], (3, 1)), atol=1e-12)
        assert np.linalg.norm(shifts[0]) == pytest.approx(0.01)
        assert shifts[0][2] == 0.0
        return
    assert np.linalg.norm(np.subtract(moved["centre"], true["centre"])) == pytest.approx(0.01)
    assert 0.0 < np.rad2deg(np.arccos(np.dot(moved["axis"], true["axis"]))) <= 3.0 + 1e-6


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
