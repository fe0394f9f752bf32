"""The numbered examples run unchanged and print what their docstrings announce."""

import contextlib
import io
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name: str, folder: Path, *arguments: str) -> str:
    """Run an example as a program and return what it prints."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_here(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run an example in this process, which has imported the planner already, and return what it prints."""
    monkeypatch.setattr(sys, "argv", [name])
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return printed.getvalue()


def test_reach_a_pose_is_certified_and_leaves_a_viewer(tmp_path, monkeypatch):
    out = run_here("01_reach_a_pose.py", tmp_path, monkeypatch)
    assert out.startswith("CERTIFIED")
    assert (tmp_path / out.splitlines()[-1]).is_file()


def test_an_added_cost_lifts_the_elbow(tmp_path, monkeypatch):
    lines = run_here("02_add_a_cost.py", tmp_path, monkeypatch).splitlines()
    heights = [float(re.search(r"elbow (-?[\d.]+) m", line).group(1)) for line in lines]
    assert heights[1] > heights[0] + 0.2
    assert all("converged" in line for line in lines)


def test_a_term_without_a_derivative_raises_the_elbow_of_a_certified_reach(tmp_path, monkeypatch):
    without, with_term, check = run_here("03_a_term_without_a_derivative.py", tmp_path, monkeypatch).splitlines()
    ends = [float(re.search(r"([\d.]+) m at the end", line).group(1)) for line in (without, with_term)]
    assert ends[1] > ends[0] + 0.1
    assert without.endswith("CERTIFIED")
    assert with_term.endswith("CERTIFIED")
    assert "agree with central differences" in check


def test_a_convex_term_leaves_joints_at_rest_and_holds_the_base(tmp_path, monkeypatch):
    lines = run_here("04_a_convex_term.py", tmp_path, monkeypatch).splitlines()
    pattern = r"CERTIFIED, base moves ([\d.]+) mm, \d+ joints turn by ([\d.]+) rad"
    found = [re.search(pattern, line).groups() for line in lines[:2]]
    (free_base, free_turn), (held_base, least_turn) = ((float(base), float(turn)) for base, turn in found)
    assert least_turn < 0.8 * free_turn
    assert held_base < 7.5 < free_base
    assert "is concave" in lines[2]


def test_a_driver_is_told_a_plan_with_a_pause_and_a_moved_target(tmp_path, monkeypatch):
    lines = run_here("06_drive_a_robot.py", tmp_path, monkeypatch).splitlines()
    assert lines[0] == "CERTIFIED"
    assert sum("l_arm_elx" in line for line in lines) >= 4
    modes = [re.search(r" s  (\w+) +reach", line).group(1) for line in lines if "reach" in line]
    assert modes == ["running", "paused", "running", "done"]
    assert lines[-1].startswith("TRACKED")


def test_a_robot_over_udp_carries_out_a_plan_with_the_lag_of_its_servos(tmp_path):
    # Its robot runs on the wall clock: on a busy machine its readings may come too late, which the guards notice.
    runs = (run("08_a_robot_over_udp.py", tmp_path).splitlines() for _ in range(4))
    lines = next(lines for lines in runs if lines[-1].startswith("TRACKED"))
    assert lines[0] == "CERTIFIED"
    assert sum("l_arm_elx" in line for line in lines) >= 3


@pytest.fixture
def planning_server(tmp_path):
    """Address of a running server with one worker."""
    program = "from service.cli.app import main; main()"
    options = ["serve", "--listen", "127.0.0.1:0", "--workers", "1", "--drain", "0", "--data", str(tmp_path / "kept")]
    process = subprocess.Popen([sys.executable, "-c", program, *options], stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().removeprefix("listening on ").strip()
    finally:
        process.terminate()
        process.communicate(timeout=120)


def test_a_client_watches_its_plan_and_reads_the_trajectory(tmp_path, planning_server):
    lines = run("05_client.py", tmp_path, planning_server).splitlines()
    assert any(re.fullmatch(r" *\d+ % reach", line) for line in lines)
    assert any(re.fullmatch(r" +iteration \d+: merit .+", line) for line in lines)
    assert lines[-3] == "CERTIFIED"
    assert re.fullmatch(r"l_arm_elx -?[\d.]+ -> -?[\d.]+ rad in [\d.]+ s", lines[-2])
    assert (tmp_path / lines[-1].split(" shows")[0]).is_file()
    assert (EXAMPLES / "05_client.py").read_text().count("\n") < 60


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("[0-9]*.py")), ids=lambda path: path.name)
def test_examples_are_short_and_say_what_the_reader_will_see(path):
    text = path.read_text()
    assert text.startswith('"""')
    assert text.count("\n") < 100
