"""A door's certificate: its leaf against the scene, its latch, what blocks it, and lies about it."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clocks import CountingClock
from given_doors import door_request
from shared_plans import plan_once, write_once, write_undrawn
from stranger import check_folder

from costs.robot import Mechanism
from service.demands.door.demand import make_door, read_given_door
from service.demands.door.door import Door
from service.demands.held_motion import Demands, HeldMotion, hold_to_request
from service.demands.recorded_task import MechanismDemand
from service.demands.task_demand import World
from service.planner import plan
from service.replay.replay import read_motion
from service.request.file import parse_request
from service.result.folder import read_result
from service.result.result import PlanResult, Verdict
from service.verify import Motion, Status, verify
from service.verify.hashes import promises_hash

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def opened() -> PlanResult:
    """A door with a lever, pushed open by 30 degrees."""
    return plan_once(parse_request(door_request()))


@dataclass(frozen=True)
class _DoorDemand:
    """The mechanism of a door request; its phases are not looked at."""

    mechanism: Mechanism

    def read_choices(self, recorded: Motion) -> tuple[tuple[Any, ...], tuple[str, ...]]:
        return (), ("not looked at",)

    def measure(self, motion: Motion) -> Mapping[str, float]:
        return {}

    def keep_choices(self, recorded: Motion) -> str:
        return "not looked at"


def _hold(opened: PlanResult, recorded: Motion) -> HeldMotion:
    request = opened.request.task.door
    geometry = read_given_door(request, opened.start[:3])
    assert geometry is not None
    release = float(np.deg2rad(request.release_deg))
    door = Door(geometry, release, request.lever_nm, request.hinge_nm, request.push_bar_n)
    world = World(opened.request, opened.robot, opened.start, opened.scene)
    demands = Demands(world, MechanismDemand(_DoorDemand(door.mechanism)))
    return hold_to_request(demands, recorded)


def test_the_latch_and_the_leaf_are_part_of_the_certificate(opened: PlanResult) -> None:
    motion, certificate = opened.motion, opened.certificate
    assert motion is not None
    assert certificate is not None
    assert [release.joint for release in motion.releases] == ["door_opening"]
    assert [check.ok for check in certificate.checks if check.name == "release.door_opening"] == [True]
    movers = {name for pair in certificate.stretches.pairs for name in pair}
    assert {"door/leaf/leaf", "floor"} <= movers
    neighbours = {
        (str(allowance.first), str(allowance.second)): allowance.depth for allowance in motion.phases[0].allowances
    }
    assert neighbours["door/leaf/leaf", "left wall"] == pytest.approx(3e-3)
    assert neighbours["door/leaf/leaf", "floor"] == pytest.approx(3e-3)
    assert neighbours["door/leaf/rose", "door/handle/neck"] > 0.01


def test_a_lever_seen_a_little_above_its_rest_is_at_rest() -> None:
    request = parse_request(door_request()).task.door
    geometry = read_given_door(request, np.zeros(3))
    assert geometry is not None
    for turn, ajar, start in ((-0.007, -0.004, [0.0, 0.0]), (0.3, 0.2, [0.2, 0.3])):
        door = make_door(request, replace(geometry, handle_turn=turn, ajar=ajar))
        assert door.mechanism.start == pytest.approx(start)


def test_without_its_allowances_the_neck_in_its_rose_is_no_proof(opened: PlanResult) -> None:
    motion = opened.motion
    assert motion is not None
    phases = tuple(
        replace(phase, allowances=tuple(a for a in phase.allowances if a.first.owner != "mechanism"))
        for phase in motion.phases
    )
    certificate = verify(replace(motion, phases=phases))
    assert certificate.status is Status.VIOLATED
    assert any(set(c.where.names) == {"door/leaf/rose", "door/handle/neck"} for c in certificate.checks if c.where)


def test_a_result_file_keeps_releases_and_joints(opened: PlanResult, tmp_path: Path) -> None:
    folder = write_undrawn(opened, tmp_path / "out")
    data = read_result(folder)
    assert data["releases"] == [
        {
            "joint": "door_opening",
            "latch": "door_handle",
            "latch_at": pytest.approx(np.deg2rad(25.0), abs=0.1),
            "free_beyond": pytest.approx(np.deg2rad(5.0)),
        }
    ]
    motion = read_motion(data, folder)
    assert motion.releases == opened.motion.releases
    assert data["certificate"]["promises_sha256"] == promises_hash(motion.phases, motion.releases)


def test_a_stranger_comes_to_the_same_verdict() -> None:
    folder = write_once(parse_request(door_request(open_deg=20.0, x=0.75, stays=True)))
    code, said = check_folder(folder)
    assert code == 0, said
    assert "ok   release of door_opening" in said


def test_a_stranger_finds_a_leaf_that_a_hand_would_drag_along(
    opened: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hand leaves the lever along the way of a leaf that bears 30 N m; a record says that it bears almost none."""
    monkeypatch.syspath_prepend(EXAMPLES)
    told = {name: importlib.import_module(name) for name in ("check_certificate", "replayed_motion", "replayed_pushes")}
    folder = write_undrawn(opened, tmp_path / "out")
    data = read_result(folder)
    replay = told["replayed_motion"].Replay(told["replayed_motion"].read_model(folder, data), data)
    names = [phase["name"] for phase in data["phases"]]
    (push,) = data["phases"][names.index("let the handle go")]["pushes"]
    (held,) = push["held"]
    for low, holds in ((-30.0, True), (-0.1, False)):
        held["low"] = low
        at = names.index("retract")
        answer = told["replayed_pushes"].leaving(replay, data, at, told["check_certificate"].closest)
        assert answer[0] is holds, answer


def _differences(held: HeldMotion) -> str:
    return "; ".join(held.differences)


def test_the_recorded_releases_and_neighbours_are_those_of_the_request(opened: PlanResult) -> None:
    motion = opened.motion
    assert motion is not None
    held = _hold(opened, motion)
    assert "releases" not in _differences(held)
    assert "allowances of phase 'reach'" not in _differences(held)
    assert held.motion.releases == motion.releases


LIES = {
    "the releases are removed": lambda motion: replace(motion, releases=()),
    "the lever releases at 3 deg": lambda motion: replace(
        motion, releases=(replace(motion.releases[0], latch_at=0.05),)
    ),
    "the leaf is free at once": lambda motion: replace(
        motion, releases=(replace(motion.releases[0], free_beyond=0.0),)
    ),
}


@pytest.mark.parametrize("name", LIES)
def test_a_record_with_other_releases_is_noticed_and_verified_with_those_of_the_request(
    opened: PlanResult, name: str
) -> None:
    assert opened.motion is not None
    held = _hold(opened, LIES[name](opened.motion))
    assert "the releases of the mechanism's latches are not those of the request" in held.differences
    assert held.motion.releases == opened.motion.releases


def test_a_lever_that_springs_back_early_is_refuted_with_the_requests_releases(opened: PlanResult) -> None:
    motion = opened.motion
    assert motion is not None
    column = motion.robot.joint_names.index("door_handle")
    positions, tangents = motion.curve.positions.copy(), motion.curve.tangents.copy()
    positions[:, column] = tangents[:, column] = 0.0
    curve = replace(motion.curve, positions=positions, tangents=tangents)
    lie = replace(motion, curve=curve, releases=())
    assert not any(check.name.startswith("release.") for check in verify(lie).checks)
    held = verify(_hold(opened, lie).motion)
    assert held.status is Status.VIOLATED
    assert any(check.name == "release.door_opening" and not check.ok for check in held.checks)


def _deeper(motion: Motion) -> Motion:
    phase = motion.phases[0]
    allowances = tuple(
        replace(a, depth=a.depth + 0.05) if a.first.owner == "mechanism" else a for a in phase.allowances
    )
    return replace(motion, phases=(replace(phase, allowances=allowances), *motion.phases[1:]))


def test_deeper_neighbours_are_noticed(opened: PlanResult) -> None:
    assert opened.motion is not None
    held = _hold(opened, _deeper(opened.motion))
    assert "allowances of phase 'reach' are not those of the request" in held.differences
    assert held.motion.phases[0].allowances == opened.motion.phases[0].allowances


CABINET = {"name": "cabinet", "type": "box", "size": [0.4, 0.4, 1.0], "position": [1.3, -0.2, 0.5]}


def test_a_piece_in_the_way_of_the_leaf_is_named_with_the_angle() -> None:
    result = plan(parse_request(door_request(open_deg=80.0, obstacles=(CABINET,))))
    assert result.verdict is Verdict.INFEASIBLE
    # Its corner (1.1, 0.0) lies in the plane of the leaf's back at atan2(0.4, 0.45) = 41.6 deg.
    assert result.explanation[0] == "the leaf meets cabinet at 42 deg of the 80 asked for"
    assert result.motion is not None
    assert result.certificate is not None
    assert result.certificate.status is Status.CERTIFIED
    assert 35.0 < result.figures["opening_deg"] < 41.6


def test_the_time_limit_of_a_best_attempt_leaves_the_verdict() -> None:
    request = parse_request(door_request(open_deg=80.0, obstacles=(CABINET,)))
    # The clock is read 200 times before the best attempt begins, and more than 600 times before its motion is made.
    result = plan(replace(request, options=replace(request.options, time_limit_s=0.4)), clock=CountingClock(1e-3))
    assert result.verdict is Verdict.INFEASIBLE
    assert result.explanation[0] == "the leaf meets cabinet at 42 deg of the 80 asked for"


def test_a_leaf_that_stops_before_the_piece_is_planned() -> None:
    result = plan(parse_request(door_request(open_deg=30.0, obstacles=(CABINET,))))
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_a_leaf_that_opens_over_a_foot_is_not_planned() -> None:
    result = plan(parse_request(door_request("pull", "pull", x=0.6, open_deg=60.0)))
    assert result.verdict is Verdict.NOT_FOUND
    assert result.explanation[0].startswith("the leaf meets l_foot at 3")
    assert "stand farther away" in result.explanation[0]
    met_at = float(result.explanation[0].split(" at ")[1].split(" deg")[0])
    assert 0.0 < met_at - result.figures["opening_deg"] < 10.0
