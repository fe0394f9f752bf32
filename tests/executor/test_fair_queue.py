"""Waiting jobs share the workers equally between their owners; light jobs never wait for others."""

from __future__ import annotations

from pathlib import Path

import pytest
from executor_jobs import nap
from hypothesis import given
from hypothesis import strategies as st

from service.executor import Job, Lane, LocalPool, Place
from service.executor.job import JobRecord
from service.executor.job_queue import FairQueue
from service.server.admission import Admission
from service.trust.rpc import Refusal

BATCH, LIGHT = Lane.BATCH, Lane.LIGHT


class _Time:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def _record(number: int, owner: str, lane: Lane = Lane.INTERACTIVE) -> JobRecord:
    return JobRecord(Job(number, None, lambda _: None), b"", None, 3, place=Place(owner, lane))


def _run(queue: FairQueue, time: _Time, seconds: dict[str, float], n: int) -> list[str]:
    """Owners in the order in which one worker runs their jobs."""
    order = []
    for _ in range(n):
        record = queue.take()
        assert record is not None
        order.append(record.place.owner)
        time.now += seconds[record.place.owner]
        queue.note_end(record)
    return order


def test_owners_take_turns_whoever_came_first() -> None:
    queue = FairQueue(time := _Time())
    for number, owner in enumerate("aaaaaabb"):
        queue.put(_record(number, owner))
    assert "".join(_run(queue, time, {"a": 1.0, "b": 1.0}, 8)) == "ababaaaa"


def test_an_owner_of_long_jobs_gets_as_much_time_as_one_of_short_jobs() -> None:
    queue = FairQueue(time := _Time())
    for number in range(40):
        queue.put(_record(number, "long" if number % 2 else "short"))
    order = _run(queue, time, {"long": 4.0, "short": 1.0}, 20)
    assert order.count("short") == 4 * order.count("long")


def test_who_was_away_or_alone_has_neither_credit_nor_debt() -> None:
    queue = FairQueue(time := _Time())
    for number in range(50):
        queue.put(_record(number, "a"))
    _run(queue, time, {"a": 1.0}, 30)
    for number in range(50, 54):
        queue.put(_record(number, "b"))
    assert _run(queue, time, {"a": 1.0, "b": 1.0}, 8).count("b") == 4


def test_batch_jobs_wait_for_interactive_ones_but_not_for_ever() -> None:
    queue = FairQueue(time := _Time())
    for number in range(12):
        queue.put(_record(number, "now"))
    queue.put(_record(12, "later", BATCH))
    queue.put(_record(13, "later", BATCH))
    order = _run(queue, time, {"now": 1.0, "later": 1.0}, 14)
    assert [index for index, owner in enumerate(order) if owner == "later"] == [4, 9]


def test_light_jobs_go_first_and_a_job_whose_worker_died_before_all() -> None:
    queue = FairQueue()
    records = [_record(0, "a"), _record(1, "a"), _record(2, "b", LIGHT)]
    for record in records:
        queue.put(record)
    assert queue.take(only_light=True) is records[2]
    assert queue.take(only_light=True) is None
    died = queue.take()
    assert died is records[0]
    queue.put_back(died)
    assert queue.position(died) == 1
    assert queue.take() is died


@given(st.lists(st.tuples(st.sampled_from("abc"), st.sampled_from(list(Lane))), max_size=12), st.data())
def test_every_job_comes_out_once_in_its_owners_order(jobs: list[tuple[str, Lane]], data: st.DataObject) -> None:
    queue = FairQueue()
    records = [_record(number, *job) for number, job in enumerate(jobs)]
    for record in records:
        queue.put(record)
    removed = [record for record in records if data.draw(st.booleans())]
    assert all(queue.remove(record) for record in removed)
    left = [record for record in records if record not in removed]
    assert [record.job.number for record in queue] == [record.job.number for record in left]
    places = [queue.position(record) for record in left]
    assert all(place is not None and 1 <= place <= len(left) for place in places)
    taken = []
    while (following := queue.take()) is not None:
        taken.append(following)
    assert sorted(record.job.number for record in taken) == sorted(record.job.number for record in left)
    for place in {record.place for record in left}:
        numbers = [record.job.number for record in taken if record.place == place]
        assert numbers == sorted(numbers)
    assert len(queue) == 0


def test_a_light_job_runs_beside_workers_that_are_all_busy(tmp_path: Path) -> None:
    with LocalPool(1, light_workers=1) as pool:
        pool.wait_ready()
        heavy = [pool.submit(nap, 60.0) for _ in range(2)]
        assert pool.submit(abs, -1, place=Place("", LIGHT)).result(10.0) == 1
        assert heavy[1].started is None
        pool.shutdown(wait=False, cancel_futures=True)
        heavy[0].cancel()


def _serve_for(admission: Admission, owner: str) -> bool:
    """Whether a request is admitted."""
    return _delay_for(admission, owner) == 0.0


def _delay_for(admission: Admission, owner: str) -> float:
    """Delay that a refused client is told [s]; 0 if its request is admitted."""
    try:
        admission.check("valve", None, Place(owner))
    except Refusal as refusal:
        return refusal.retry_after_s or -1.0
    return 0.0


def test_a_polite_client_beside_a_greedy_one_is_admitted_at_least_as_often_as_its_share() -> None:
    admission = Admission(2, 4, clock=(time := _Time()))
    running: list[tuple[int, str]] = []
    admitted = {"greedy": 0, "polite": 0}
    come_back, open_polite = 0.0, 0
    for step in range(2000):
        time.now = 0.05 * step
        if step % 10 == 0 and running:  # a request ends every half second
            owner = next((o for _, o in running[:2] if o == "polite"), running[0][1])
            ticket = next(entry for entry in running if entry[1] == owner)
            running.remove(ticket)
            open_polite -= owner == "polite"
            admission.leave(ticket[0], 1.0)
        while _serve_for(admission, "greedy"):
            running.append((admission.enter("valve", Place("greedy")), "greedy"))
            admitted["greedy"] += 1
        if open_polite == 0 and time.now >= come_back:
            come_back = time.now + (delay := _delay_for(admission, "polite"))
            if delay == 0.0:
                running.insert(0, (admission.enter("valve", Place("polite")), "polite"))
                admitted["polite"] += 1
                open_polite += 1
    assert admitted["polite"] >= 0.45 * sum(admitted.values())


def test_a_refused_client_that_comes_back_as_told_finds_its_place() -> None:
    admission = Admission(1, 1, clock=(time := _Time()))
    tickets = [admission.enter("valve", Place("greedy")) for _ in range(2)]
    with pytest.raises(Refusal, match=r"try again in 0\.\d s, a place is reserved then") as refused:
        admission.check("valve", None, Place("polite"))
    admission.leave(tickets.pop(), 1.0)
    assert not _serve_for(admission, "greedy")
    assert refused.value.retry_after_s is not None
    time.now += refused.value.retry_after_s
    assert not _serve_for(admission, "greedy")
    assert _serve_for(admission, "polite")
    admission.enter("valve", Place("polite"))
    assert not _serve_for(admission, "polite")


def test_a_reservation_that_is_not_used_ends() -> None:
    admission = Admission(1, 1, clock=(time := _Time()))
    tickets = [admission.enter("valve", Place("greedy")) for _ in range(2)]
    assert not _serve_for(admission, "gone")
    admission.leave(tickets.pop(), 1.0)
    time.now += 10.0
    assert _serve_for(admission, "greedy")


def test_each_refused_call_of_a_client_has_a_place_reserved() -> None:
    admission = Admission(2, 2, clock=(time := _Time()))
    tickets = [admission.enter("valve", Place("greedy")) for _ in range(4)]
    first, second = (_delay_for(admission, "polite") for _ in range(2))
    assert first < second
    for _ in range(2):
        admission.leave(tickets.pop(), 1.0)
    time.now += second
    for _ in range(2):
        assert not _serve_for(admission, "greedy")
        assert _serve_for(admission, "polite")
        admission.enter("valve", Place("polite"))


def test_a_place_that_is_late_is_kept_for_the_client_whose_turn_it_is() -> None:
    admission = Admission(1, 1, clock=(time := _Time()))
    tickets = [admission.enter("valve", Place("greedy")) for _ in range(2)]
    delay, delay_of_other = _delay_for(admission, "polite"), _delay_for(admission, "newcomer")
    while time.now < delay_of_other:  # nothing ends
        time.now += delay
        delay = _delay_for(admission, "polite")
    admission.leave(tickets.pop(), 1.0)
    assert not _serve_for(admission, "newcomer")
    time.now += delay
    assert _serve_for(admission, "polite")


def test_a_second_reservation_waits_for_the_first_of_others() -> None:
    admission = Admission(4, 4, clock=_Time())
    for _ in range(8):
        admission.enter("valve", Place("other"))
    greedy = [_delay_for(admission, "greedy") for _ in range(2)]
    polite = _delay_for(admission, "polite")
    assert greedy[0] < greedy[1]
    assert polite == pytest.approx(greedy[1])  # which was told before there was a polite client
    admission.leave(1, 1.0)
    admission.leave(2, 1.0)
    assert not _serve_for(admission, "newcomer")  # the places of the first two


def test_batch_requests_leave_places_to_interactive_ones() -> None:
    admission = Admission(2, 6, clock=_Time())
    n_batch = 0
    while _is_free(admission, Place("night", Lane.BATCH)):
        admission.enter("valve", Place("night", Lane.BATCH))
        n_batch += 1
    assert n_batch == 6
    for _ in range(2):
        assert _serve_for(admission, "operator")
        admission.enter("valve", Place("operator"))
    assert admission.is_full()


def _is_free(admission: Admission, place: Place) -> bool:
    try:
        admission.check("valve", None, place)
    except Refusal:
        return False
    return True
