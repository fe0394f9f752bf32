"""The numbered examples run as they are and print what their first line promises."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name)], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_reach_a_pose_is_certified_and_leaves_a_viewer(tmp_path):
    out = run("01_reach_a_pose.py", tmp_path)
    assert out.startswith("CERTIFIED")
    assert (tmp_path / out.splitlines()[-1]).is_file()


def test_an_added_cost_lifts_the_elbow(tmp_path):
    lines = run("02_add_a_cost.py", tmp_path).splitlines()
    heights = [float(re.search(r"elbow (-?[\d.]+) m", line).group(1)) for line in lines]
    assert heights[1] > heights[0] + 0.2
    assert all("converged" in line for line in lines)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("[0-9]*.py")), ids=lambda path: path.name)
def test_examples_are_short_and_say_what_the_reader_will_see(path):
    text = path.read_text()
    assert text.startswith('"""')
    assert text.count("\n") < 100
