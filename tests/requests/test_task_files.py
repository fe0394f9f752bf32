"""Task files: expressions, parameters, and the requests that they make."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import RequestError
from service.proto.planner.v1.request_pb2 import MotionRequest
from service.request.file import load_request, parse_request, to_json
from service.request.task_files import find_task_file, list_task_files
from service.request.task_files.expressions import ExpressionError, evaluate, fill_in
from service.wire.requests import request_from_message

EXAMPLES: dict[str, dict[str, Any]] = {
    "valve": {},
    "door": {"opens": "push"},
    "button": {"at": [0.7, -0.2, 1.2]},
    "lever": {"pivot": [0.7, -0.2, 1.2]},
    "wipe": {"corner": [0.7, -0.2, 1.2]},
    "pick_place": {"object": "can", "to": [0.5, -0.2, 0.9]},
    "carry": {"object": "beam", "to": [0.5, 0.0, 0.9]},
    "plug": {"object": "plug", "to": [0.7, -0.2, 1.1]},
    "debris": {"object": "beam", "to": [0.5, 0.2, 0.9]},
    "hose": {"object": "hose", "to": [0.7, 0.0, 1.0]},
    "tend_machine": {"object": "part", "to": [0.6, 0.1, 0.9]},
    "cut": {"object": "drill", "tip": 0.1, "centre": [0.9, -0.1, 1.15], "wall": ["wall"]},
    "drill": {"centre": [0.8, -0.1, 1.15], "wall": ["wall"]},
}
KNOCK = """
help: Knock.
parameters:
  far: {type: number, unit: m, default: 0.05, range: [0.01, 0.2], help: way of the hand}
  way: {type: direction, help: direction}
task:
  steps:
    - move: {hand: right, by: {translation: "${far * unit(way)}"}, along: line}
"""


BOX = {"type": "box", "size": [0.05, 0.05, 0.1], "position": [0.5, -0.2, 0.8], "mass_kg": 1.0}


def using(name: str, **values: Any) -> dict[str, Any]:
    scene = {"objects": [{"name": values["object"], **BOX}]} if "object" in values else {}
    return {"robot": {"name": "atlas"}, "scene": scene, "task": {"use": name, "with": values}}


@pytest.fixture(name="folder")
def _folder(tmp_path: Path) -> Path:
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks" / "knock.yaml").write_text(KNOCK)
    return tmp_path


numbers = st.floats(-100.0, 100.0).map(lambda value: round(value, 3))


@given(a=numbers, b=numbers, c=numbers)
def test_sums_and_products_are_those_of_arithmetic(a: float, b: float, c: float) -> None:
    values = {"a": a, "b": b, "v": [a, b, c]}
    assert evaluate("a + 2 * (b - 1) / 4", values) == pytest.approx(a + 2.0 * (b - 1.0) / 4.0)
    np.testing.assert_allclose(evaluate("v * 2 - [1, 2, 3]", values), np.array([a, b, c]) * 2.0 - [1, 2, 3])
    np.testing.assert_allclose(evaluate("-v[1]", values), -b)
    np.testing.assert_allclose(evaluate("cross(v, [0, 0, 1])", values), np.cross([a, b, c], [0, 0, 1]), atol=1e-9)


@given(text=st.text(max_size=60))
def test_any_text_gives_a_value_or_one_error(text: str) -> None:
    with contextlib.suppress(ExpressionError):
        evaluate(text, {"a": 1.0, "v": [1.0, 2.0, 3.0]})


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("radius", "unknown parameter 'radius'; expected a, v"),
        ("__import__('os')", "is not evaluated"),
        ("a.real", "is not evaluated"),
        ("[x for x in v]", "is not evaluated"),
        ("v + 1", "multiplied"),
        ("v + [1]", "same length"),
        ("a / 0", "cannot be evaluated"),
        ("a ** 9999", "is not evaluated"),
        ("v[9]", "cannot be evaluated"),
        ("1e300 * 1e300", "not finite"),
        ("(" * 30 + "1" + ")" * 30 + " + " + "-" * 30 + "1", "nested deeper"),
        ("a + " * 100 + "a", "characters"),
        ("'b' * 3", "is no number"),
    ],
)
def test_what_is_no_arithmetic_is_refused(text: str, problem: str) -> None:
    with pytest.raises(ExpressionError, match=problem):
        evaluate(text, {"a": 1.0, "v": [1.0, 2.0, 3.0]})


def test_a_place_that_is_all_of_a_text_keeps_its_type_and_others_become_text() -> None:
    values = {"r": 0.25, "v": [1.0, 2.0, 3.0]}
    assert fill_in({"a": "${r}", "b": ["${v}", "size ${r} of ${v}"]}, values) == {
        "a": 0.25,
        "b": [[1.0, 2.0, 3.0], "size 0.25 of 1 2 3"],
    }


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_every_shipped_task_makes_a_valid_request(name: str) -> None:
    request = parse_request(using(name, **EXAMPLES[name]))
    assert request.task is not None
    assert parse_request(to_json(request)) == request  # what is recorded says everything


def test_every_shipped_task_has_an_example_here_and_help() -> None:
    files = {file.name: file for file in list_task_files()}
    assert set(files) >= set(EXAMPLES)
    assert all(own.help for file in files.values() for own in file.data.parameters.values())


def test_a_request_uses_a_file_beside_it(folder: Path) -> None:
    (folder / "go.yaml").write_text("robot: {name: atlas}\ntask: {use: knock, with: {way: [0, 0, 2], far: 0.1}}\n")
    request = load_request(folder / "go.yaml")
    assert request.task is not None
    (step,) = request.task.steps or ()
    assert step.move is not None
    assert step.move.by is not None
    assert step.move.by.translation == (0.0, 0.0, 0.1)


def test_a_users_file_comes_before_the_shipped_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "tasks" / "drill.yaml").write_text(KNOCK)
    monkeypatch.setenv("SCOPT_TASKS", str(folder / "tasks"))
    assert find_task_file("drill").path == folder / "tasks" / "drill.yaml"
    assert [file.path for file in list_task_files() if file.name == "drill"] == [folder / "tasks" / "drill.yaml"]


def test_a_message_uses_a_file_of_the_server() -> None:
    message = MotionRequest()
    message.robot.name = "atlas"
    message.task.use = "button"
    getattr(message.task, "with").update({"at": [0.7, -0.2, 1.2], "force": 12})
    request = request_from_message(message)
    assert request == parse_request(using("button", at=[0.7, -0.2, 1.2], force=12))


@pytest.mark.parametrize(
    ("task", "problem"),
    [
        ({"use": "dril"}, "task.use: unknown task 'dril'; expected drill, "),
        ({"use": "../drill"}, "task.use: expected the name of a task file, got '../drill'"),
        ({"use": 3}, "task.use: expected the name of a task file, got 3"),
        ({"use": "knock", "with": [1]}, "task.with: a mapping is needed, got [1]"),
        ({"use": "knock"}, "task.with.way: is missing; direction"),
        ({"use": "knock", "with": {"way": [0, 0, 1], "far": 0.9}}, "task.with.far: expected 0.01 to 0.2 m, got 0.9"),
        ({"use": "knock", "with": {"way": [0, 0]}}, "task.with.way: expected 3 numbers, got [0, 0]"),
        ({"use": "knock", "with": {"way": [0, 0, True]}}, "task.with.way: expected 3 numbers, got [0, 0, True]"),
        ({"use": "knock", "with": {"way": [0, 0, 1], "fer": 0.1}},
         "task.with.fer: task 'knock' has no such parameter; expected far, way"),
        ({"use": "knock", "with": {"way": [0, 0, 0]}}, "task file knock.yaml: 'far * unit(way)' cannot be evaluated: "),
        ({"use": "knock", "valve": {}}, "task.valve: goes into the task file; expected use and with alone"),
    ],
)  # fmt: skip
def test_a_wrong_use_is_refused_with_its_field(folder: Path, task: dict[str, Any], problem: str) -> None:
    with pytest.raises(RequestError) as caught:
        parse_request({"robot": {"name": "atlas"}, "task": task}, folder)
    assert caught.value.problems[0].startswith(problem)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("help: a\ntask: {steps: []}\nparameters: {a b: {type: number}}", "knock.yaml: parameter 'a b': "),
        ("help: a\ntask: {}\nparameters: {a: {type: choice}}", "knock.yaml: parameters.a: choices go with type"),
        ("help: a\ntask: {}\nparameters: {a: {type: number, range: [0, 1], default: 3}}",
         "knock.yaml: parameters.a: default: expected 0 to 1, got 3"),
        ("task: {}", "knock.yaml: help: is missing"),
        ("help: a\ntask: {}\nrobot: {}", "knock.yaml: unknown key 'robot'"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_its_name(folder: Path, text: str, problem: str) -> None:
    (folder / "tasks" / "knock.yaml").write_text(text)
    with pytest.raises(RequestError) as caught:
        parse_request(using("knock"), folder)
    assert caught.value.problems[0].startswith(problem)
