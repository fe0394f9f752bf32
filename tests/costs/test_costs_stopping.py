"""Stopping long work where it polls."""

from __future__ import annotations

import threading
from contextlib import suppress

import pytest

from costs.stopping import Stopped, is_stopped, poll, stops_when


def test_without_anybody_who_asks_a_poll_does_nothing() -> None:
    poll()
    assert not is_stopped()


def test_work_ends_at_the_first_poll_after_it_was_asked_to_stop() -> None:
    asked = iter([False, False, True])
    polls = 0
    with suppress(Stopped), stops_when(lambda: next(asked)):
        while True:
            poll()
            polls += 1
    assert polls == 2
    poll()


def test_what_surrounds_the_work_stops_it_too_and_what_is_inside_stops_nothing_outside() -> None:
    is_asked = [False, False]
    with stops_when(lambda: is_asked[0]):
        with stops_when(lambda: is_asked[1]):
            poll()
            is_asked[1] = True
            assert is_stopped()
        poll()
        with stops_when(lambda: False):
            is_asked[0] = True
            with pytest.raises(Stopped):
                poll()


def test_other_threads_are_not_stopped() -> None:
    went_on: list[bool] = []

    def work() -> None:
        poll()
        went_on.append(True)

    with stops_when(lambda: True):
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    assert went_on == [True]


def test_a_stop_is_no_error_that_somebody_may_take_for_bad_input() -> None:
    assert Stopped.__mro__[1] is Exception
