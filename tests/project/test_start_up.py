"""What a plan loads: libraries and parts that few requests need come later."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
RARE = (
    "cvxpy",
    "matplotlib",
    "mujoco",
    "ompl",
    "open3d",
    "perception.detect.registry",
    "perception.perceived",
    "scipy.fft",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.stats",
    "service.client",
    "service.demands.contacts.kind",
    "service.demands.door.demand",
    "service.demands.mechanism.given",
    "service.demands.valve",
    "service.execution",
    "service.explain.narrow",
    "service.replay",
    "service.scan",
    "service.server",
    "service.simulation",
    "service.tasks.door",
    "service.tasks.egress",
    "service.tasks.steps",
    "service.tasks.valve",
    "service.trajopt",
    "service.viewer",
)
"""Modules that a plan of a joint goal does not load, with all that is in them."""
HULLS = "scipy.spatial"  # loaded by the first hull or rotation: an eighth of what importing the planner takes

PROGRAM = """
import json, sys
from pathlib import Path
import service.planner
print(json.dumps(sorted(sys.modules)))
from service.request.file import load_request
verdict = service.planner.plan(load_request(Path("examples/requests/joint_goal.yaml"))).verdict
assert verdict.value == "CERTIFIED", verdict
print(json.dumps(sorted(sys.modules)))
"""


def test_a_joint_goal_loads_nothing_that_few_requests_need() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, cwd=ROOT)
    imported, loaded = (json.loads(line) for line in done.stdout.splitlines()[-2:])
    assert "scopt.sqp" in imported
    assert HULLS not in imported
    assert [name for name in loaded if name.startswith(tuple(f"{rare}." for rare in RARE)) or name in RARE] == []


def test_a_request_without_a_task_builds_no_validator_of_tasks() -> None:
    program = (
        "from service.request.file import parse_request\n"
        "from service.request.tasks.registry import TaskRequest\n"
        "parse_request({'robot': {'name': 'atlas'}, 'goal': {'joints': {'l_arm_elx': 1.2}}})\n"
        "print(TaskRequest.__pydantic_complete__)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == ["False"]
