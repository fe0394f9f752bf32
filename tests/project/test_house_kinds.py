"""Kinds of tasks and detectors: one registry knows them all, and another package adds one with a few files."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from little_scan import little_scan

from perception import write_npz
from service.request.file import parse_request, request_hash
from service.request.tasks.registry import SHIPPED

ROOT = Path(__file__).parents[2]
FIELDS = {kind.name for kind in SHIPPED}
OF_SETUP = {"program": "trajopt", "stances": "contacts"}
MOST = 2  # kinds that a module may tell apart: a stage that knows three would soon have to know all

WAVE = {
    "scopt_wave-1.dist-info/entry_points.txt": "[scopt_task_kinds]\nwave = wave_request:KIND\n",
    "wave_request.py": """
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from service.request.fields import SECTION, Name, Number
from service.request.tasks.kind import TaskKind, TaskSection


@dataclass(config=SECTION)
class WaveRequest(TaskSection):
    joint: Name
    by_rad: Annotated[Number, Field(gt=0.0, le=1.0)] = 0.3


KIND = TaskKind("wave", WaveRequest, "wave_demand:PART", "wave_plan:PART")
""",
    "wave_demand.py": """
from dataclasses import dataclass

from service.demands.kind import DemandPart
from service.demands.phase import TaskPhase
from service.demands.task_demand import RecordDemand, TaskDemand
from service.start.configuration import find_unknown_joints
from service.verify import JointTarget

SIDES = {"out": 1.0, "back": 0.0}


def make_target(section, robot, start, name):
    value = start[robot.joint_names.index(section.joint)] + SIDES[name] * section.by_rad
    return JointTarget(section.joint, float(value), 1e-3, 0.0)


@dataclass(frozen=True)
class WaveDemand(TaskDemand):
    section: object

    def demand_phases(self, world, robot, recorded):
        names = [phase.name for phase in recorded.phases]
        problems = () if names == list(SIDES) else (f"the phases are {', '.join(names)}; a wave has out, back",)
        goals = {name: (make_target(self.section, robot, world.start, name),) for name in SIDES}
        return RecordDemand(tuple(TaskPhase(name, goal=goals.get(name, ())) for name in names), problems)


class WavePart(DemandPart):
    def make_demand(self, section, world, shown, program):
        return WaveDemand(section)

    def list_name_problems(self, section, request, robot):
        return iter(find_unknown_joints(robot, [section.joint], "task.wave.joint"))


PART = WavePart()
""",
    "wave_plan.py": """
from service.body.paths import straight_path
from service.body.task_plan import PlannedPhase, Stuck, TaskPlan
from service.demands.phase import TaskPhase
from service.tasks.kind import PlanPart
from wave_demand import SIDES, make_target


class WavePart(PlanPart):
    def plan(self, section, setup, solver):
        robot, q, phases = setup.robot, solver.body.nominal, []
        for name in SIDES:
            target = make_target(section, robot, setup.start, name)
            end = q.copy()
            end[robot.joint_names.index(section.joint)] = target.value
            solved = solver.solve_trajectory(name, straight_path(q, end, 8), {0: q, 7: end})
            phases.append(PlannedPhase(TaskPhase(name, goal=(target,)), solved.x, solved.is_feasible))
            if not solved.is_feasible:
                yield TaskPlan(solver.body, tuple(phases), stuck=Stuck(name, solved))
                return
            q = end
        yield TaskPlan(solver.body, tuple(phases), notes=("waved",))


PART = WavePart()
""",
}

LID = {
    "scopt_lid-1.dist-info/entry_points.txt": "[scopt_detectors]\nlid = lid_detector:DETECTOR\n",
    "lid_detector.py": """
import numpy as np

from perception.detect.shared.detection import Detection
from perception.detect.shared.detector import Detector


def detect_lid(view, hint):
    points = view.cloud.points[view.cloud.points[:, 2] > 0.3]
    pose = np.eye(4)
    pose[:3, 3] = points.mean(axis=0)
    return [Detection("lid", pose, {"width": float(np.ptp(points[:, 1]))}, 0.8, {}, points[:50])]


DETECTOR = Detector(detect_lid)
""",
}


def _write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text)
    return folder


def _python(package: Path | None, program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a program in a process that finds the package."""
    places = [str(place) for place in (ROOT, package) if place is not None]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
    words = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, env=environment, timeout=300, check=False)


def _scopt(package: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return _python(package, "from service.cli import main; main()", *arguments)


HASH = "request_hash(parse_request({'robot': {'name': 'atlas'}, 'task': {'valve': {}}}))"
SEVERAL = f"""
import json, sys
from typer.testing import CliRunner
from service.cli.app import app
from service.request.file import parse_request, request_hash
ends = [CliRunner().invoke(app, words) for words in json.loads(sys.argv[1])]
print(json.dumps([[(end.exit_code, " ".join(end.output.split())) for end in ends], {HASH}]))
"""


@dataclass(frozen=True)
class Waved:
    """A wave's result, and exit code and output of the commands that made it, verified it, and refused others."""

    data: dict[str, Any]
    planned: tuple[int, str]
    verified: tuple[int, str]
    farther: tuple[int, str]
    misspelt: tuple[int, str]
    hash_of_another: str


@pytest.fixture(scope="module")
def waved(tmp_path_factory: pytest.TempPathFactory) -> Waved:
    """What one process does with a package that adds the task of waving."""
    package, folder = _write(tmp_path_factory.mktemp("wave"), WAVE), tmp_path_factory.mktemp("planned")
    text = "robot: {name: atlas}\nstart: {posture: stand}\ntask: {wave: {joint: l_arm_wry, by_rad: 0.4}}\n"
    request, farther, misspelt = (folder / f"{name}.yaml" for name in ("wave", "farther", "misspelt"))
    request.write_text(text)
    farther.write_text(text.replace("0.4", "0.5"))
    misspelt.write_text(text.replace("l_arm_wry", "l_arm_wrz"))
    commands = (
        ("plan", request, "--out", folder / "out"),
        ("verify", folder / "out", "--request", request),
        ("verify", folder / "out", "--request", farther),
        ("plan", misspelt, "--out", folder / "other"),
    )
    done = _python(package, SEVERAL, json.dumps([[str(word) for word in words] for words in commands]))
    assert done.returncode == 0, done.stdout + done.stderr
    ends, hash_of_another = json.loads(done.stdout.splitlines()[-1])
    data = json.loads((folder / "out" / "result.json").read_text())
    return Waved(data, *((code, said) for code, said in ends), hash_of_another)


def test_a_kind_of_another_package_is_planned_certified_and_verified_from_a_file(waved: Waved) -> None:
    assert len(WAVE) <= 4
    assert waved.planned[0] == 0, waved.planned[1]
    data = waved.data
    assert data["verdict"] == "CERTIFIED"
    assert [phase["name"] for phase in data["phases"]] == ["out", "back"]
    assert data["request"]["task"]["wave"] == {"joint": "l_arm_wry", "by_rad": 0.4}
    assert "waved" in data["notes"]
    code, said = waved.verified
    assert (code, "CERTIFIED" in said) == (0, True), said
    assert "with the demands of wave_demand" in said


def test_a_record_of_such_a_kind_is_held_to_the_request(waved: Waved) -> None:
    code, said = waved.farther
    assert (code != 0, "Traceback" in said) == (True, False), said
    assert "unknown joint 'l_arm_wrz' in task.wave.joint" in waved.misspelt[1]


def test_an_added_kind_does_not_change_the_data_of_other_requests(waved: Waved) -> None:
    assert waved.hash_of_another == request_hash(parse_request({"robot": {"name": "atlas"}, "task": {"valve": {}}}))


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"wave_request.py": "x = 1\nKIND = nothing\n"}, "wave_request.py, line 2"),
        ({"wave_request.py": "KIND = 7\n"}, "expected a TaskKind named 'wave'"),
    ],
)
def test_a_package_with_an_error_is_named_with_its_line(tmp_path: Path, files: dict[str, str], words: str) -> None:
    package = _write(tmp_path, {**WAVE, **files})
    done = _scopt(package, "plan", ROOT / "examples" / "requests" / "joint_goal.yaml", "--out", tmp_path / "out")
    assert done.returncode != 0
    assert "entry point 'wave' of scopt_task_kinds" in done.stderr
    assert words in " ".join(done.stderr.split())


def test_a_detector_of_another_package_finds_its_objects(tmp_path: Path) -> None:
    package = _write(tmp_path / "lid", LID)
    assert len(LID) <= 2
    write_npz(tmp_path / "scan.npz", little_scan())
    done = _scopt(package, "detect", "lid", tmp_path / "scan.npz", "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    hits = json.loads(done.stdout)["hits"]
    assert [hit["kind"] for hit in hits] == ["lid"]


def _find_kinds(path: Path) -> set[str]:
    """Return the kinds that a module tells apart: fields of a task or of what is made of one, or names in a list."""
    kinds: set[str] = set()
    tree = ast.parse(path.read_text())
    tree.body = [
        node for node in tree.body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            owner = node.value.attr if isinstance(node.value, ast.Attribute) else getattr(node.value, "id", "")
            kinds |= {node.attr} & FIELDS if owner == "task" else set()
            kinds |= {"reach"} if (owner, node.attr) == ("request", "goal") else set()
            kinds |= {OF_SETUP[node.attr]} if owner == "setup" and node.attr in OF_SETUP else set()
        elif isinstance(node, ast.Tuple | ast.List | ast.Set):
            words = {entry.value for entry in node.elts if isinstance(entry, ast.Constant)}
            kinds |= words & FIELDS if {"valve", "egress"} <= words else set()
        elif isinstance(node, ast.ImportFrom):
            parts = (node.module or "").split(".")
            if parts[:2] in (["service", "demands"], ["service", "tasks"]) and len(parts) > 2 and parts[2] in FIELDS:
                kinds.add(parts[2])
    return kinds


def test_only_the_registry_tells_three_kinds_apart() -> None:
    knowing = {
        path.relative_to(ROOT).as_posix(): kinds
        for path in sorted((ROOT / "service").rglob("*.py"))
        if len(kinds := _find_kinds(path)) > MOST
    }
    registry = (ROOT / "service/request/tasks/registry.py").read_text()
    assert all(f'TaskKind("{name}"' in registry for name in FIELDS)
    assert knowing == {}
