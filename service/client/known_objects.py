"""Known objects of the calls: messages, local files and lines of text, and the files that are uploaded for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from os.path import isabs
from pathlib import Path

from service.client.local_files import NOT_UPLOADED, find_upload_problem, is_uploaded
from service.errors import RequestError, shown
from service.proto.planner.v1.planner_pb2 import KnownMesh
from service.request.object_file import is_object_text, parse_object_text, read_object_file
from service.request.shapes import OBJECT_SUFFIXES, ObjectRequest
from service.wire.plain import fill

Objects = Sequence[KnownMesh | str | Path]
"""Known objects: messages, lines such as ``wheel radius=0.3 rim_radius=0.02 spokes=5``, local files, or ids of uploads.

All but messages are in metres and to be found anywhere in the clouds.
"""


def make_object_messages(objects: Objects, field: str) -> list[KnownMesh]:
    """Return the messages of known objects; lines of text and local object files become parts.

    Args:
        field: that holds them, for messages about problems.

    Raises:
        RequestError: one line per problem of a text or an object file.
    """
    made, problems = [], []
    for index, item in enumerate(objects):
        try:
            made.append(item if isinstance(item, KnownMesh) else _make_message(str(item)))
        except RequestError as error:
            problems += [f"{field}[{index}]: {problem}" for problem in error.problems]
    if problems:
        raise RequestError(problems)
    return made


def find_object_files(objects: Sequence[KnownMesh], field: str, update: str | Path | None = None) -> dict[str, Path]:
    """Return the local files of known objects and of the scene to update, by their names in the messages.

    Raises:
        RequestError: a relative path does not exist, or cannot be uploaded.
    """
    names = {f"{field}[{index}].file": item.file for index, item in enumerate(objects) if item.HasField("file")}
    refused = {place: name for place, name in names.items() if Path(name).is_file() and not _can_upload(name)}
    uploaded = {place: name for place, name in names.items() if place not in refused}
    uploaded |= {} if update is None else {"update": str(update)}
    return find_files(
        uploaded, [f"{place}: {shown(name)}: {NOT_UPLOADED}" for place, name in refused.items() if not isabs(name)]
    )


def find_files(names: Mapping[str, str], problems: Sequence[str] = ()) -> dict[str, Path]:
    """Return the local files among names by field.

    Raises:
        RequestError: one of them cannot be uploaded, or there are problems already.
    """
    found = [find_upload_problem(field, name, Path(name)) for field, name in names.items()]
    problems = [problem for problem in [*found, *problems] if problem]
    if problems:
        raise RequestError(problems)
    return {name: Path(name) for name in names.values() if Path(name).is_file()}


def replace_by_id(item: KnownMesh, ids: Mapping[str, str]) -> KnownMesh:
    """Return the message of an object; an uploaded one by its id, named after its file."""
    known = KnownMesh()
    known.CopyFrom(item)
    if known.file in ids:
        if not known.name:
            known.name = Path(known.file).stem
        known.file = ids[known.file]
    return known


def _make_message(text: str) -> KnownMesh:
    path = Path(text)
    if path.suffix.lower() in OBJECT_SUFFIXES and path.is_file():
        return _with_parts(read_object_file(path), path.stem)
    if is_object_text(text) and not path.is_file():
        return _with_parts(parse_object_text(text), None)
    return KnownMesh(file=text)


def _with_parts(given: ObjectRequest, name: str | None) -> KnownMesh:
    message = KnownMesh(name=name)
    parts = [{key: value for key, value in asdict(part).items() if value is not None} for part in given.parts]
    fill(message, {"parts": parts})
    return message


def _can_upload(file: str) -> bool:
    """Return whether an object's file can be uploaded: a mesh, or an object file that the server reads."""
    return is_uploaded(file) or Path(file).suffix.lower() == ".json"
