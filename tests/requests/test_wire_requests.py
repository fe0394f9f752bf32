"""The wire says what a request file says, and is checked by the same validator."""

from __future__ import annotations

import dataclasses
import typing
from pathlib import Path

import generated_code
import pytest
from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
from hypothesis import given, settings
from hypothesis import strategies as st

from service.errors import RequestError
from service.proto.planner.v1.request_pb2 import HAND_LEFT, MotionRequest
from service.request.file import load_request, parse_request, to_json
from service.request.schema import PlanRequest
from service.request.tasks.registry import TaskRequest
from service.wire.plain import decode_enum, to_plain
from service.wire.requests import request_from_message, request_to_message
from service.wire.violations import make_violation

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "examples" / "requests").glob("*.yaml"))
SMALL: dict[str, typing.Any] = {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}}


def test_generated_code_is_what_the_protocol_files_say(tmp_path: Path) -> None:
    for path in generated_code.generate(tmp_path):
        committed = ROOT / "service" / "proto" / path.relative_to(tmp_path)
        assert path.read_text() == committed.read_text(), f"python tools/generate_proto.py would mend {committed.name}"


def _read_annotation(kind: object, sections: list[type], choices: set[str]) -> set[object]:
    """The wire's kinds for an annotation; its dataclasses and the values of its literals are added to the arguments."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind):
        sections.append(typing.cast(type, kind))
        return {"message"}
    if origin is typing.Literal:
        choices.update(parts)
        return {"enum"}
    if origin is tuple:
        return {("list", *_read_annotation(parts[0], sections, choices))}
    if origin is dict:
        values = _read_annotation(parts[1], sections, choices)
        return {("map", *values)} if values in ({float}, {str}, {"message"}) else {"data"}
    if parts:
        return {name for part in parts for name in _read_annotation(part, sections, choices)}
    return set() if kind is type(None) else {kind}


def _read_field(field: FieldDescriptor, messages: list[Descriptor], enums: list[EnumDescriptor]) -> set[object]:
    """The kinds of a field; a message that stands for a value has the value's kinds."""
    inner = field.message_type
    if inner is None:
        if field.enum_type is not None:
            enums.append(field.enum_type)
        kinds: set[object] = {"enum" if field.enum_type is not None else _SCALARS[field.cpp_type]}
    elif inner.full_name == "google.protobuf.Struct":
        return {"data"}
    elif inner.GetOptions().map_entry:
        return {("map", *_read_field(inner.fields_by_name["value"], messages, enums))}
    elif "value" in inner.fields_by_name or "value" in inner.oneofs_by_name:
        kinds = {kind for part in inner.fields for kind in _read_field(part, messages, enums)}
    else:
        messages.append(inner)
        kinds = {"message"}
    return {("list", *kinds)} if field.is_repeated else kinds


_SCALARS = {
    FieldDescriptor.CPPTYPE_BOOL: bool,
    FieldDescriptor.CPPTYPE_STRING: str,
    FieldDescriptor.CPPTYPE_INT32: int,
    FieldDescriptor.CPPTYPE_UINT32: int,
    FieldDescriptor.CPPTYPE_DOUBLE: float,
}


EXPANDED = {"request.task": {"use", "with"}}
"""Fields of messages that are replaced by what a task file makes of them before a request is checked."""


def _compare(schema: list[type], message: Descriptor, path: str, values: dict[str, set[str]]) -> None:
    """Every key of the schema is a field of the same kind, and every field a key, all the way down.

    Values of an enum's literals are collected in ``values``; several fields may share one enum.
    """
    hints: dict[str, list[object]] = {}
    for variant in schema:
        for name, kind in typing.get_type_hints(variant).items():
            hints.setdefault(name, []).append(kind)
    hints.pop("folder", None)
    assert set(hints) == set(message.fields_by_name) - EXPANDED.get(path, set()), path
    for name, hinted in hints.items():
        sections: list[type] = []
        choices: set[str] = set()
        kinds = {kind for annotation in hinted for kind in _read_annotation(annotation, sections, choices)}
        messages: list[Descriptor] = []
        enums: list[EnumDescriptor] = []
        field_kinds = _read_field(message.fields_by_name[name], messages, enums)
        if not enums and choices:  # scene.message: a number, or a word as text
            kinds = {str if kind == "enum" else kind for kind in kinds}
        assert kinds == field_kinds, f"{path}.{name}"
        for enum in enums:
            values.setdefault(enum.full_name, set()).update(choices)
            assert choices <= {decode_enum(enum, value.number) for value in enum.values if value.number}
        for inner in messages:
            _compare(sections, inner, f"{path}.{name}", values)


def test_every_key_of_a_request_file_is_on_the_wire_with_its_type_and_values_and_nothing_else() -> None:
    values: dict[str, set[str]] = {}
    _compare([PlanRequest], MotionRequest.DESCRIPTOR, "request", values)
    for name, choices in values.items():
        enum = MotionRequest.DESCRIPTOR.file.enum_types_by_name[name.rpartition(".")[2]]
        assert choices == {decode_enum(enum, value.number) for value in enum.values if value.number}, name


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
        ("unknown key 'a b': c; expected robot", ""),
    ],
)
def test_violation_names_the_field_of_a_problem(problem: str, field: str) -> None:
    found = make_violation(problem)
    assert (found.field, found.description) == (field, problem)


def test_violation_within_a_message_names_the_whole_path() -> None:
    assert make_violation("goal.posture: unknown", "request").field == "request.goal.posture"
    assert make_violation("something", "request").field == "request"
