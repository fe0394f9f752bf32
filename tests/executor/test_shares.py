"""Shares of clients on a server under load, in simulated time with the server's own admission and queue."""

from __future__ import annotations

import pytest
from admission_simulation import Client, simulate

from service.executor import Lane

GREEDY, POLITE = Client("greedy", 20, False), Client("polite", 2, True)
EVEN = 0.97  # of an equal share


@pytest.mark.parametrize(
    ("workers", "queue", "spread", "seconds", "pause_s"),
    [
        (2, 4, 0.0, 0.05, 0.003),
        (2, 4, 0.6, 0.05, 0.003),
        (2, 4, 0.3, 0.5, 0.003),
        (2, 4, 0.3, 0.05, 0.015),
        (1, 4, 0.3, 0.05, 0.003),
        (2, 16, 0.3, 0.05, 0.003),
    ],
)
def test_a_polite_client_has_its_share_of_the_workers_beside_a_greedy_one(
    workers: int, queue: int, spread: float, seconds: float, pause_s: float
) -> None:
    greedy = Client("greedy", 20, False, seconds=seconds)
    polite = Client("polite", 2, True, seconds=seconds, pause_s=pause_s)
    shares = simulate([greedy, polite], workers, queue, 600.0 * seconds, spread)
    assert shares.of_time("polite") >= 0.5 * EVEN
    assert shares.refused["greedy"] > 10 * shares.plans["greedy"]
    assert shares.refused_again["polite"] <= 0.02 * shares.plans["polite"]


def test_a_client_that_could_not_use_its_share_has_what_it_can_use() -> None:
    polite = Client("polite", 1, True)
    alone = simulate([polite], spread=0.0).worker_s["polite"]
    beside = simulate([GREEDY, polite], spread=0.0).worker_s["polite"]
    assert beside >= 0.5 * alone  # it waits until one of two workers is free, at most for a whole plan
    assert simulate([GREEDY, polite], workers=8, queue=16).worker_s["polite"] >= 0.8 * alone


def test_many_clients_have_equal_shares_whatever_their_manners() -> None:
    clients = [Client(f"greedy{n}", 20, False) for n in range(3)] + [Client(f"polite{n}", 2, True) for n in range(2)]
    shares = simulate(clients, seconds=40.0)
    for client in clients:
        assert shares.of_time(client.name) == pytest.approx(0.2, rel=0.08)


def test_short_plans_are_not_paid_for_by_long_ones_of_others() -> None:
    shares = simulate([Client("greedy", 20, False, seconds=0.5), POLITE], seconds=100.0)
    assert shares.of_time("polite") >= 0.5 * 0.95
    assert shares.plans["polite"] > 9 * shares.plans["greedy"]


def test_interactive_requests_of_a_polite_client_go_before_a_greedy_batch() -> None:
    shares = simulate([Client("greedy", 20, False, Lane.BATCH), POLITE])
    assert shares.of_time("polite") > 0.5
    assert shares.of_time("greedy") > 0.2


def test_a_batch_beside_a_greedy_client_has_one_plan_of_five() -> None:
    shares = simulate([GREEDY, Client("polite", 2, True, Lane.BATCH)])
    assert shares.of_time("polite") == pytest.approx(0.2, abs=0.01)


def test_no_worker_idles_for_clients_that_may_come_back() -> None:
    seldom = Client("seldom", 2, True, pause_s=1.5)
    shares = simulate([GREEDY, seldom], spread=0.0, queue=2)
    assert sum(shares.worker_s.values()) >= 0.99 * 2 * 30.0
    assert shares.refused["seldom"] <= 2
