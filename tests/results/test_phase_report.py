"""Each phase of a result has a status and checks of its own, and a lie about them is noticed."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from given_doors import door_request
from shared_plans import copy_undrawn

from scopt import Settings
from service.body.aims import Aims
from service.body.monitor import Monitor
from service.body.phases import PhaseSolver
from service.body.whole_body import WholeBody
from service.client.answers import summarize
from service.errors import ResultError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.folder import read_result
from service.result.output import write_result
from service.result.phase_report import PhaseReport, PhaseStatus, find_phase, report_phases
from service.result.result import PlanResult, Verdict
from service.result.result_json import summary_json
from service.setup.prepare import prepare
from service.tasks import plan_task
from service.verify import Basis, Certificate, Motion, Status
from service.wire.results import result_to_message

REACH = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}}


@pytest.fixture(scope="module")
def reached() -> PlanResult:
    """A reach of a single phase."""
    return plan(parse_request(REACH))


@pytest.fixture(scope="module")
def stuck(reached: PlanResult) -> PlanResult:
    """The same motion as the best attempt at a task that got no further."""
    return dataclasses.replace(
        reached, verdict=Verdict.NOT_FOUND, unsolved=("reach",), task_phases=("reach", "approach", "open")
    )


@pytest.fixture(scope="module")
def folder(reached: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(reached, tmp_path_factory.mktemp("reached") / "out").folder


def _proof(reached: PlanResult) -> tuple[Motion, Certificate]:
    assert reached.motion is not None
    assert reached.certificate is not None
    return reached.motion, reached.certificate


def test_every_phase_of_a_certified_motion_is_certified(reached: PlanResult) -> None:
    assert reached.verdict is Verdict.CERTIFIED
    (report,) = reached.phases
    _, certificate = _proof(reached)
    assert (report.name, report.status) == ("reach", PhaseStatus.CERTIFIED)
    named = {index for index, check in enumerate(certificate.checks) if ".reach" in check.name}
    assert set(report.checks) == named
    assert len(named) > 5


def test_a_check_belongs_to_the_phase_with_the_longest_name_that_fits() -> None:
    phases = ["reach", "reach.far", "reach 2"]
    assert find_phase("balance.reach", phases) == "reach"
    assert find_phase("planted.reach.far.l_foot", phases) == "reach.far"
    assert find_phase("coverage.missing.zmp.reach 2", phases) == "reach 2"
    assert find_phase("limits.speed", ["speed"]) is None
    assert find_phase("clearance", phases) is None


def _with_check(certificate: Certificate, name: str, **changes: Any) -> Certificate:
    checks = tuple(
        dataclasses.replace(check, **changes) if check.name == name else check for check in certificate.checks
    )
    return dataclasses.replace(certificate, checks=checks, status=Status.VIOLATED)


def test_a_failed_check_violates_the_phases_that_it_concerns(reached: PlanResult) -> None:
    motion, certificate = _proof(reached)
    middle = 0.5 * (motion.phases[0].first + motion.phases[0].last)
    whole = motion.phases[0]
    halves = (
        dataclasses.replace(whole, name="reach", last=middle),
        dataclasses.replace(whole, name="second", first=middle),
    )
    motion = dataclasses.replace(motion, phases=halves)

    def status(proof: Certificate) -> list[PhaseStatus]:
        return [report.status for report in report_phases(motion, proof)]

    good, bad = PhaseStatus.CERTIFIED, PhaseStatus.VIOLATED
    assert status(certificate) == [good, good]
    assert status(_with_check(certificate, "balance.reach", ok=False)) == [bad, good]
    assert status(_with_check(certificate, "limits.speed", ok=False)) == [bad, bad]
    assert status(_with_check(certificate, "zmp.reach", basis=Basis.UNPROVEN))[0] is PhaseStatus.FEASIBLE_AT_SAMPLES
    gap = dataclasses.replace(certificate.gaps, pair=(0,), first=(middle,), last=(whole.last,), lower=(0.0,))
    assert status(dataclasses.replace(certificate, gaps=gap)) == [good, PhaseStatus.FEASIBLE_AT_SAMPLES]


def test_phases_without_certificate_or_plan_say_so(reached: PlanResult) -> None:
    motion, _ = _proof(reached)
    reports = report_phases(motion, None, order=("approach", "reach", "open"))
    assert [(report.name, report.status.value) for report in reports] == [
        ("approach", "NOT_PLANNED"), ("reach", "UNVERIFIED"), ("open", "NOT_PLANNED"),
    ]  # fmt: skip
    assert report_phases(None, None, order=("turn",)) == (PhaseReport("turn", PhaseStatus.NOT_PLANNED),)


def test_a_failed_task_names_all_its_phases() -> None:
    setup = prepare(parse_request(door_request(x=1.3, hand="right")))
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims())
    (task,) = plan_task(setup, PhaseSolver(body, Monitor(60.0), Settings()))
    assert task.stuck is not None
    assert task.stuck.order == ("reach", "approach", "turn the handle", "open", "let the handle go", "retract")


def test_phases_that_a_failed_task_did_not_reach_are_not_planned(stuck: PlanResult) -> None:
    assert [report.status.value for report in stuck.phases] == ["NOT_FOUND", "NOT_PLANNED", "NOT_PLANNED"]


@pytest.mark.parametrize("name", ["reached", "stuck"])
def test_clients_see_the_same_phases_as_the_command_line(name: str, request: pytest.FixtureRequest) -> None:
    result = request.getfixturevalue(name)
    assert summarize(result_to_message(result))["phases"] == summary_json(result)["phases"]


def test_a_folder_has_the_status_of_its_phases_and_verification_repeats_it(folder: Path) -> None:
    data, again = read_result(folder), verify_result(folder)
    assert data["not_planned"] == [] == again["not_planned"]
    keys = ("name", "status", "checks")
    for phases in (data["phases"], again["phases"]):
        assert [{key: phase[key] for key in keys} for phase in phases] == [
            {"name": "reach", "status": "CERTIFIED", "checks": phases[0]["checks"]}
        ]


def _call_it_violated(data: dict[str, Any]) -> None:
    data["phases"][0]["status"] = "VIOLATED"


def _take_a_check_away(data: dict[str, Any]) -> None:
    data["phases"][0]["checks"].pop()


def _add_a_phase(data: dict[str, Any]) -> None:
    data["not_planned"] = ["turn"]


@pytest.mark.parametrize("lie", [_call_it_violated, _take_a_check_away, _add_a_phase])
def test_a_lie_about_a_phase_is_noticed(lie: Callable[[dict[str, Any]], None], folder: Path, tmp_path: Path) -> None:
    forged = tmp_path / "forged"
    copy_undrawn(folder, forged)
    data = read_result(forged)
    lie(data)
    (forged / "result.json").write_text(json.dumps(data))
    with pytest.raises(ResultError, match=r"phase 'reach'|not_planned"):
        verify_result(forged)


def test_a_failed_phase_stays_a_best_attempt(stuck: PlanResult, tmp_path: Path) -> None:
    forged = write_result(stuck, tmp_path / "out").folder
    data = read_result(forged)
    assert data["not_planned"] == ["approach", "open"]
    assert verify_result(forged)["phases"][0]["status"] == "NOT_FOUND"
    data["phases"][0]["status"] = "VIOLATED"
    (forged / "result.json").write_text(json.dumps(data))
    assert "phase 'reach' is CERTIFIED; recorded is 'VIOLATED'" in verify_result(forged)["explanation"]
