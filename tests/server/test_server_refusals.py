"""What a client hears of a wrong request: every field is named, and it all fits the headers it travels in."""

from __future__ import annotations

from pathlib import Path

import pytest
from google.rpc.error_details_pb2 import BadRequest
from google.rpc.status_pb2 import Status

from service.executor.worker import JobControl, SharedFlags
from service.proto.planner.v1 import planner_pb2 as wire
from service.server.cloud_requests import NamedFile, rename_fields
from service.server.refusals import refuse_invalid
from service.trust.rpc import MAX_TEXT_BYTES, Refusal, shorten
from service.wire.message_checks import find_unknown_fields
from service.wire.violations import make_violation
from service.work.look import verify
from service.work.plan import Refused

HEADERS_BYTES = 8 * 2**10  # beyond which gRPC ends a call in its own way

CONTROL = JobControl(1, SharedFlags(), lambda *_: None)  # of a job that nobody stops


def _told(refusal: Refusal) -> list[BadRequest.FieldViolation]:
    ((_, data),) = refusal.metadata()
    detail = BadRequest()
    assert Status.FromString(data).details[0].Unpack(detail)
    return list(detail.field_violations)


def _header_bytes(refusal: Refusal) -> int:
    """The text percent-encoded, the details in base 64: the most they can take."""
    text = sum(1 if " " <= letter <= "~" else 3 * len(letter.encode()) for letter in refusal.text)
    return text + sum(4 * (len(value) + 2) // 3 for _, value in refusal.metadata())


@pytest.mark.parametrize("words", ["a number is needed", "🦾" * 300, "x" * 100_000])
def test_refusal_of_a_thousand_problems_fits_the_headers(words: str) -> None:
    refusal = refuse_invalid([f"scene.obstacles[{i}].size: {words}" for i in range(1000)], "request")
    assert _header_bytes(refusal) < HEADERS_BYTES


def test_refusal_that_leaves_problems_out_says_how_many() -> None:
    problems = [f"scene.obstacles[{i}].size: a number is needed" for i in range(1000)]
    told = _told(refuse_invalid(problems, "request"))
    assert told[0].field == "request.scene.obstacles[0].size"
    assert told[-1].field == f"request.scene.obstacles[{len(told) - 1}].size"
    assert told[-1].description.startswith(f"{1000 - len(told) + 1} more problems")


def test_few_problems_are_all_told_in_full() -> None:
    problems = ["options.margin_m: a positive number would do, got -1", "goal: is missing"]
    told = _told(refuse_invalid(problems, "request"))
    assert [(one.field, one.description) for one in told] == [
        ("request.options.margin_m", problems[0]),
        ("request.goal", problems[1]),
    ]


def test_text_is_cut_between_letters() -> None:
    assert shorten("a🦾b", 4) == "a"
    assert shorten("a🦾b", 6) == "a🦾b"
    assert len(refuse_invalid(["🦾" * 1000]).text.encode()) <= MAX_TEXT_BYTES


def test_unknown_field_is_named_by_its_number() -> None:
    message = wire.GetPlanRequest.FromString(b"\xfa\x3f\x00")
    (problem,) = find_unknown_fields(message)
    assert make_violation(problem).field == "field_1023"
    spec = wire.DetectRequest.FromString(b"\x0a\x03\xfa\x3f\x00")
    assert [make_violation(problem).field for problem in find_unknown_fields(spec)] == ["clouds.field_1023"]


@pytest.mark.parametrize("name", ["\0", "a\0b", "../out", "", "x" * 5000])
def test_files_to_verify_with_names_of_no_file_are_refused(name: str) -> None:
    answer = verify({name: b"{}"}, CONTROL)
    assert isinstance(answer, Refused)
    assert make_violation(answer.problems[0]).field == "files"


def test_files_that_cannot_be_verified_are_named_as_the_client_named_them() -> None:
    answer = verify({"other.json": b"{}"}, CONTROL)
    assert isinstance(answer, Refused)
    assert answer.problems == ("files: result.json cannot be read: No such file or directory",)


def test_what_is_wrong_with_a_cloud_is_told_of_the_field_that_names_it() -> None:
    kept = [
        NamedFile(f"clouds.clouds[{k}].file", f"sha256:{n}.pcd", Path(f"/data/{n}.pcd")) for k, n in enumerate("ab")
    ]
    kept.append(NamedFile("meshes[0].file", "sha256:c.stl", Path("/data/sha256:c.stl")))
    said = (
        "/data/b.pcd: is empty",
        "KIND: unknown kind 'x'",
        "--robot: unknown robot 'y'",
        "start is odd",
        "no points",
        "--mesh: sha256:c.stl: has 0 triangles",
        "--mesh: sha256:c.stl spans 1e+04 m at --mesh-scale 1; expected 0.001 to 100 m",
        "clouds.reach_m: scene:1 was made with 3.0, and an update keeps to that",
    )
    told = [make_violation(problem) for problem in rename_fields(said, kept)]
    assert [one.field for one in told] == [
        "clouds.clouds[1].file",
        "kind",
        "clouds.robot",
        "clouds.start",
        "clouds.clouds",
        "meshes[0].file",
        "meshes[0].file",
        "clouds.reach_m",
    ]
    assert "at scale 1" in told[6].description
    assert told[0].description == "clouds.clouds[1].file: sha256:b.pcd: is empty"
