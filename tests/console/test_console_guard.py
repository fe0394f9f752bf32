"""What no page of the console sent is refused before it reaches the console."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.cli.console.guard import find_problem
from service.cli.console.serve import parse_listen
from service.cli.server.console import ConsoleProcess, find_target
from service.errors import RequestError

HOSTS = ("127.0.0.1:8080", "localhost:9000", "localhost", "[::1]:8080", "127.0.0.1")


@pytest.mark.parametrize("host", HOSTS)
def test_a_page_of_this_machine_may_ask_and_give_orders(host: str) -> None:
    headers = {"host": host, "origin": f"http://{host}"}
    assert find_problem(headers, "http", "GET") == ""
    assert find_problem(headers, "http", "POST") == ""
    assert find_problem(headers, "websocket", "") == ""


@pytest.mark.parametrize("host", ["", "evil.example", "evil.example:80", "192.168.1.4:80", "localhost.evil.example"])
def test_a_name_that_leads_here_from_elsewhere_is_refused(host: str) -> None:
    headers = {"host": host, "origin": f"http://{host}"}
    for kind, method in (("http", "GET"), ("http", "POST"), ("websocket", "")):
        assert "is not this machine" in find_problem(headers, kind, method)


@given(
    origin=st.one_of(
        st.text(max_size=40),
        st.sampled_from(
            ["null", "http://localhost:8080", "http://127.0.0.1:8081", "http://127.0.0.1:8080.evil.example"]
        ),
    )
)
def test_orders_need_the_origin_of_this_very_console(origin: str) -> None:
    headers = {"host": "127.0.0.1:8080", "origin": origin}
    is_own = origin in ("http://127.0.0.1:8080", "https://127.0.0.1:8080")
    assert (find_problem(headers, "websocket", "") == "") is is_own
    assert (find_problem(headers, "http", "POST") == "") is is_own
    assert find_problem(headers, "http", "GET") == ""


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "POST", "", "OPTIONS"])
def test_whatever_may_change_something_needs_an_origin(method: str) -> None:
    assert "no page of this console" in find_problem({"host": "127.0.0.1:8080"}, "http", method)


@pytest.mark.parametrize(
    ("listen", "words"),
    [
        ("0.0.0.0:8080", "for this machine"),
        ("robot.example:8080", "for this machine"),
        ("127.0.0.1", "expected HOST:PORT"),
        ("127.0.0.1:x", "expected HOST:PORT"),
        ("127.0.0.1:99999", "expected HOST:PORT"),
        (":8080", "expected HOST:PORT"),
    ],
)
def test_the_page_is_served_to_this_machine_alone(listen: str, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        parse_listen(listen)
    assert parse_listen("[::1]:0") == ("::1", 0)


@pytest.mark.parametrize(
    ("address", "target"),
    [
        ("0.0.0.0:50051", "127.0.0.1:50051"),
        ("[::]:50051", "[::1]:50051"),
        ("127.0.0.1:7", "127.0.0.1:7"),
        ("unix:/run/scopt.sock", "unix:/run/scopt.sock"),
    ],
)
def test_a_console_beside_a_server_reaches_it_by_this_machine(address: str, target: str) -> None:
    assert find_target(address) == target


def test_a_server_names_its_own_option_for_an_address_that_its_page_cannot_have() -> None:
    with pytest.raises(RequestError, match=r"--console 0\.0\.0\.0:8080: the page has no TLS"):
        ConsoleProcess("0.0.0.0:8080", ())
