"""Results of earlier releases hold today, held before and lack checks, or are damaged."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from earlier_results import VERSIONS, unpack
from typer.testing import CliRunner

from service.cli.app import app
from service.errors import DamagedResultError, ResultError
from service.replay import replay, standing
from service.replay.replay import verify_result
from service.replay.rest import make_rest_request
from service.replay.standing import HELD_BEFORE, Standing
from service.request.file import hash_request_data
from service.result.folder import read_result
from service.result.versions import find_format
from service.verify import Basis, Certificate, Check, Motion, Status, verify

FORMATS = {"0.2.0": 1, "0.3.0": 2}


@pytest.fixture(params=FORMATS)
def reach(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The reach of an arm, as a release wrote it."""
    return unpack(request.param, "reach", tmp_path / request.param)


@pytest.fixture
def latest(tmp_path: Path) -> Path:
    """The reach of 0.3.0."""
    return unpack("0.3.0", "reach", tmp_path / "latest")


def test_a_reach_of_an_earlier_release_holds_today(reach: Path) -> None:
    release = reach.name
    assert find_format(read_result(reach)) == FORMATS[release]
    summary = verify_result(reach)
    assert (summary["verdict"], summary["explanation"]) == ("CERTIFIED", [])
    expected = {"state": "HOLDS", "release": release, "format": FORMATS[release], "lacks": (), "fails": ()}
    sentence = f"holds today; format {FORMATS[release]} (version {release})"
    assert summary["standing"] == {**expected, "sentence": sentence}
    assert [phase["status"] for phase in summary["phases"]] == ["CERTIFIED"]


def test_a_task_of_an_earlier_release_that_lacks_checks_is_not_accepted_anew(tmp_path: Path) -> None:
    folder = unpack("0.2.0", "valve", tmp_path / "valve")  # its peg and its loads were other ones than today's
    summary = verify_result(folder)
    assert summary["verdict"] == HELD_BEFORE
    assert summary["standing"]["state"] == HELD_BEFORE
    first, *_ = summary["explanation"]
    assert first.startswith("held under version 0.2.0 (format 1), ")
    assert first.endswith(" today; not accepted anew")


def test_a_drawer_of_0_3_0_holds_or_lacks_named_checks(tmp_path: Path) -> None:
    folder = unpack("0.3.0", "drawer", tmp_path / "drawer")
    recorded = {check["name"] for check in read_result(folder)["certificate"]["checks"]}
    found = verify_result(folder)["standing"]
    assert (found["release"], found["fails"]) == ("0.3.0", ())
    assert (found["state"] == "HOLDS") == (not found["lacks"])
    assert not recorded & set(found["lacks"])


@pytest.mark.parametrize("is_ok", [True, False])
def test_a_check_that_came_later_is_named_only_where_it_does_not_hold(
    latest: Path, monkeypatch: pytest.MonkeyPatch, is_ok: bool
) -> None:
    _let_verifier_add(monkeypatch, Check("grasp.reach", is_ok, 1.0, 2.0, "N", "a later check", None, Basis.SAMPLES))
    summary = verify_result(latest)
    if is_ok:
        assert (summary["verdict"], summary["standing"]["state"]) == ("CERTIFIED", "HOLDS")
    else:
        sentence = "held under version 0.3.0 (format 2), lacks grasp.reach today; not accepted anew"
        assert (summary["verdict"], summary["explanation"][0]) == (HELD_BEFORE, sentence)
        assert (summary["standing"]["lacks"], summary["standing"]["fails"]) == (("grasp.reach",), ())


def test_a_check_that_fails_is_damage_unless_its_meaning_changed(latest: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail_limits(certificate: Certificate) -> Certificate:
        checks = tuple(
            dataclasses.replace(check, ok=False, value=1.0) if check.name.startswith("limits.position") else check
            for check in certificate.checks
        )
        return dataclasses.replace(certificate, checks=checks, status=Status.VIOLATED)

    _change_verifier(monkeypatch, fail_limits)
    with pytest.raises(DamagedResultError, match="checks are not those of the motion"):
        verify_result(latest)
    monkeypatch.setitem(standing.CHANGED_CHECKS, 3, (*standing.CHANGED_CHECKS[3], "limits.position"))
    summary = verify_result(latest)
    assert summary["verdict"] == HELD_BEFORE
    assert summary["standing"]["fails"] == ("limits.position",)


def _move_curve(data: dict[str, Any]) -> None:
    data["curve"]["positions"][1][0] += 1e-3


def _move_sample(data: dict[str, Any]) -> None:
    data["trajectory"]["positions"][3][0] += 1e-3


def _widen_target(data: dict[str, Any]) -> None:
    data["phases"][0]["targets"][0]["position_tolerance_m"] = [0.5, 0.5, 0.5]


def _claim_clearance(data: dict[str, Any]) -> None:
    for part in (data, data["certificate"]):
        part["min_clearance_m"] = 0.2


def _better_check(data: dict[str, Any]) -> None:
    for part in (data, data["certificate"]):
        next(check for check in part["checks"] if check["name"] == "clearance")["value"] = 0.2


def _change_request(data: dict[str, Any]) -> None:
    data["request"]["options"]["margin_m"] = 0.05


def _shrink_body(data: dict[str, Any]) -> None:
    data["bodies"][0]["vertices"][0][0] += 0.01


def _drop_certificate(data: dict[str, Any]) -> None:
    data["certificate"] = None


@pytest.mark.parametrize(
    "edit",
    [
        _move_curve, _move_sample, _widen_target, _claim_clearance, _better_check, _change_request, _shrink_body,
        _drop_certificate,
    ],
)  # fmt: skip
def test_a_changed_result_of_an_earlier_release_is_damaged(reach: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    _edit(reach, edit)
    with pytest.raises(DamagedResultError, match="changed after it was written"):
        verify_result(reach)


def test_a_rehashed_request_of_an_earlier_release_is_damage_and_not_called_held_before(reach: Path) -> None:
    def move_goal(data: dict[str, Any]) -> None:
        data["request"]["goal"]["poses"][0]["position"][0] += 0.05
        data["request_hash"] = hash_request_data(data["request"])

    _edit(reach, move_goal)
    with pytest.raises(DamagedResultError, match="targets of phase 'reach' are not those of the request"):
        verify_result(reach)


def test_a_result_of_this_version_cannot_pass_for_an_earlier_one(latest: Path) -> None:
    """Naming an earlier format gains nothing: what today demands is demanded all the same."""
    _edit(latest, _widen_target)
    with pytest.raises(DamagedResultError):
        verify_result(latest)
    _edit(latest, lambda data: data.update(format="scopt-result/3"))
    with pytest.raises(DamagedResultError):
        verify_result(latest)


def test_the_users_request_is_compared_by_its_meaning(latest: Path, tmp_path: Path) -> None:
    asked = json.loads(json.dumps(read_result(latest)["request"]))
    asked["options"]["hand_friction"] = [0.3, 0.6]  # what a file of today may say beside it
    mine = tmp_path / "mine.yaml"
    (tmp_path / "arm.urdf").write_text((VERSIONS / "arm.urdf").read_text())
    mine.write_text(yaml.safe_dump(asked))
    assert verify_result(latest, mine)["held_to"] == "for mine.yaml"
    asked["goal"]["poses"][0]["position"][0] += 0.05
    mine.write_text(yaml.safe_dump(asked))
    with pytest.raises(ResultError, match="it answers another request"):
        verify_result(latest, mine)


def test_the_command_ends_with_a_code_of_its_own_for_each_state(latest: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runner = CliRunner()
    holds = runner.invoke(app, ["verify", str(latest)])
    assert holds.exit_code == 0
    assert holds.stdout.splitlines()[-1].startswith("CERTIFIED")
    assert "standing         holds today; format 2 (version 0.3.0)" in holds.stdout
    with monkeypatch.context() as patch:
        _let_verifier_add(patch, Check("grasp.reach", False, 3.0, 2.0, "N", "a later check", None, Basis.SAMPLES))
        held = runner.invoke(app, ["verify", str(latest)])
        printed = runner.invoke(app, ["verify", str(latest), "--json"])
    assert held.exit_code == printed.exit_code == 9
    sentence = "held under version 0.3.0 (format 2), lacks grasp.reach today; not accepted anew"
    assert held.stdout.splitlines()[-1].startswith(f"HELD_BEFORE  {sentence}")
    assert json.loads(printed.stdout)["standing"]["lacks"] == ["grasp.reach"]
    _edit(latest, _better_check)
    damaged = runner.invoke(app, ["verify", str(latest)])
    assert damaged.exit_code == 74
    assert damaged.stdout.splitlines()[-1].startswith("DAMAGED")


def test_the_rest_of_an_earlier_plan_can_be_planned(reach: Path) -> None:
    rest = make_rest_request(reach, "reach", None)
    assert rest.resume is not None
    assert rest.resume.phase == "reach"


def test_a_long_list_of_lacking_checks_is_cut_in_the_sentence() -> None:
    found = Standing.of(2, ["a", "b", "c", "d", "e"], ["f"])
    assert found.sentence() == (
        "held under version 0.3.0 (format 2), lacks a, b, c and 2 more and fails f today; not accepted anew"
    )


def _edit(folder: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "result.json"
    data = json.loads(path.read_text())
    edit(data)
    path.write_text(json.dumps(data))


def _let_verifier_add(monkeypatch: pytest.MonkeyPatch, check: Check) -> None:
    def add(certificate: Certificate) -> Certificate:
        status = certificate.status if check.ok else Status.VIOLATED
        return dataclasses.replace(certificate, checks=(*certificate.checks, check), status=status)

    _change_verifier(monkeypatch, add)


def _change_verifier(monkeypatch: pytest.MonkeyPatch, change: Callable[[Certificate], Certificate]) -> None:
    def changed(motion: Motion) -> Certificate:
        return change(verify(motion))

    monkeypatch.setattr(replay, "verify", changed)
