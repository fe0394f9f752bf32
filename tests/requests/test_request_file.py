"""Request files: what is read, and the one line every wrong field earns."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import RequestError
from service.request.file import load_request, load_section, parse_request, replace_cloud, request_hash, to_json
from service.request.schema import PlanRequest, PoseRequest, StartRequest

ROOT = Path(__file__).parents[2]
ORDERS = [(("neck_ry", 0.1), ("back_bkz", 0.2)), (("back_bkz", 0.2), ("neck_ry", 0.1))]
MINIMAL = "robot: {name: atlas}\ngoal: {posture: stand}\n"


def _write(folder: Path, text: str) -> Path:
    path = folder / "request.yaml"
    path.write_text(text)
    return path


def _problems(folder: Path, text: str) -> tuple[str, ...]:
    with pytest.raises(RequestError) as caught:
        load_request(_write(folder, text))
    problems = caught.value.problems
    assert all("\n" not in line and line.startswith("request.yaml: ") for line in problems)
    return tuple(line.removeprefix("request.yaml: ") for line in problems)


def test_a_minimal_request_has_stated_defaults(tmp_path: Path) -> None:
    request = load_request(_write(tmp_path, MINIMAL))
    assert request.robot.name == "atlas"
    assert request.goal is not None
    assert request.goal.posture == "stand"
    assert request.scene.floor is None
    assert request.options.balance_margin_m == 0.02
    assert request.resolve("cloud.pcd") == tmp_path / "cloud.pcd"


@pytest.mark.parametrize("path", sorted((ROOT / "examples" / "requests").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_example_request_is_valid(path: Path) -> None:
    assert isinstance(load_request(path), PlanRequest)


def _keys(section: type, prefix: str = "") -> set[str]:
    """Every key of the schema, dotted; poses and what stands in lists is left out."""
    names = set()
    for name, hint in get_type_hints(section).items():
        kinds = (hint,) if get_origin(hint) in (None, tuple) else get_args(hint)
        inner = [kind for kind in kinds if dataclasses.is_dataclass(kind) and kind is not PoseRequest]
        names |= _keys(inner[0], f"{prefix}{name}.") if inner else {prefix + name}
    return names - {"folder"}


def test_every_key_is_documented_and_every_documented_key_exists() -> None:
    documented = set()
    for line in (ROOT / "docs" / "request-format.md").read_text().splitlines():
        if line.startswith("| `"):
            first, *rest = re.findall(r"`([a-z_.]+)`", line.split("|")[1])
            parent = first.rpartition(".")[0]
            documented |= {first, *(name if "." in name else f"{parent}.{name}" for name in rest)}
    keys = _keys(PlanRequest) | {"start.joint_names", "start.positions"}
    assert documented | {"start.joint_names", "start.positions"} == keys


def test_a_valve_task_hooks_and_turns_once_by_default() -> None:
    request = parse_request({"robot": {"name": "atlas"}, "task": {"valve": {}}})
    assert request.task is not None
    assert request.task.valve is not None
    assert (request.task.valve.mode, request.task.valve.hand, request.task.valve.turn_deg) == ("hook", "auto", 360.0)


def test_numbers_in_exponent_form_are_numbers(tmp_path: Path) -> None:
    assert load_request(_write(tmp_path, MINIMAL + "options: {margin_m: 1e-2}")).options.margin_m == 0.01


def test_a_request_that_is_written_and_read_again_keeps_its_quaternion_to_the_last_digit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        wxyz = rng.normal(size=4)
        wxyz = [float(value) for value in wxyz / np.linalg.norm(wxyz) * rng.uniform(0.9995, 1.0005)]
        once = PoseRequest((0.0, 0.0, 0.0), wxyz).quaternion_wxyz
        assert PoseRequest((0.0, 0.0, 0.0), once).quaternion_wxyz == once


def test_a_quaternion_rounded_to_three_digits_is_normalised(tmp_path: Path) -> None:
    text = MINIMAL + "start: {base: {position: [0, 0, 1], quaternion_wxyz: [0.707, 0, 0, 0.707]}}"
    base = load_request(_write(tmp_path, text)).start.base
    assert base is not None
    assert math.hypot(*base.quaternion_wxyz) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("extra", "problem"),
    [
        ("start: {joints: {a: .nan}}", "start.joints.a: a finite number is needed, got nan"),
        ("start: {joints: {a: -.inf}}", "start.joints.a: a finite number is needed, got -inf"),
        ("start: {joints: {a: 'NaN'}}", "start.joints.a: a number is needed, got 'NaN'"),
        ("start: {joints: {a: yes}}", "start.joints.a: a number is needed, got True"),
        ("start: {posture: on}", "start.posture: a text is needed, got True; YAML reads yes, no, on and off as true"),
        ("start: {joints: [1]}", "start.joints: a mapping is needed, got [1]"),
        ("start: null", "start: a mapping is needed, got None"),
        (
            "start: {joint_names: [a, b], positions: [1]}",
            "start: joint_names has 2 entries and positions has 1; they must be as many",
        ),
        ("start: {joint_names: [a, a], positions: [1, 2]}", "start: joint 'a' is given twice"),
        ("start: {base: {position: [0, 0]}}", "start.base.position: entry 3 is missing, got [0, 0]"),
        (
            "start: {base: {position: [0, 0, 0], quaternion_wxyz: [1, 1, 0, 0]}}",
            "start.base.quaternion_wxyz: a quaternion (w, x, y, z) needs length 1, not 1.41421; "
            "expected [0.707107, 0.707107, 0, 0]",
        ),
        (
            "start: {base: {position: [0, 0, 0], quaternion_wxyz: [0, 0, 0, 0]}}",
            "start.base.quaternion_wxyz: a quaternion (w, x, y, z) needs length 1, not 0; expected [1, 0, 0, 0]",
        ),
        (
            "start: {base: {position: [0, 0, 862]}}\nscene: {floor: 5000}",
            "scene.floor: expected true, false or a height in metres",
        ),
        (
            "start: {base: {position: [0, 0, 5000]}}",
            "start.base.position[2]: 5000 m is beyond 1000 m; are these millimetres? Use 5.",
        ),
        ("options: {wayponts: 3}", "options: unknown key 'wayponts'; expected waypoints, …"),
        ("options: {waypoints: 3.5}", "options.waypoints: a whole number is needed, got 3.5"),
        ("options: {waypoints: 1000000}", "options.waypoints: expected at most 500, got 1000000"),
        ("options: {qp: osqp}", "options.qp: expected 'piqp', 'clarabel' or 'cvxpy', got 'osqp'"),
        ("options: {margin_m: -1}", "options.margin_m: at least 0 is needed, got -1"),
        ("options: {time_limit_s: .inf}", "options.time_limit_s: a finite number is needed, got inf"),
        ("options: {time_limit_s: 0}", "options.time_limit_s: more than 0 is needed, got 0"),
        ("options: {velocity_scale: 1.0e-300}", "options.velocity_scale: at least 0.001 is needed, got 1e-300"),
        ("scene: {cloud: 3}", "scene.cloud: a file, or a list of {file, position, quaternion_wxyz}, is needed, got 3"),
        ("scene: {cloud: ''}", "scene.cloud: a text with at least 1 character is needed, got ''"),
        (
            "scene: {cloud: []}",
            "scene.cloud: a file, or a list of {file, position, quaternion_wxyz}, is needed, got []",
        ),
        ("scene: {cloud: [a.pcd]}", "scene.cloud[0]: a mapping is needed, got 'a.pcd'"),
        ("scene: {cloud: [{}]}", "scene.cloud[0].file: is missing"),
        (
            "scene: {cloud: [{file: a.pcd, position: [0, 0, 2.0e+8]}]}",
            "scene.cloud[0].position[2]: expected at most 1e+08",
        ),
        (
            "scene: {cloud: [{file: a.pcd, yaw: 1}]}",
            "scene.cloud[0]: unknown key 'yaw'; expected file, position, quaternion_wxyz",
        ),
        ("scene: {cloud: a.pcd, unit: yard}", "scene.unit: expected 'm', 'cm', 'mm', 'km', 'in' or 'ft', got 'yard'"),
        ("scene: {cloud: a.bag, message: last}", "scene.message: expected a whole number or 'all', got 'last'"),
        ("scene: {cloud: a.bag, message: true}", "scene.message: expected a whole number or 'all', got True"),
        ("scene: {floor: .nan}", "scene.floor: expected true, false or a height in metres, got nan"),
        ("scene: {obstacles: 3}", "scene.obstacles: a list is needed, got 3"),
        (
            "scene: {obstacles: [{name: a, type: bax, size: [1, 1, 1]}]}",
            "scene.obstacles[0]: unknown type 'bax'; expected box, sphere, cylinder, capsule, convex, mesh",
        ),
        ("scene: {obstacles: [{name: a, type: box, size: [1, 1, -1]}]}", "scene.obstacles[0].size[2]: more than 0"),
        ("scene: {obstacles: [{name: a, type: box}]}", "scene.obstacles[0].size: is missing"),
        (
            "scene: {obstacles: [{name: a, type: box, size: [1, 2, 3, 4]}]}",
            "scene.obstacles[0].size: expected at most 3 entries, got [1, 2, 3, 4]",
        ),
        (
            "scene: {obstacles: [{name: a, type: box, size: [1, 1, 1], radius: 1}]}",
            "scene.obstacles[0]: unknown key 'radius'; expected in_scan, name, position, quaternion_wxyz, type, size",
        ),
        (
            "scene: {obstacles: [{name: a, type: sphere, radius: 1}, {name: a, type: sphere, radius: 1}]}",
            "scene: obstacle name 'a' is given twice",
        ),
        (
            f"start: {{joint_names: [{'a, ' * 1001}], positions: []}}",
            "start.joint_names: expected at most 1000 entries",
        ),
        (
            f"start: {{joints: {{{', '.join(f'j{i}: 0' for i in range(1001))}}}}}",
            "start.joints: expected at most 1000 entries",
        ),
        ("start: {joint_names: [a, b], joints: {b: 0}, positions: [0, 0]}", "start: joint 'b' is given twice"),
        ("keep: [{link: a, relative_to: a}]", "keep[0]: link and relative_to are both 'a'; two links are needed"),
        ("keep: [{link: a, relativ_to: b}]", "keep[0]: unknown key 'relativ_to'; expected relative_to, …"),
        ("keep: [{relative_to: b}]", "keep[0].link: is missing"),
        ("keep: [{link: a, position: [0, 1]}]", "keep[0].position: entry 3 is missing, got [0, 1]"),
        ("keep: [{link: a, position_tolerance_m: 0}]", "keep[0].position_tolerance_m: at least 0.0005 is needed"),
        ("keep: [{link: a, rotation_tolerance_deg: 0.01}]", "keep[0].rotation_tolerance_deg: at least 0.05 is needed"),
        ("keep: [{link: a, free_axis: w}]", "keep[0].free_axis: expected 'none', 'x', 'y' or 'z', got 'w'"),
        ("keep: {link: a}", "keep: a list is needed"),
        (
            "attached: [{name: b, link: a, type: capsule, radius: 1, height: 1}]",
            "attached[0]: unknown type 'capsule'; expected box, sphere, cylinder, convex, mesh",
        ),
        ("attached: [{name: b, type: box, size: [1, 1, 1]}]", "attached[0].link: is missing"),
        ("attached: [{name: b, link: a, type: box, size: [1, 1, 0]}]", "attached[0].size[2]: more than 0 is needed"),
        ("attached: [{name: b, link: a, type: sphere, radius: 1, mass_kg: -1}]", "attached[0].mass_kg: at least 0"),
        (
            "attached: [{name: b, link: a, type: sphere, radius: 1, touch: [c]}]",
            "attached[0]: unknown key 'touch'; expected touches",
        ),
        ("task: {valve: {}}", "exactly one of goal, task is needed, not goal and task"),
        ("folder: /etc", "unknown key 'folder'; expected robot, start, scene, goal, task, keep, …"),
        ("robot: {name: x}", "line 3: key 'robot' is given twice"),
        ("start: !!python/object/apply:os.system ['true']", "line 3: the tag"),
        ("start: &a {posture: x}\nscene: *a", "line 4: alias '*a' is not read; write the value out"),
    ],
)
def test_a_wrong_field_earns_one_line(tmp_path: Path, extra: str, problem: str) -> None:
    (line,) = _problems(tmp_path, MINIMAL + extra)
    assert line.startswith(problem)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "a mapping is needed, got None"),
        ("- 3", "a mapping is needed, got [3]"),
        ("goal: {posture: stand}", "robot: is missing"),
        ("robot: {name: atlas}", "exactly one of goal, task is needed, none is given"),
        ("robot: {}\ngoal: {posture: s}", "robot: exactly one of name, urdf is needed, none is given"),
        (
            "robot: {name: a, urdf: b}\ngoal: {posture: s}",
            "robot: exactly one of name, urdf is needed, not name and urdf",
        ),
        (
            f"robot: {{urdf: a, package_dirs: [{'a, ' * 21}]}}\ngoal: {{posture: s}}",
            "robot.package_dirs: expected at most 20 entries",
        ),
        (
            "robot: {name: a, srdf: b}\ngoal: {posture: s}",
            "robot: srdf and package_dirs belong to a robot given by urdf",
        ),
        (
            "robot: {name: a}\ntask: {valve: {}}\nkeep: [{link: a}]",
            "keep belongs to a goal; a task knows itself what it holds",
        ),
        (
            "robot: {name: a}\ngoal: {poses: [{link: l, position: [0, 0, 0]}, {link: l, position: [0, 0, 1]}]}",
            "goal: link 'l' has two poses; expected one for each link",
        ),
        (
            "robot: {name: a}\ntask: {valv: {}}",
            "task: unknown key 'valv'; expected valve, …",
        ),
        (
            "robot: {name: a}\ntask: {valve: {hand: lft}}",
            "task.valve.hand: expected 'left', 'right' or 'auto', got 'lft'",
        ),
        ("robot: {name: a}\ntask: {valve: {turn_deg: 1500}}", "task.valve.turn_deg: expected at most 1440, got 1500"),
        ("robot: {name: a}\ntask: {valve: {turn_deg: 0}}", "task.valve: turn_deg is 0: nothing to do"),
        ("robot: {name: a}\ntask: {valve: {axis: [0, 0, 0]}}", "task.valve: axis has no length"),
        (
            "robot: {name: a}\ngoal: {joints: {}}",
            "goal: exactly one of joints, poses, posture, any_of is needed, none is given",
        ),
        (
            "robot: {name: a}\ngoal: {poses: [{link: l, position: [0, 0, 0], free_axis: z}]}",
            "goal.poses[0]: free_axis needs a quaternion_wxyz",
        ),
        ("a: [", "line 2: did not find expected node content"),
        ("robot: \x00", "no valid YAML"),
        ("[" * 50, "line 1: nested deeper than 20 levels"),
    ],
)
def test_a_wrong_file_earns_one_line(tmp_path: Path, text: str, problem: str) -> None:
    (line,) = _problems(tmp_path, text)
    assert line.startswith(problem)


def test_every_problem_is_told_but_not_without_end(tmp_path: Path) -> None:
    joints = ", ".join(f"j{i}: x" for i in range(30))
    with pytest.raises(RequestError) as caught:
        load_request(_write(tmp_path, MINIMAL + f"start: {{joints: {{{joints}}}}}"))
    assert len(caught.value.problems) == 30
    lines = str(caught.value).splitlines()
    assert len(lines) == 11
    assert lines[-1] == "and 20 more"


def test_files_that_are_no_text_or_too_large_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "request.yaml"
    for content, problem in (
        (b"\xff\xfe\x00", "no UTF-8 text"),
        (b"#" * 1_000_001, "1000001 bytes long; expected at most"),
    ):
        path.write_bytes(content)
        with pytest.raises(RequestError, match=problem):
            load_request(path)
    with pytest.raises(RequestError, match=r"missing\.yaml: cannot be read: No such file"):
        load_request(tmp_path / "missing.yaml")
    with pytest.raises(RequestError, match="is not a file"):
        load_request(tmp_path)


def test_a_number_of_5000_digits_is_refused(tmp_path: Path) -> None:
    (line,) = _problems(tmp_path, MINIMAL + f"options: {{margin_m: {'9' * 5000}}}")
    assert len(line) < 300


def test_the_hash_is_of_the_meaning_not_of_the_file_or_its_place(tmp_path: Path) -> None:
    plain = load_request(_write(tmp_path, MINIMAL))
    other = tmp_path / "elsewhere"
    other.mkdir()
    spelled_out = load_request(_write(other, "# a comment\n" + MINIMAL + "start: {}\noptions: {seed: 0}\n"))
    assert request_hash(plain) == request_hash(spelled_out)
    joints = [parse_request({"robot": {"name": "atlas"}, "goal": {"joints": dict(order)}}) for order in ORDERS]
    assert request_hash(joints[0]) == request_hash(joints[1])
    assert re.fullmatch(r"sha256:[0-9a-f]{64}", request_hash(plain))
    assert request_hash(plain) != request_hash(load_request(_write(tmp_path, MINIMAL + "options: {seed: 1}")))


def test_json_of_a_request_is_a_request() -> None:
    request = load_request(ROOT / "examples" / "requests" / "pose_goal.yaml")
    data = json.loads(json.dumps(to_json(request), allow_nan=False))
    again = parse_request(data)
    assert request_hash(again) == request_hash(request)


def test_several_clouds_come_with_their_poses() -> None:
    scene: dict[str, Any] = {"cloud": [{"file": "a.pcd"}, {"file": "b.e57", "position": [4e5, 5e6, 0]}], "unit": "mm"}
    request = parse_request({"robot": {"name": "atlas"}, "goal": {"posture": "stand"}, "scene": scene})
    a, b = request.scene.cloud_files
    assert (a.file, a.transform) == ("a.pcd", None)
    assert (b.file, b.transform) == ("b.e57", (4e5, 5e6, 0.0, 1.0, 0.0, 0.0, 0.0))
    assert parse_request(to_json(request)).scene == request.scene


def test_another_cloud_is_found_from_the_request_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    request = load_request(_write(tmp_path, MINIMAL))
    other = tmp_path / "scans"
    other.mkdir()
    monkeypatch.chdir(other)
    changed = replace_cloud(request, Path("scan.pcd"))
    assert changed.scene.cloud == "scans/scan.pcd"
    assert changed.resolve("scans/scan.pcd") == other / "scan.pcd"


def test_a_start_file_is_read_like_a_request(tmp_path: Path) -> None:
    path = tmp_path / "start.yaml"
    path.write_text("posture: stand\njoints: {neck_ry: 0.1}\n")
    assert load_section(StartRequest, path).joints == {"neck_ry": 0.1}
    path.write_text("postur: stand\n")
    with pytest.raises(RequestError, match=r"start\.yaml: unknown key 'postur'; expected posture, joints, "):
        load_section(StartRequest, path)


KEYS = st.sampled_from(
    [
        "robot",
        "name",
        "urdf",
        "start",
        "joints",
        "positions",
        "base",
        "position",
        "quaternion_wxyz",
        "scene",
        "floor",
        "obstacles",
        "type",
        "size",
        "goal",
        "poses",
        "link",
        "task",
        "valve",
        "hint",
        "options",
        "seed",
        "box",
        "x",
    ]
)
DATA = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(KEYS, DATA, max_size=5))
def test_arbitrary_data_is_a_request_or_a_request_error(data: dict[str, Any]) -> None:
    problems: tuple[str, ...] = ()
    try:
        request_hash(parse_request(data))
    except RequestError as error:
        problems = error.problems
    assert all(line and "\n" not in line for line in problems)
