"""The wire says what a request file says, and is checked by the same validator."""

from __future__ import annotations

import dataclasses
import typing
from pathlib import Path

import generated_code
import pytest
from google.protobuf.descriptor import Descriptor
from hypothesis import given, settings
from hypothesis import strategies as st

from service.errors import RequestError
from service.proto.planner.v1.request_pb2 import HAND_LEFT, MotionRequest
from service.request.file import load_request, parse_request, to_json
from service.request.schema import PlanRequest, TaskRequest
from service.wire.plain import decode_enum, to_plain
from service.wire.requests import request_from_message, request_to_message
from service.wire.violations import make_violation

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples" / "requests").glob("*.yaml"))
SMALL: dict[str, typing.Any] = {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}}


def test_generated_code_is_what_the_protocol_files_say(tmp_path: Path) -> None:
    for path in generated_code.generate(tmp_path):
        committed = ROOT / "service" / "proto" / path.relative_to(tmp_path)
        assert path.read_text() == committed.read_text(), f"python tools/generate_proto.py would mend {committed.name}"


def _variants(kind: object) -> list[type]:
    """The dataclasses somewhere within an annotation."""
    if dataclasses.is_dataclass(kind):
        return [typing.cast(type, kind)]
    return [one for part in typing.get_args(kind) for one in _variants(part)]


def _compare(schema: list[type], message: Descriptor, path: str) -> None:
    """Every key of the schema is a field of the message, and every field a key, all the way down."""
    hints: dict[str, list[type]] = {}
    for variant in schema:
        for name, kind in typing.get_type_hints(variant).items():
            hints.setdefault(name, []).extend(one for one in _variants(kind))
    hints.pop("folder", None)
    assert set(hints) == set(message.fields_by_name), path
    for name, variants in hints.items():
        field = message.fields_by_name[name]
        inner = field.message_type
        while inner is not None and "value" in inner.fields_by_name and not inner.GetOptions().map_entry:
            inner = inner.fields_by_name["value"].message_type
        if inner is not None and "files" in inner.fields_by_name and "value" in inner.oneofs_by_name:
            inner = inner.fields_by_name["files"].message_type.fields_by_name["value"].message_type
        if variants:
            assert inner is not None, f"{path}.{name}"
            _compare(variants, inner, f"{path}.{name}")


def test_every_key_of_a_request_file_is_on_the_wire_and_nothing_else() -> None:
    _compare([PlanRequest], MotionRequest.DESCRIPTOR, "request")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_request_comes_through_the_wire_unchanged(path: Path) -> None:
    request = load_request(path)
    sent = MotionRequest.FromString(request_to_message(request).SerializeToString())
    assert request_from_message(sent) == request


numbers = st.floats(-10.0, 10.0)
points = st.tuples(numbers, numbers, numbers).map(list)
names = st.text("abcdefgh_", min_size=1, max_size=8)
lengths = st.floats(0.01, 5.0)
obstacles = st.one_of(
    st.fixed_dictionaries({"type": st.just("box"), "size": st.tuples(lengths, lengths, lengths), "position": points}),
    st.fixed_dictionaries({"type": st.just("sphere"), "radius": lengths}),
    st.fixed_dictionaries({"type": st.just("convex"), "points": st.lists(points, min_size=4, max_size=6)}),
    st.fixed_dictionaries({"type": st.just("mesh"), "file": names, "decompose": st.booleans()}),
)
scenes = st.fixed_dictionaries(
    {},
    optional={
        "cloud": st.one_of(names, st.lists(st.fixed_dictionaries({"file": names, "position": points}), min_size=1)),
        "unit": st.sampled_from(["m", "mm", "ft"]),
        "message": st.one_of(st.integers(-5, 5), st.just("all")),
        "floor": st.one_of(st.booleans(), numbers),
        "hint": points,
        "obstacles": st.lists(obstacles, max_size=4).map(
            lambda given: [{**one, "name": f"piece{index}"} for index, one in enumerate(given)]
        ),
    },
)
goals = st.one_of(
    st.fixed_dictionaries({"joints": st.dictionaries(names, numbers, min_size=1)}),
    st.fixed_dictionaries({"poses": st.just([{"link": "hand", "position": [0.1, 0.2, 0.3], "free_axis": "none"}])}),
)


@settings(max_examples=60, deadline=None)
@given(scene=scenes, goal=goals, seed=st.integers(0, 2**32 - 1), start=st.dictionaries(names, numbers))
def test_any_request_comes_through_the_wire_unchanged(
    scene: dict[str, typing.Any], goal: dict[str, typing.Any], seed: int, start: dict[str, float]
) -> None:
    data = {**SMALL, "scene": scene, "goal": goal, "options": {"seed": seed}, "start": {"joints": start}}
    request = parse_request(data)
    assert to_json(request_from_message(request_to_message(request))) == to_json(request)


def test_what_the_wire_leaves_out_has_the_default_of_a_request_file() -> None:
    message = MotionRequest()
    message.robot.name = "atlas"
    message.goal.posture = "stand"
    assert request_from_message(message) == parse_request(SMALL)


def test_an_enum_is_written_as_in_a_request_file() -> None:
    message = MotionRequest()
    message.task.valve.hand = HAND_LEFT
    assert to_plain(message) == {"task": {"valve": {"hand": "left"}}}
    field = MotionRequest.DESCRIPTOR.fields_by_name["robot"].message_type.fields_by_name["root"]
    assert decode_enum(field.enum_type, 2) == "fixed"


def test_an_enum_value_of_a_later_version_is_refused_by_name() -> None:
    message = MotionRequest()
    message.robot.name = "atlas"
    message.goal.posture = "stand"
    message.options.qp = 99  # type: ignore[assignment]
    with pytest.raises(RequestError, match=r"options\.qp: expected .*piqp.*, got '99'"):
        request_from_message(message)


def test_whole_numbers_of_a_trajopt_problem_stay_whole() -> None:
    problem = {"basic_info": {"n_steps": 10, "manip": "arm"}, "weight": [1, 2.5]}
    message = MotionRequest()
    message.robot.name = "atlas"
    message.task.trajopt.update(problem)
    task = request_from_message(message).task
    assert task == TaskRequest(trajopt=problem)  # type: ignore[arg-type]
    assert task is not None
    assert task.trajopt is not None
    assert type(task.trajopt["basic_info"]["n_steps"]) is int  # type: ignore[call-overload, index]


@pytest.mark.parametrize(
    ("problem", "field"),
    [
        ("scene.obstacles[0].size: at least 3 entries are needed", "scene.obstacles[0].size"),
        ("scene.obstacles[2].position[1]: a finite number is needed", "scene.obstacles[2].position[1]"),
        ("unknown joint 'x' in start.joint_names; atlas has neck", "start.joint_names"),
        ("start is in collision: hand and box", "start"),
        ("unknown link 'rhand' in keep[0].relative_to; atlas has r_hand", "keep[0].relative_to"),
        ("unknown link 'x' in attached[12].link; atlas has r_hand", "attached[12].link"),
        ("goal.joints.: a text with at least 1 character is needed, got ''", "goal.joints"),
        ("start.joints. : a finite number is needed, got nan", "start.joints"),
        ("goal.joints.'; DROP TABLE plans; --: a finite number is needed, got inf", "goal.joints"),
        ("goal.joints.sha256:: a finite number is needed, got -inf", "goal.joints"),
        ("keep belongs to a goal; a task knows itself what it holds", "keep"),
        ("exactly one of goal, task is needed, none is given", ""),
        ("unknown key 'a b': c; robot would do", ""),
    ],
)
def test_violation_names_the_field_of_a_problem(problem: str, field: str) -> None:
    found = make_violation(problem)
    assert (found.field, found.description) == (field, problem)


def test_violation_within_a_message_names_the_whole_path() -> None:
    assert make_violation("goal.posture: unknown", "request").field == "request.goal.posture"
    assert make_violation("something", "request").field == "request"
