"""The protocol files keep to the names that buf's linter asks for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from google.protobuf import text_format
from google.protobuf.descriptor_pb2 import FileDescriptorProto
from proto_lint import broken_rules

from service.proto.planner.v1 import execution_pb2, planner_pb2, pose_pb2, request_pb2, result_pb2

FOLDER = Path(__file__).parents[2] / "service" / "proto" / "planner" / "v1"
_MODULES = (execution_pb2, planner_pb2, pose_pb2, request_pb2, result_pb2)
FILES = {Path(module.DESCRIPTOR.name).name: module.DESCRIPTOR for module in _MODULES}


def test_every_protocol_file_is_looked_at() -> None:
    assert set(FILES) == {path.name for path in FOLDER.glob("*.proto")}


@pytest.mark.parametrize("name", FILES)
def test_names_are_those_that_buf_asks_for(name: str) -> None:
    file = FileDescriptorProto()
    FILES[name].CopyToProto(file)
    assert broken_rules(file) == []


@pytest.mark.parametrize(
    ("text", "broken"),
    [
        ('package: "planner"', ["PACKAGE_VERSION_SUFFIX planner", "PACKAGE_DIRECTORY_MATCH a/v1/b.proto"]),
        ('name: "a/v1/Big.proto"', ["FILE_LOWER_SNAKE_CASE Big.proto"]),
        ("public_dependency: 0", ["IMPORT_NO_PUBLIC a/v1/b.proto"]),
        (
            'enum_type { name: "FreeAxis" value { name: "FREE_NONE" number: 0 } }',
            ["ENUM_VALUE_PREFIX FREE_NONE", "ENUM_ZERO_VALUE_SUFFIX FREE_NONE"],
        ),
        (
            'enum_type { name: "side" value { name: "side_left" number: 1 } }',
            ["ENUM_PASCAL_CASE side", "ENUM_VALUE_UPPER_SNAKE_CASE side_left", "ENUM_VALUE_PREFIX side_left",
             "ENUM_FIRST_VALUE_ZERO side"],
        ),
        (
            'message_type { name: "a_b" field { name: "X" } oneof_decl { name: "Or" } }',
            ["MESSAGE_PASCAL_CASE a_b", "FIELD_LOWER_SNAKE_CASE a_b.X", "ONEOF_LOWER_SNAKE_CASE a_b.Or"],
        ),
        (
            'message_type { name: "A" nested_type { name: "b" } enum_type { name: "C" options { allow_alias: true }'
            ' value { name: "C_UNSPECIFIED" number: 0 } } }',
            ["ENUM_NO_ALLOW_ALIAS C", "MESSAGE_PASCAL_CASE b"],
        ),
        (
            'service { name: "planner" method { name: "plan" input_type: ".a.v1.Ask" output_type: ".a.v1.Ask" } }',
            ["SERVICE_PASCAL_CASE planner", "SERVICE_SUFFIX planner", "RPC_PASCAL_CASE plan",
             "RPC_REQUEST_STANDARD_NAME plan", "RPC_RESPONSE_STANDARD_NAME plan",
             "RPC_REQUEST_RESPONSE_UNIQUE .a.v1.Ask"],
        ),
    ],
)  # fmt: skip
def test_each_rule_finds_what_breaks_it(text: str, broken: list[str]) -> None:
    file: Any = FileDescriptorProto(name="a/v1/b.proto", package="a.v1")
    file.MergeFrom(text_format.Parse(text, FileDescriptorProto()))
    assert broken_rules(file) == broken
