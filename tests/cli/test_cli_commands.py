"""Command line: exit codes, one line for wrong input, exactly one JSON object, no partial output."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from click.testing import Result
from small_plan import small_plan
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.run import EXIT_CODES
from service.errors import RequestError
from service.result.result import PlanResult, Verdict

ROOT = Path(__file__).parents[2]
REQUEST = ROOT / "examples" / "requests" / "joint_goal.yaml"


@pytest.fixture(scope="module")
def made() -> PlanResult:
    return small_plan()


@pytest.fixture
def planner(monkeypatch: pytest.MonkeyPatch, made: PlanResult) -> SimpleNamespace:
    """Replacement of ``service.planner`` whose ``plan`` can be set."""
    stand_in = SimpleNamespace(plan=lambda request, on_progress, should_stop, around=None: made)
    monkeypatch.setitem(sys.modules, "service.planner", stand_in)
    return stand_in


def _scopt(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def _only_object(result: Result) -> dict[str, Any]:
    data = json.loads(result.stdout)
    assert {"verdict", "planning_time_s", "timings", "min_clearance_m", "phases"} <= data.keys()
    assert isinstance(data, dict)
    return data


def test_a_certified_plan_ends_with_its_figures_and_files(
    planner: SimpleNamespace, made: PlanResult, tmp_path: Path
) -> None:
    assert made.certificate is not None
    assert made.certificate.min_clearance_pair is not None
    first, second = made.certificate.min_clearance_pair
    result = _scopt("plan", REQUEST, "--out", tmp_path / "plan")
    assert result.exit_code == 0, result.stderr
    lines = result.stdout.splitlines()
    ends = [line.split()[0] for line in lines[-7:]]
    assert ends == ["phases", "planning", "clearance", "balance", "viewer", "trajectory", "CERTIFIED"]
    assert lines[-3].endswith("viewer.html")
    assert Path(lines[-2].split(maxsplit=1)[1]).is_file()
    assert lines[-5].endswith(f" {1000 * made.certificate.min_clearance_m:.1f} mm between {first} and {second}")
    assert "write result" in result.stderr


@pytest.mark.parametrize("verdict", [v for v in Verdict if v is not Verdict.INVALID_REQUEST], ids=lambda v: v.value)
def test_every_verdict_has_its_exit_code_one_object_and_a_folder(
    planner: SimpleNamespace, made: PlanResult, tmp_path: Path, verdict: Verdict
) -> None:
    planner.plan = lambda request, on_progress, should_stop, around=None: replace(made, verdict=verdict)
    result = _scopt("plan", REQUEST, "--out", tmp_path / "plan", "--json")
    assert result.exit_code == EXIT_CODES[verdict.value]
    data = _only_object(result)
    assert data["verdict"] == verdict.value
    assert [phase["name"] for phase in data["phases"]] == ["bend", "turn"]
    assert Path(data["viewer"]).is_file()


def test_exit_codes_are_the_documented_ones() -> None:
    plans = {verdict.value for verdict in Verdict}
    carried_out = {"VIOLATED": 4, "DONE": 0, "STOOD": 1, "TRACKED": 0, "FELL": 7, "ABORTED": 8}
    recorded = {"HELD_BEFORE": 9, "DAMAGED": 74}
    compared = {"MATCHES": 0, "DIFFERS": 10, "LOST": 70}
    documented = {"CERTIFIED": 0, "INVALID_REQUEST": 3, "TIME_LIMIT": 5, "CANCELLED": 130}
    assert {**dict.fromkeys(plans, 4), **documented, **carried_out, **recorded, **compared} == EXIT_CODES


def test_a_wrong_request_is_one_line_and_exit_code_3(planner: SimpleNamespace, tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("robot: {name: atlas}\ngoal: {posture: stand}\noptions: {wayponts: 3}\n")
    result = _scopt("plan", path, "--out", tmp_path / "plan", "--json")
    assert result.exit_code == 3
    problem = "wrong.yaml: options: unknown key 'wayponts'; expected waypoints, …"
    assert result.stderr.splitlines()[-1] == problem
    data = _only_object(result)
    assert (data["verdict"], data["explanation"]) == ("INVALID_REQUEST", [problem])
    assert not (tmp_path / "plan").exists()


def test_the_last_line_on_stdout_starts_with_the_verdict_whatever_happens(
    planner: SimpleNamespace, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("robot: {name: atlas}\ngoal: {posture: [red]}\n")
    assert _scopt("plan", path).stdout.splitlines()[-1].startswith("INVALID_REQUEST  wrong.yaml: goal.posture: a text")
    assert _scopt("verify", tmp_path).stdout.splitlines()[-1].startswith("INVALID_REQUEST  ")
    planner.plan = lambda request, on_progress, should_stop, around=None: 1 // 0
    assert _scopt("plan", REQUEST).stdout.splitlines()[-1].startswith("INTERNAL_ERROR  internal error")


def test_a_request_that_the_robot_refuses_is_invalid_too(planner: SimpleNamespace, tmp_path: Path) -> None:
    def refuse(request: object, on_progress: object, should_stop: object, around: object = None) -> PlanResult:
        raise RequestError(["start is in collision: l_hand is 0.010 m inside crate", "second"])

    planner.plan = refuse
    result = _scopt("plan", REQUEST, "--out", tmp_path / "plan")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-2:] == ["start is in collision: l_hand is 0.010 m inside crate", "second"]


def test_a_missing_request_file_is_invalid_and_a_missing_argument_is_usage(planner: SimpleNamespace) -> None:
    assert _scopt("plan", "nowhere.yaml").exit_code == 3
    assert _scopt("plan").exit_code == 2
    assert _scopt("plan", REQUEST, "--colour", "red").exit_code == 2
    assert _scopt("dance").exit_code == 2


def test_a_defect_is_one_line_and_exit_code_70(planner: SimpleNamespace, tmp_path: Path) -> None:
    def broken(request: object, on_progress: object, should_stop: object, around: object = None) -> PlanResult:
        raise ZeroDivisionError("division\nby zero")

    planner.plan = broken
    result = _scopt("plan", REQUEST, "--out", tmp_path / "plan", "--json")
    assert result.exit_code == 70
    assert "Traceback" not in result.output
    assert "internal error, please report it: ZeroDivisionError: division by zero" in result.stderr.splitlines()[-1]
    assert _only_object(result)["verdict"] == "INTERNAL_ERROR"


def test_an_occupied_output_folder_is_refused_before_planning(planner: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    planner.plan = pytest.fail
    result = _scopt("plan", REQUEST, "--out", tmp_path)
    assert result.exit_code == 3
    assert "name a new or empty folder" in result.stderr


def test_another_cloud_takes_the_place_of_the_requests(
    planner: SimpleNamespace, made: PlanResult, tmp_path: Path
) -> None:
    seen = []

    def remember(
        request: Any, on_progress: Callable[[str, float], None], should_stop: object, around: object = None
    ) -> PlanResult:
        seen.append(request.resolve(request.scene.cloud).resolve())
        on_progress("reach", 0.5)
        return made

    planner.plan = remember
    result = _scopt("plan", REQUEST, "--out", tmp_path / "plan", "--cloud", tmp_path / "other.pcd")
    assert result.exit_code == 0, result.stderr
    assert seen == [(tmp_path / "other.pcd").resolve()]
    assert " 50 % reach" in result.stderr


def test_verify_and_view_read_what_plan_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert _scopt("plan", REQUEST, "--out", tmp_path / "plan").exit_code == 0
    verified = _scopt("verify", tmp_path / "plan" / "result.json", "--json")
    assert verified.exit_code == 0
    summary = json.loads(verified.stdout)
    assert (summary["verdict"], summary["held_to"]) == ("CERTIFIED", "for the request in this folder")
    asked = _scopt("verify", tmp_path / "plan", "--request", REQUEST)
    assert asked.exit_code == 0
    assert f", for {REQUEST.name}" in asked.stdout
    viewed = _scopt("view", tmp_path / "plan")
    assert viewed.exit_code == 0
    assert viewed.stdout.strip() == str((tmp_path / "plan" / "viewer.html").resolve())
    assert _scopt("verify", tmp_path).exit_code == 3
    assert _scopt("view", tmp_path).exit_code == 3


def test_version_is_that_of_the_installed_package() -> None:
    result = _scopt("--version")
    assert (result.exit_code, result.stdout, result.stderr) == (0, f"scopt {version('scopt')}\n", "")


def _list_commands(group: Any, *above: str) -> Iterator[tuple[str, ...]]:
    for name, own in group.commands.items():
        yield from _list_commands(own, *above, name) if hasattr(own, "commands") else [(*above, name)]


def test_the_help_of_every_command_says_what_an_option_takes_and_names_no_type() -> None:
    commands = list(_list_commands(typer.main.get_command(app)))
    assert ("move", "line") in commands
    for command in commands:
        told = _scopt(*command, "--help").stdout
        assert told.startswith("Usage:")
        assert re.search(r"<\w+[ \],>]|list\[|Path\b", told) is None, command
    told = _scopt("batch", "--help").stdout
    assert "{REQUEST}..." in told
    assert re.search(r"-o, --out PATH +Folder", told)
    assert re.search(r"--time-limit NUMBER +Wall time", told)


def test_robots_lists_atlas() -> None:
    assert "atlas" in _scopt("robots").stdout
    assert json.loads(_scopt("robots", "--json").stdout)["robots"][0]["name"] == "atlas"


def test_scene_turns_a_scan_into_pieces(tmp_path: Path) -> None:
    scan, out, posture = ROOT / "examples" / "data" / "valve_scan.pcd", tmp_path / "scene.json", tmp_path / "start.yaml"
    posture.write_text("posture: reach_ready\n")
    robot = ("--robot", "atlas", "--posture", posture)
    result = _scopt("scene", scan, "--out", out, "--reach", 1.5, *robot, "--json")
    assert result.exit_code == 0, result.stderr
    printed, written = json.loads(result.stdout), json.loads(out.read_text())
    assert written["figures"] == printed["figures"]
    assert len(written["pieces"]) == printed["figures"]["pieces"] > 3
    for piece in written["pieces"]:
        assert piece.keys() - {"seen"} == {"name", "kind", "vertices"}
        assert all(len(vertex) == 3 for vertex in piece["vertices"])
    seen = [piece["seen"] for piece in written["pieces"] if "seen" in piece]
    assert all(one.keys() == {"points", "free_cells", "free_share", "open_share", "plane"} for one in seen)
    assert sum(one["points"] for one in seen) > 1000
    assert any("on the robot itself" in note for note in printed["notes"])
    assert {path.name for path in tmp_path.iterdir() if path != posture} == {"scene.json", "scene.html"}
    whole = _scopt("scene", scan, "--out", out, "--reach", 1.2)
    assert whole.exit_code == 0, whole.stderr
    assert "pieces           " in whole.stdout.splitlines()[-1]
    assert not any("on the robot itself" in note for note in json.loads(out.read_text())["notes"])


def test_posture_without_robot_is_a_usage_error(tmp_path: Path) -> None:
    result = _scopt("scene", "scan.pcd", "--out", tmp_path / "s.json", "--posture", "p.yaml")
    assert result.exit_code == 2
    assert "--posture needs --robot" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("missing.pcd",), "missing.pcd: cannot be read"),
        (("scan.txt7",), "scan.txt7"),
        (("missing.pcd", "--robot", "atlsa"), "--robot: unknown robot 'atlsa'"),
        (("missing.pcd", "--robot", "atlas", "--posture", "none.yaml"), "none.yaml: cannot be read"),
    ],
)
def test_a_wrong_scene_argument_is_one_line(tmp_path: Path, arguments: tuple[str, ...], problem: str) -> None:
    result = _scopt("scene", *arguments, "--out", tmp_path / "scene.json")
    assert result.exit_code == 3
    assert result.stderr.splitlines()[-1].startswith(problem)
    assert not (tmp_path / "scene.json").exists()


PLANNERS = """
import json, os, sys, time, types
from dataclasses import replace
sys.path.insert(0, {support!r})
import service.cli.plan
import service.cli.run
from service.cli.app import main
from service.result.result import Verdict
from small_plan import small_plan
made = small_plan()

def begin(silent_s, waits, verdict, request, out, stdout, stderr):
    for number, name in ((1, stdout), (2, stderr)):
        os.dup2(os.open(name, os.O_CREAT | os.O_WRONLY), number)
    service.cli.run.SILENT_S = silent_s
    def plan(request, on_progress, should_stop, around=None):
        on_progress("waiting", 0.5)
        while waits or not should_stop():
            time.sleep(0.01)
        return replace(made, verdict=Verdict(verdict), explanation=("cancelled during 'waiting'",))
    sys.modules["service.planner"] = types.SimpleNamespace(plan=plan)
    sys.argv = ["scopt", "plan", request, "--out", out, "--json"]
    main()

for line in sys.stdin:
    process = os.fork()
    if process == 0:
        begin(**json.loads(line))
        os._exit(0)
    print(process, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
"""
Interrupt = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Interrupt]:
    """Exit code and JSON of a planning process that receives Ctrl-C; all are forked from one, which has imported."""
    program = PLANNERS.format(support=str(ROOT / "tests" / "support" / "results"))
    with subprocess.Popen(
        [sys.executable, "-c", program], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        stdin, told = parent.stdin, parent.stdout
        assert stdin is not None
        assert told is not None

        def interrupt(
            out: Path, times: int, *, is_silent: bool = False, verdict: str = "CANCELLED"
        ) -> tuple[int, dict[str, Any]]:
            """Send Ctrl-C that many times; silent work does not ask for it."""
            folder = tmp_path_factory.mktemp("streams")
            case = {
                "silent_s": 0.2 if is_silent else 600.0,  # until work that did not hear is interrupted
                "waits": times > 1 or is_silent,
                "verdict": verdict,
                "request": str(REQUEST),
                "out": str(out),
                **{name: str(folder / name) for name in ("stdout", "stderr")},
            }
            stdin.write(json.dumps(case) + "\n")
            stdin.flush()
            process, stderr = int(told.readline()), folder / "stderr"
            for word in ("waiting", *["Ctrl-C again"] * (times - 1)):
                while not (stderr.is_file() and word in stderr.read_text()):
                    assert Path(f"/proc/{process}").exists(), "it has ended"
                    time.sleep(0.01)
                os.kill(process, signal.SIGINT)
            code = int(told.readline())
            return code, json.loads((folder / "stdout").read_text())

        yield interrupt
        parent.kill()


def test_ctrl_c_hands_over_the_best_so_far(interrupted: Interrupt, tmp_path: Path) -> None:
    code, data = interrupted(tmp_path / "plan", 1)
    assert (code, data["verdict"]) == (130, "CANCELLED")
    assert (tmp_path / "plan" / "result.json").is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["plan"]


@pytest.mark.parametrize("verdict", ["CANCELLED", "TIME_LIMIT"])  # the plan may be about to end by itself
def test_ctrl_c_keeps_an_earlier_result(interrupted: Interrupt, tmp_path: Path, verdict: str) -> None:
    from small_plan import small_plan

    from service import write_result

    write_result(small_plan(), tmp_path / "plan")
    before = {path: path.read_bytes() for path in (tmp_path / "plan").rglob("*") if path.is_file()}
    code, data = interrupted(tmp_path / "plan", 1, verdict=verdict)
    assert (code, data["verdict"]) == (130, "CANCELLED")
    assert "result" not in data
    assert {path: path.read_bytes() for path in (tmp_path / "plan").rglob("*") if path.is_file()} == before


def test_ctrl_c_ends_work_that_does_not_ask_for_it(interrupted: Interrupt, tmp_path: Path) -> None:
    code, data = interrupted(tmp_path / "plan", 1, is_silent=True)
    assert (code, data["verdict"]) == (130, "CANCELLED")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_twice_stops_at_once_and_writes_nothing(interrupted: Interrupt, tmp_path: Path) -> None:
    code, data = interrupted(tmp_path / "plan", 2)
    assert (code, data["verdict"]) == (130, "CANCELLED")
    assert list(tmp_path.iterdir()) == []
