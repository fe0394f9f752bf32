"""A bounded queue that tells when to come back, and lets in no deadline that cannot be met."""

from __future__ import annotations

import grpc
import pytest

from service.server.admission import FIRST_GUESS_S, Admission
from service.trust.rpc import Refusal


def _with(workers: int, queue_limit: int, *seconds: float) -> Admission:
    admission = Admission(workers, queue_limit)
    for taken in seconds:
        admission.leave(admission.enter("valve"), taken)
    return admission


def test_queue_takes_as_many_as_it_may_and_not_one_more() -> None:
    admission = _with(2, 3, 1.0)
    for _ in range(5):
        admission.check("valve", None)
        admission.enter("valve")
    with pytest.raises(Refusal) as refused:
        admission.check("valve", None)
    assert refused.value.code is grpc.StatusCode.RESOURCE_EXHAUSTED
    assert refused.value.retry_after_s is not None
    assert refused.value.retry_after_s > 0.0
    assert (admission.queued, admission.running) == (3, 2)


def test_room_is_made_by_what_ends() -> None:
    admission = _with(1, 0, 1.0)
    ticket = admission.enter("valve")
    assert admission.is_full()
    admission.leave(ticket, None)
    admission.check("valve", None)


def test_wait_is_what_the_work_ahead_takes() -> None:
    admission = _with(2, 8, 4.0, 2.0)  # 3 s on average
    assert admission.expected_wait_s() == 0.0
    for _ in range(4):
        admission.enter("valve")
    # Two at work are half done, two wait: (1.5 + 1.5 + 3 + 3) / 2.
    assert admission.expected_wait_s() == pytest.approx(4.5)


def test_kind_that_never_ran_is_guessed() -> None:
    admission = _with(1, 8)
    admission.enter("door")
    assert admission.expected_wait_s() == pytest.approx(0.5 * FIRST_GUESS_S)


def test_deadline_before_the_wait_is_over_is_refused() -> None:
    admission = _with(1, 8, *[2.0] * 20)
    admission.enter("valve")
    admission.check("valve", 3.1)
    with pytest.raises(Refusal) as refused:
        admission.check("valve", 2.9)
    assert refused.value.code is grpc.StatusCode.DEADLINE_EXCEEDED
    assert "was not begun" in refused.value.text


def test_one_slow_plan_does_not_keep_out_those_that_could_be_quick() -> None:
    _with(1, 8, 12.0).check("valve", 1.0)


def test_quick_plans_leave_hope_to_a_short_deadline() -> None:
    admission = _with(1, 8, *[0.1] * 5, *[5.0] * 5)
    admission.check("valve", 0.2)  # a tenth of them took no more than 0.1 s


def test_fewer_may_wait_where_work_has_slow_spells() -> None:
    admission = _with(1, 8, *[*[1.0] * 82, *[1.4] * 18] * 4)  # 1.07 on average, a spell is 1.3 times that
    for _ in range(7):  # one at work, and 6 that wait: 8 / 1.3
        admission.check("valve", None)
        admission.enter("valve")
    assert admission.is_full()


def test_slow_spells_are_forgotten() -> None:
    admission = _with(1, 8, *[*[1.0] * 82, *[1.4] * 18] * 4, *[1.0] * 1000)
    for _ in range(9):
        admission.check("valve", None)
        admission.enter("valve")
    assert admission.is_full()


def test_even_work_uses_the_whole_queue() -> None:
    admission = _with(1, 8, *[0.98, 1.02] * 100)
    for _ in range(9):
        admission.check("valve", None)
        admission.enter("valve")
    assert admission.is_full()


def test_hard_requests_after_easy_ones_leave_a_queue() -> None:
    admission = _with(1, 3, *[0.1] * 100, *[30.0] * 20)
    for _ in range(3):  # one at work, and two that wait
        admission.check("valve", None)
        admission.enter("valve")
    assert admission.is_full()


def test_a_deadline_that_has_just_passed_is_told_as_now() -> None:
    with pytest.raises(Refusal, match=r"^the deadline is in 0\.00 s and the request would take 0\.00 s"):
        _with(1, 1).check("valve", -0.001)
