"""scopt request, review and top against a server that keeps the protocol."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import grpc
import pytest
import trustme
from click.testing import Result
from google.protobuf.duration_pb2 import Duration
from google.rpc.error_details_pb2 import BadRequest, RetryInfo
from planner_stand_in import (
    FILES,
    PLAN_ID,
    PlannerStandIn,
    accepted,
    finished,
    make_result,
    refused,
    serving,
    slow_plan,
)
from rich.console import Console
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.connect import ENDINGS
from service.cli.run import EXIT_CODES
from service.cli.top import draw_status
from service.proto.planner.v1 import planner_pb2 as pb
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED, VERDICT_TIME_LIMIT
from service.result.result import Verdict

Code = grpc.StatusCode
ROOT = Path(__file__).parents[2]
REQUESTS = ROOT / "examples" / "requests"


@pytest.fixture
def target(stand_in: PlannerStandIn, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SCOPT_TOKEN", raising=False)
    with serving(stand_in) as address:
        yield address


def _scopt(*arguments: object, **variables: str) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env=variables)


def _request(target: str, *arguments: object, name: str = "joint_goal") -> Result:
    return _scopt("request", REQUESTS / f"{name}.yaml", "--target", target, *arguments)


def test_a_request_ends_with_the_verdict_and_the_folder_that_plan_writes(target: str, tmp_path: Path) -> None:
    result = _request(target)
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    ends = [line.split()[0] for line in lines[-8:]]
    assert ends == ["phases", "planning", "clearance", "balance", "plan", "viewer", "trajectory", "CERTIFIED"]
    assert lines[-1] == "CERTIFIED  clearance 21.3 mm, planned in 0.25 s"
    assert (tmp_path / "out" / "joint_goal" / "result.json").read_bytes() == FILES["result.json"]
    lines_on_stderr = [line.strip() for line in result.stderr.splitlines()]
    assert lines_on_stderr == [
        "0 % read request",
        "0 % send request",
        f"0 % accepted as {PLAN_ID}",
        "0 % queued behind 1, about 0.5 s",
        "10 % prepare",
    ]


def test_a_terminal_shows_every_iteration(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.cli.request.LOG_PERIOD_S", 0.0)
    assert " 50 % reach: iteration 4, merit 3.5, mu 10, collision off by 0.02" in _request(target).stderr


def test_json_is_one_object_with_the_keys_of_plan(target: str) -> None:
    result = _request(target, "--json", "--request-id", "mine")
    data = json.loads(result.stdout)
    assert {"verdict", "planning_time_s", "timings", "min_clearance_m", "phases", "checks", "figures"} <= data.keys()
    assert (data["verdict"], data["plan_id"], data["request_id"]) == ("CERTIFIED", PLAN_ID, "mine")
    assert data["figures"] == {"steps": 3}
    assert Path(data["viewer"]).is_file()


@pytest.mark.parametrize("verdict", [v.value for v in Verdict])
def test_every_verdict_has_the_exit_code_of_plan(stand_in: PlannerStandIn, target: str, verdict: str) -> None:
    stand_in.plans.append(lambda request, context: iter([accepted(request), finished(make_result(verdict))]))
    result = _request(target)
    assert result.exit_code == EXIT_CODES[verdict]
    assert result.stdout.splitlines()[-1].startswith(verdict)
    assert "viewer" not in result.stdout  # there were no files


def test_every_status_of_grpc_has_an_ending_and_the_documented_ones_their_exit_code() -> None:
    assert set(ENDINGS) == set(Code)
    documented = {
        Code.INVALID_ARGUMENT: 3, Code.UNIMPLEMENTED: 3, Code.DEADLINE_EXCEEDED: 5, Code.RESOURCE_EXHAUSTED: 6,
        Code.UNAVAILABLE: 69, Code.INTERNAL: 70, Code.UNAUTHENTICATED: 77, Code.CANCELLED: 130,
    }  # fmt: skip
    assert {code: ENDINGS[code][1] for code in documented} == documented


def test_wrong_fields_are_a_line_each(stand_in: PlannerStandIn, target: str, tmp_path: Path) -> None:
    lines = ["goal.joints: unknown joint 'a'", "start.joints: unknown joint 'b'"]
    bad = BadRequest(field_violations=[{"field": "request", "description": line} for line in lines])  # type: ignore[list-item]
    stand_in.plans.append(refused(Code.INVALID_ARGUMENT, "; ".join(lines), bad))
    result = _request(target, "--out", tmp_path / "plan")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-2:] == lines
    assert result.stdout == f"INVALID_REQUEST  {lines[0]}\n"
    assert list(tmp_path.iterdir()) == []


def test_an_overloaded_server_is_tried_again_and_reported_in_the_end(stand_in: PlannerStandIn, target: str) -> None:
    delay = RetryInfo(retry_delay=Duration(nanos=20_000_000))
    stand_in.plans += [refused(Code.RESOURCE_EXHAUSTED, "the queue is full", delay)] * 2
    result = _request(target, "--attempts", 2, "--json")
    assert result.exit_code == 6
    assert "OVERLOADED: the queue is full; trying again in 0.0 s" in result.stderr
    assert json.loads(result.stdout)["verdict"] == "OVERLOADED"
    assert len(stand_in.requests) == 2


def test_requests_refused_by_the_validator_or_the_folder_are_not_sent(
    stand_in: PlannerStandIn, target: str, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("robot: {name: atlas}\ngoal: {posture: stand}\noptions: {wayponts: 3}\n")
    result = _scopt("request", path, "--target", target)
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1] == "wrong.yaml: options: unknown key 'wayponts'; expected waypoints, …"
    assert _request(target, "--out", tmp_path, name="valve").exit_code == 3  # holds something else
    assert _request("nowhere").exit_code == 3
    assert _scopt("request", path).exit_code == 2
    assert stand_in.requests == []


def test_the_target_may_come_from_the_environment_and_the_token_from_a_file(
    stand_in: PlannerStandIn, target: str, tmp_path: Path
) -> None:
    (tmp_path / "token").write_text("from-file\n")
    assert _scopt("top", "--once", SCOPT_TARGET=target, SCOPT_TOKEN="from-environment").exit_code == 0
    assert _scopt("top", "--once", "--target", target, "--token-file", tmp_path / "token").exit_code == 0
    assert _scopt("top", "--once", "--target", target, "--token-file", tmp_path / "none").exit_code == 3
    assert [one["authorization"] for one in stand_in.metadata] == ["Bearer from-environment", "Bearer from-file"]


def test_plans_and_scenes_are_listed_over_all_pages(stand_in: PlannerStandIn, target: str) -> None:
    listed = json.loads(_scopt("plans", "--target", target, "--needs-review", "--since", "2h", "--json").stdout)
    assert [plan["plan_id"] for plan in listed["plans"]] == [f"plan{number}" for number in range(5)]
    assert all(request.needs_review and request.since.seconds > 0 for request in stand_in.requests)
    table = _scopt("plans", "--target", target, "--limit", 3, "--state", "finished").stdout
    assert "plan2" in table
    assert "plan3" not in table
    assert "scene:1" in _scopt("scenes", "--target", target).stdout


def test_a_wrong_filter_is_refused_before_anything_is_sent(stand_in: PlannerStandIn, target: str) -> None:
    result = _scopt("plans", "--target", target, "--state", "done")
    assert result.exit_code == 3
    assert "state: unknown state 'done'; expected queued, running" in result.stderr
    assert _scopt("plans", "--target", target, "--since", "yesterday").exit_code == 2
    assert stand_in.requests == []


SHIPPED = sorted(REQUESTS.glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_example_request_is_sent_with_its_clouds(stand_in: PlannerStandIn, target: str, path: Path) -> None:
    result = _request(target, name=path.stem)
    assert result.exit_code == 0, result.stderr
    (sent,) = (message for message in stand_in.requests if isinstance(message, pb.PlanRequest))
    cloud = sent.request.scene.cloud.file
    assert cloud in stand_in.clouds if "cloud:" in path.read_text() else cloud == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_stop_the_plan(
    stand_in: PlannerStandIn, target: str, tmp_path: Path, number: signal.Signals
) -> None:
    stand_in.plans.append(slow_plan(stand_in))
    command = [
        sys.executable,
        "-c",
        "from service.cli.app import main; main()",
        "request",
        REQUESTS / "joint_goal.yaml",
    ]
    process = subprocess.Popen(
        [*map(str, command), "--target", target, "--out", str(tmp_path / "plan")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stderr is not None
    while "waiting" not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(number)
    stdout, _ = process.communicate(timeout=120)
    assert (process.returncode, stdout) == (130, "CANCELLED  cancelled\n")
    assert stand_in.stopped.wait(60.0)
    assert list(tmp_path.iterdir()) == []


def test_a_review_shows_the_hashes_it_is_bound_to(stand_in: PlannerStandIn, target: str) -> None:
    seen = _scopt("review", PLAN_ID, "--target", target)
    assert seen.exit_code == 0, seen.stderr
    assert f"trajectory       {stand_in.result.trajectory.sha256}" in seen.stdout
    assert f"certificate      {stand_in.result.certificate.sha256}" in seen.stdout
    assert stand_in.reviews == []
    assert _scopt("review", PLAN_ID, "--target", target, "--reject", "--comment", "too close").exit_code == 0
    accepted = _scopt("review", PLAN_ID, "--target", target, "--accept", "--json")
    assert [review.decision for review in stand_in.reviews] == [pb.DECISION_REJECTED, pb.DECISION_ACCEPTED]
    data = json.loads(accepted.stdout)
    assert [(review["decision"], review["comment"]) for review in data["reviews"]] == [
        ("REJECTED", "too close"),
        ("ACCEPTED", ""),
    ]


def test_an_approval_names_its_verdict_and_validity_and_is_withdrawn(stand_in: PlannerStandIn, target: str) -> None:
    nothing = _scopt("review", PLAN_ID, "--target", target, "--revoke")
    assert nothing.exit_code == 3
    assert f"plan {PLAN_ID} is not approved; there is nothing to revoke" in nothing.stderr
    options = ("--accept", "--despite", "TIME_LIMIT", "--valid-days", "0.5")
    assert _scopt("review", PLAN_ID, "--target", target, *options).exit_code == 0
    (sent,) = (message for message in stand_in.requests if isinstance(message, pb.ReviewPlanRequest))
    assert (sent.verdict, sent.despite, sent.valid_s) == (VERDICT_CERTIFIED, VERDICT_TIME_LIMIT, 43200.0)
    revoked = _scopt("review", PLAN_ID, "--target", target, "--revoke", "--comment", "old scan", "--json")
    decisions = [review["decision"] for review in json.loads(revoked.stdout)["reviews"]]
    assert decisions == ["ACCEPTED", "REVOKED"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--revoke", "--accept"), "--revoke goes without --accept and --reject"),
        (("--reject", "--despite", "TIME_LIMIT"), "--despite and --valid-days go with --accept"),
        (("--valid-days", "3"), "--despite and --valid-days go with --accept"),
        (("--accept", "--valid-days", "400"), "should be less than or equal to 366"),
        (("--accept", "--despite", "TIME_LIMITS"), "despite: unknown verdict 'TIME_LIMITS'; expected TIME_LIMIT"),
    ],
)  # fmt: skip
def test_options_of_a_review_that_do_not_go_together_are_refused(
    stand_in: PlannerStandIn, target: str, options: tuple[str, ...], words: str
) -> None:
    refused = _scopt("review", PLAN_ID, "--target", target, *options)
    assert refused.exit_code in (2, 3)
    assert words in " ".join(refused.stderr.replace("│", " ").split())
    assert stand_in.reviews == []


def test_control_characters_of_a_comment_are_escaped(stand_in: PlannerStandIn, target: str) -> None:
    _scopt("review", PLAN_ID, "--target", target, "--reject", "--comment", "\x1b[2K\x1b[1Atoo ☃\nclose")
    seen = _scopt("review", PLAN_ID, "--target", target).stdout
    assert "\x1b" not in seen
    assert r"\x1b[2K\x1b[1Atoo ☃" in seen


def test_a_plans_files_are_fetched_without_a_decision(stand_in: PlannerStandIn, target: str, tmp_path: Path) -> None:
    seen = _scopt("review", PLAN_ID, "--target", target, "--out", tmp_path / "plan")
    assert seen.exit_code == 0, seen.stderr
    assert f"viewer           {tmp_path}/plan/viewer.html" in seen.stdout
    written = {path.relative_to(tmp_path / "plan").as_posix() for path in (tmp_path / "plan").rglob("*.*")}
    assert written == set(FILES)
    again = _scopt("review", PLAN_ID, "--target", target, "--out", tmp_path / "plan", "--json")
    assert json.loads(again.stdout)["viewer"] == f"{tmp_path}/plan/viewer.html"
    assert stand_in.reviews == []
    refused = _scopt("review", PLAN_ID, "--target", target, "--out", tmp_path, "--accept")
    assert refused.exit_code == 3
    assert stand_in.reviews == []


def test_the_error_of_an_unusable_token_names_its_source(stand_in: PlannerStandIn, target: str, tmp_path: Path) -> None:
    def top(*arguments: object, **variables: str) -> str:
        result = _scopt("top", "--target", target, *arguments, **variables)
        assert result.exit_code == 3
        return result.stderr

    empty, odd = tmp_path / "empty", tmp_path / "odd"
    empty.write_text("\n")
    odd.write_text("two words")
    assert top("--token-file", empty).startswith(
        f"--token-file {empty} is empty; expected the line that `scopt token` prints"
    )
    printable = "expected printable ASCII characters without blanks\n"
    assert top("--token-file", odd) == f"--token-file {odd}: {printable}"
    assert top(SCOPT_TOKEN="two words") == f"the variable SCOPT_TOKEN: {printable}"
    assert stand_in.requests == []


def test_an_unknown_token_is_reported_with_its_source_or_the_ways_to_give_one(
    stand_in: PlannerStandIn, target: str, tmp_path: Path
) -> None:
    stand_in.plans += [refused(Code.UNAUTHENTICATED, "a token is needed")] * 2
    result = _request(target)
    assert result.exit_code == 77
    assert "a token is needed; give --token-file FILE or set SCOPT_TOKEN" in result.stderr
    (tmp_path / "token").write_text("wrong")
    assert (
        f"the token is from --token-file {tmp_path}/token"
        in _request(target, "--token-file", tmp_path / "token").stderr
    )


def test_grpc_logs_nothing_to_stderr(tmp_path: Path) -> None:
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(tmp_path / "ca.pem"))
    with serving(PlannerStandIn()) as target:
        words = [sys.executable, "-c", "from service.cli.app import main; main()", "top", "--once", "--target", target]
        words += ["--tls-ca", str(tmp_path / "ca.pem")]
        variables = {name: value for name, value in os.environ.items() if name != "GRPC_VERBOSITY"}
        ended = subprocess.run(
            words, capture_output=True, text=True, env=variables | {"PYTHONPATH": str(ROOT)}, check=False
        )
    assert ended.returncode == 69
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"the server at {target} does not use TLS")


def test_a_missing_or_unfinished_plan_is_not_reviewed(stand_in: PlannerStandIn, target: str) -> None:
    gone = _scopt("review", "other", "--accept", "--target", target)
    assert (gone.exit_code, gone.stderr) == (3, "no plan 'other'\n")
    stand_in.state = pb.PLAN_STATE_RUNNING
    running = _scopt("review", PLAN_ID, "--accept", "--target", target)
    assert (running.exit_code, running.stderr) == (
        3,
        f"plan {PLAN_ID} is running; expected a finished plan\n",
    )
    assert stand_in.reviews == []


def test_top_prints_once_without_a_terminal(target: str) -> None:
    result = _scopt("top", "--target", target)
    lines = [" ".join(line.split()) for line in result.stdout.splitlines()]
    assert lines == [
        f"scopt 0.1.0 at {target}, up 1 h 2 min",
        "queue 2 of 8",
        "solve median 0.31 s, 99 % within 1.40 s",
        "memory 0 MB, 1 workers restarted",
        "verdicts CERTIFIED 15, NOT_FOUND 2",
        "",
        "worker state work done MB",
        "41 busy plan 17 250",
    ]
    data: dict[str, Any] = json.loads(_scopt("top", "--target", target, "--json").stdout)
    assert data["verdicts"] == {"CERTIFIED": 15, "NOT_FOUND": 2}
    assert data["workers"][0]["jobs_done"] == 17


def test_top_keeps_the_last_status_of_an_unreachable_server() -> None:
    screen = Console(file=StringIO(), width=120)
    screen.print(draw_status(pb.GetStatusResponse(version="0.1.0", queued=3), "robot:1", "UNAVAILABLE: gone\nfor good"))
    screen.print(draw_status(pb.GetStatusResponse(is_draining=True), "robot:1"))
    assert isinstance(screen.file, StringIO)
    text = screen.file.getvalue()
    assert "UNAVAILABLE: gone for good" in text
    assert "draining: no new requests" in text


def test_a_missing_server_is_exit_code_69() -> None:
    assert _scopt("top", "--target", "localhost:1").exit_code == 69
    result = _scopt("request", REQUESTS / "joint_goal.yaml", "--target", "localhost:1", "--attempts", 1)
    assert result.exit_code == 69
    assert result.stdout.startswith("UNAVAILABLE  ")
