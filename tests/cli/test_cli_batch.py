"""``scopt batch`` and the options that all commands that plan have in common."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import Result
from planar_arm import write_planar_arm
from small_plan import small_plan
from typer.testing import CliRunner

from service.bench.batch import BatchRow, find_batch_verdict, plan_many
from service.cli.app import app
from service.cli.run import EXIT_CODES
from service.errors import RequestError
from service.request.file import parse_request, replace_options
from service.result.folder import ResultFiles
from service.result.result import PlanResult


def _scopt(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def _write_request(folder: Path, name: str, goal: float) -> Path:
    urdf = write_planar_arm(folder, 3, 0.2, 0.04, limit=3.0)
    data = {"robot": {"urdf": urdf.name}, "scene": {"floor": False}, "goal": {"joints": {"j0": goal}}}
    path = folder / f"{name}.json"
    path.write_text(json.dumps(data))
    return path


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Folders of results of a planner that has its plan already; drawing it takes longer than all else."""
    made = small_plan()
    stand_in = SimpleNamespace(plan=lambda request, on_progress, should_stop, around=None: made)
    monkeypatch.setitem(sys.modules, "service.planner", stand_in)
    folders: list[Path] = []

    def note(result: PlanResult, folder: Path) -> ResultFiles:
        folders.append(folder)
        return ResultFiles(folder)

    monkeypatch.setattr("service.result.output.write_result", note)
    return folders


def test_a_batch_has_a_row_for_each_request_and_one_that_is_refused_costs_no_other(tmp_path: Path) -> None:
    good, bad = _write_request(tmp_path, "good", 0.5), _write_request(tmp_path, "bad", 9.0)
    result = _scopt("batch", bad, good, "--out", tmp_path / "out", "--jobs", 1, "--seed", 7)
    lines = result.stdout.splitlines()
    assert sorted(line.split()[:2] for line in lines[:2]) == [["CERTIFIED", "good"], ["INVALID_REQUEST", "bad"]]
    assert "goal.joints" in next(line for line in lines if line.startswith("INVALID_REQUEST"))
    assert lines[2].startswith("1 of 2 CERTIFIED")
    assert result.exit_code == EXIT_CODES["INVALID_REQUEST"]
    data = json.loads((tmp_path / "out" / "good" / "result.json").read_text())
    assert data["request"]["options"]["seed"] == 7
    assert not (tmp_path / "out" / "bad").exists()


def test_the_verdict_of_a_batch_is_that_of_its_first_failure() -> None:
    rows = [BatchRow("a", "CERTIFIED"), BatchRow("b", "TIME_LIMIT"), BatchRow("c", "NOT_FOUND")]
    assert find_batch_verdict(rows) == "TIME_LIMIT"
    assert find_batch_verdict(rows[:1]) == "CERTIFIED"


def test_requests_of_one_name_and_none_at_all_are_refused(tmp_path: Path) -> None:
    assert "two requests are named 'a'" in _scopt("batch", "x/a.yaml", "y/a.yaml").stderr
    with pytest.raises(RequestError, match="there are none"):
        plan_many({}, tmp_path)


def test_options_of_the_command_replace_those_of_the_request(tmp_path: Path) -> None:
    request = parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "options": {"seed": 3}})
    changed = replace_options(request, {"time_limit_s": 4.0})
    assert (changed.options.seed, changed.options.time_limit_s) == (3, 4.0)
    assert replace_options(request, {}) is request


def test_a_configuration_file_gives_defaults_of_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: list[Path]
) -> None:
    config, path = tmp_path / "config.yaml", _write_request(tmp_path, "reach", 0.5)
    monkeypatch.setenv("SCOPT_CONFIG", str(config))
    config.write_text(f"plan: {{quiet: true, out: {tmp_path / 'mine'}}}")
    assert len(_scopt("plan", path).stdout.splitlines()) == 1
    assert written == [tmp_path / "mine"]
    config.write_text("plan: {sed: 3}")
    assert "unknown option 'sed'" in _scopt("plan", path).stderr
    config.write_text("plna: {seed: 3}")
    assert "unknown command 'plna'" in _scopt("plan", path).stderr
    config.unlink()
    assert _scopt("plan", path).exit_code == 2


def test_quiet_leaves_the_verdict_line_alone_and_verbose_names_every_start(tmp_path: Path, written: list[Path]) -> None:
    path = _write_request(tmp_path, "reach", 0.5)
    quiet = _scopt("plan", path, "--out", tmp_path / "out", "-q")
    assert quiet.stderr == ""
    assert len(quiet.stdout.splitlines()) == 1
    assert quiet.stdout.startswith("CERTIFIED")
    verbose = _scopt("plan", path, "--out", tmp_path / "out", "-v")
    assert "tried start" in verbose.stdout
    assert "--verbose and --quiet exclude each other" in _scopt("plan", path, "-q", "-v").stderr
