"""Formats of request data: hashes of earlier releases, and fields and defaults that later ones bring."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from service.errors import RequestError
from service.request import versions
from service.request.file import has_hash, parse_request, request_hash, to_json
from service.request.schema import PlanRequest
from service.request.versions import find_format, insert_defaults, list_defaults
from service.wire.requests import request_from_message, request_to_message

DATA = Path(__file__).parents[1] / "data" / "versions"
RECORDS = [
    pytest.param(release, entry["request"], entry["request_hash"], id=f"{release}-{index}")
    for release in ("0.2.0", "0.3.0")
    for index, entry in enumerate(json.loads((DATA / release / "requests.json").read_text()))
]
RECORDED_FORMAT = 2  # of the schema that is recorded
REACH: dict[str, Any] = {"robot": {"name": "atlas"}, "goal": {"posture": "stand"}}


def _load_recorder() -> ModuleType:
    spec = importlib.util.spec_from_file_location("record_requests", DATA / "record_requests.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("release", "data", "sha256"), RECORDS)
def test_a_request_of_an_earlier_release_has_the_hash_that_it_had_there(
    release: str, data: dict[str, Any], sha256: str
) -> None:
    request = parse_request(data)
    assert has_hash(request, sha256)
    if release == "0.3.0" and max(versions.FORMER_DEFAULTS) <= RECORDED_FORMAT:  # no default has changed since
        assert request_hash(request) == sha256
    received = request_from_message(request_to_message(request))
    assert has_hash(received, sha256)
    assert request_hash(received) == request_hash(request)


@pytest.mark.parametrize(("release", "data", "sha256"), RECORDS)
def test_another_request_has_no_hash_of_an_earlier_one(release: str, data: dict[str, Any], sha256: str) -> None:
    other = {**data, "options": {**data.get("options", {}), "seed": 77}}
    assert not has_hash(parse_request(other), sha256)
    sticky = {**data, "options": {**data.get("options", {}), "hand_friction": [0.2, 0.9]}}
    assert not has_hash(parse_request(sticky), sha256)


def test_a_given_value_is_not_the_default_that_it_was_before() -> None:
    sha256 = next(record.values[2] for record in RECORDS if record.id == "0.2.0-0")
    for starts, is_same in ((16, True), (1000, False), (17, False)):
        assert has_hash(parse_request({**REACH, "options": {"starts": starts}}), str(sha256)) == is_same
    assert has_hash(parse_request(REACH), str(sha256))


def test_a_later_field_enters_data_and_hash_only_where_it_differs_from_its_default() -> None:
    plain, spelled_out = parse_request(REACH), parse_request({**REACH, "options": {"hand_friction": [0.3, 0.6]}})
    changed = parse_request({**REACH, "options": {"hand_friction": [0.3, 0.7]}})
    assert request_hash(plain) == request_hash(spelled_out) != request_hash(changed)
    assert "hand_friction" not in to_json(plain)["options"]
    assert to_json(changed)["options"]["hand_friction"] == [0.3, 0.7]
    assert (find_format(plain), find_format(changed)) == (2, 3)
    assert list_defaults(plain)["Options.hand_friction"] == [0.3, 0.6]
    assert "Options.hand_friction" not in list_defaults(changed)


def test_recorded_defaults_are_those_of_some_version(monkeypatch: pytest.MonkeyPatch) -> None:
    request = parse_request(REACH)
    with pytest.raises(RequestError, match=r"request_defaults.Options.hand_friction: expected .*, got \[0.0, 5.0\]"):
        insert_defaults(request, {"Options.hand_friction": [0.0, 5.0]})
    with pytest.raises(RequestError, match=r"'Options\.seed' is no field of this request with a later default"):
        insert_defaults(request, {"Options.seed": 1})
    with pytest.raises(RequestError, match="request_defaults: a mapping is needed, got 1"):
        insert_defaults(request, 1)
    _change_friction_in_format_4(monkeypatch)
    data = insert_defaults(request, {"Options.hand_friction": [0.25, 0.6]})
    assert parse_request(data).options.hand_friction == (0.25, 0.6)


def test_a_default_that_changes_leaves_earlier_hashes_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    before = {friction: request_hash(_with_friction(friction)) for friction in ((0.25, 0.6), (0.3, 0.6), None)}
    _change_friction_in_format_4(monkeypatch)  # it was 0.25 to 0.6, and the schema says 0.3 to 0.6
    left = parse_request(REACH)
    assert request_hash(left) == before[None]  # whoever leaves it to the planner sends the same data as before
    assert has_hash(left, before[None])
    explicit = _with_friction((0.25, 0.6))  # what format 3 used, and left out
    assert has_hash(explicit, before[None])
    assert request_hash(explicit) == before[0.25, 0.6] != request_hash(left)
    assert find_format(explicit) == 3


def test_every_field_of_the_schema_has_its_format() -> None:
    recorded: dict[str, Any] = json.loads((DATA / "0.3.0" / "schema.json").read_text())
    now: dict[str, Any] = _load_recorder().list_fields(PlanRequest, {}, set())
    added = {key for keys in versions.ADDED.values() for key in keys}
    old_classes = {key.partition(".")[0] for key in recorded}
    missing = [key for key in now if key not in recorded and key.partition(".")[0] in old_classes and key not in added]
    assert not missing, (
        f"{', '.join(missing)}: new in the schema; add it to ADDED[{versions.FORMAT}] in service/request/versions.py, "
        "so that requests without it keep their hash"
    )
    later = [changes for version, changes in sorted(versions.FORMER_DEFAULTS.items()) if version > RECORDED_FORMAT]
    former = {key: changes[key] for changes in reversed(later) for key in changes}
    # Requests always gave what was required, so that a default that came later changes none of them.
    with_default = [key for key in recorded.keys() & now.keys() if recorded[key] != "required"]
    changed = [key for key in with_default if former.get(key, now[key]) != recorded[key]]
    assert not changed, (
        f"{', '.join(changed)}: the default differs from 0.3.0's; add the former one to "
        f"FORMER_DEFAULTS[{versions.FORMAT}] in service/request/versions.py"
    )
    gone = [key for key in recorded if key not in now]
    assert not gone, f"{', '.join(gone)}: requests of 0.3.0 have it; keep it readable"
    unknown = sorted({*added, *(key for changes in versions.FORMER_DEFAULTS.values() for key in changes)} - now.keys())
    assert not unknown, f"{', '.join(unknown)}: in a table of service/request/versions.py, and no field of the schema"


def _with_friction(friction: tuple[float, float] | None) -> PlanRequest:
    return parse_request(REACH if friction is None else {**REACH, "options": {"hand_friction": list(friction)}})


def _change_friction_in_format_4(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a further format change the default of a field that format 3 brought, from 0.25 to 0.6."""
    monkeypatch.setattr(versions, "FORMAT", 4)
    monkeypatch.setitem(versions.FORMER_DEFAULTS, 4, {"Options.hand_friction": (0.25, 0.6)})
    versions._find_versioned_fields.cache_clear()
    monkeypatch.setattr("service.request.file.FORMAT", 4)


@pytest.fixture(autouse=True)
def _forget_tables() -> Any:
    yield
    versions._find_versioned_fields.cache_clear()


def test_a_copy_keeps_what_was_given() -> None:
    options = parse_request(REACH).options
    assert not options.is_given("starts")
    assert not dataclasses.replace(parse_request(REACH), folder=Path("/")).options.is_given("starts")
    assert dataclasses.replace(options, seed=1).is_given("seed")
