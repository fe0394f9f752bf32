"""Invalid messages and counting in the service's benchmark."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.service import asks
from benchmarks.service.endurance import _slope
from benchmarks.service.figures import percentile
from benchmarks.service.messages import Answer, is_invalid
from benchmarks.service.mutations import SHARES, hostile, seeds

CLOUD = f"sha256:{'1' * 64}.xyz"


@pytest.mark.parametrize("method", SHARES)
def test_messages_that_mutations_begin_with_are_not_invalid(method: str) -> None:
    for messages in seeds(CLOUD)[method]:
        assert not is_invalid(method, [message.SerializeToString() for message in messages])


@pytest.mark.parametrize(
    ("method", "data"),
    [
        ("Plan", b""),
        ("Plan", b"\xff\xff"),
        ("GetPlan", b"\xfa\x3f\x00"),
        ("ReviewPlan", b"\x0a\x01a"),
        ("Verify", b""),
        ("Detect", b""),
        ("UploadCloud", b""),
    ],
)
def test_messages_that_lack_what_is_needed_or_cannot_be_read_are_invalid(method: str, data: bytes) -> None:
    assert is_invalid(method, [data])


def test_request_that_the_validator_refuses_is_invalid() -> None:
    message = asks.plan_request(asks.ARM_TURNS)
    message.request.options.margin_m = float("nan")
    assert is_invalid("Plan", [message.SerializeToString()])


@pytest.mark.parametrize(
    ("field", "words", "is_named"),
    [
        ("request.goal.joints", "goal.joints.: a text is needed", True),
        ("request", "unknown link 'rhand' in keep[0].relative_to", False),
        ("request", "exactly one of goal, task is needed, none is given", True),
        ("clouds", "something is wrong with one of them", False),
        ("", "the bytes are no PlanRequest", True),
        ("", "a mapping is needed", False),
    ],
)
def test_field_is_named_only_by_what_is_wrong_itself(field: str, words: str, is_named: bool) -> None:
    assert Answer("Plan", [], True, "INVALID_ARGUMENT", words, ((field, words),), 0.0).is_named == is_named


def test_hostile_messages_are_the_same_for_the_same_seed_and_go_to_many_methods() -> None:
    first, again = (list(hostile(90, 7, CLOUD)) for _ in range(2))
    assert first == again
    assert {method for method, _ in first} > {"Plan", "UploadCloud", "Detect", "Verify"}
    assert any(is_invalid(method, sent) for method, sent in first)


def test_percentiles_are_values_that_were_measured() -> None:
    values = [float(k) for k in range(100)]
    assert (percentile(values, 50), percentile(values, 99), percentile(values[:1], 99)) == (50.0, 99.0, 0.0)
    assert np.isnan(percentile([], 50))


def test_memory_slope_is_that_of_the_later_solves() -> None:
    jobs = np.arange(1000.0)
    flat = np.column_stack([jobs, np.where(jobs < 200, jobs, 200.0)])
    assert _slope(flat)[0] == pytest.approx(0.0, abs=1e-9)
    growing = np.column_stack([jobs, 100.0 + 0.01 * jobs])
    assert _slope(growing)[0] == pytest.approx(0.01)
