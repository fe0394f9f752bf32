"""The rules of buf's STANDARD category that protocol files can break, held against their descriptors."""

from __future__ import annotations

import re
from collections.abc import Iterator

from google.protobuf.descriptor_pb2 import DescriptorProto, EnumDescriptorProto, FileDescriptorProto

PASCAL = re.compile(r"(?:[A-Z][a-z0-9]*)+")
LOWER_SNAKE = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)*")
UPPER_SNAKE = re.compile(r"[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)*")


def broken_rules(file: FileDescriptorProto) -> list[str]:
    """One line per place: the rule's name, and what breaks it."""
    return [*_package(file), *_imports(file), *_enums(file.enum_type), *_messages(file.message_type), *_services(file)]


def _package(file: FileDescriptorProto) -> Iterator[str]:
    folder, _, name = file.name.rpartition("/")
    if not re.search(r"\.v[1-9]\d*$", file.package):
        yield f"PACKAGE_VERSION_SUFFIX {file.package}"
    if folder != file.package.replace(".", "/"):
        yield f"PACKAGE_DIRECTORY_MATCH {file.name}"
    if not LOWER_SNAKE.fullmatch(name.removesuffix(".proto")):
        yield f"FILE_LOWER_SNAKE_CASE {name}"


def _imports(file: FileDescriptorProto) -> Iterator[str]:
    if file.public_dependency or file.weak_dependency:
        yield f"IMPORT_NO_PUBLIC {file.name}"


def _enums(enums: list[EnumDescriptorProto]) -> Iterator[str]:
    for enum in enums:
        prefix = re.sub(r"(?<!^)(?=[A-Z])", "_", enum.name).upper() + "_"
        if not PASCAL.fullmatch(enum.name):
            yield f"ENUM_PASCAL_CASE {enum.name}"
        if enum.options.allow_alias:
            yield f"ENUM_NO_ALLOW_ALIAS {enum.name}"
        for value in enum.value:
            if not UPPER_SNAKE.fullmatch(value.name):
                yield f"ENUM_VALUE_UPPER_SNAKE_CASE {value.name}"
            if not value.name.startswith(prefix):
                yield f"ENUM_VALUE_PREFIX {value.name}"
            if value.number == 0 and not value.name.endswith("_UNSPECIFIED"):
                yield f"ENUM_ZERO_VALUE_SUFFIX {value.name}"
        if enum.value[0].number != 0:
            yield f"ENUM_FIRST_VALUE_ZERO {enum.name}"


def _messages(messages: list[DescriptorProto]) -> Iterator[str]:
    for message in messages:
        if message.options.map_entry:
            continue
        if not PASCAL.fullmatch(message.name):
            yield f"MESSAGE_PASCAL_CASE {message.name}"
        for field in message.field:
            if not LOWER_SNAKE.fullmatch(field.name):
                yield f"FIELD_LOWER_SNAKE_CASE {message.name}.{field.name}"
        for one in message.oneof_decl:
            if not LOWER_SNAKE.fullmatch(one.name.removeprefix("_")):  # `optional` makes one that begins with _
                yield f"ONEOF_LOWER_SNAKE_CASE {message.name}.{one.name}"
        yield from _enums(message.enum_type)
        yield from _messages(message.nested_type)


def _services(file: FileDescriptorProto) -> Iterator[str]:
    used: list[str] = []
    for service in file.service:
        if not PASCAL.fullmatch(service.name):
            yield f"SERVICE_PASCAL_CASE {service.name}"
        if not service.name.endswith("Service"):
            yield f"SERVICE_SUFFIX {service.name}"
        for method in service.method:
            if not PASCAL.fullmatch(method.name):
                yield f"RPC_PASCAL_CASE {method.name}"
            asked, answered = (kind.rpartition(".")[2] for kind in (method.input_type, method.output_type))
            if asked not in (f"{method.name}Request", f"{service.name}{method.name}Request"):
                yield f"RPC_REQUEST_STANDARD_NAME {method.name}"
            if answered not in (f"{method.name}Response", f"{service.name}{method.name}Response"):
                yield f"RPC_RESPONSE_STANDARD_NAME {method.name}"
            used += [method.input_type, method.output_type]
    yield from (f"RPC_REQUEST_RESPONSE_UNIQUE {kind}" for kind in sorted({one for one in used if used.count(one) > 1}))
