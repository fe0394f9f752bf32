"""Connections of the clients: targets, TLS on both sides, tokens."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
import trustme
from hypothesis import given
from hypothesis import strategies as st
from planner_clients import CLIENTS
from planner_stand_in import PlannerStandIn, serving

from service.client import PlannerClient, PlannerError, Retry
from service.client.connection import Connection
from service.client.error_texts import explain_unreachable
from service.errors import RequestError


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates: ``ca``, ``server`` and ``client`` of it, and ``other``, an unrelated authority."""
    folder = tmp_path_factory.mktemp("tls")
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(folder / "ca.pem"))
    trustme.CA().cert_pem.write_to_path(str(folder / "other.pem"))
    for name, identity in (("server", "localhost"), ("client", "arm@lab.example")):
        leaf = authority.issue_cert(identity)
        leaf.private_key_pem.write_to_path(str(folder / f"{name}.key"))
        leaf.cert_chain_pems[0].write_to_path(str(folder / f"{name}.pem"))
    return folder


def _server(folder: Path, is_mutual: bool) -> grpc.ServerCredentials:
    pair = (folder / "server.key").read_bytes(), (folder / "server.pem").read_bytes()
    return grpc.ssl_server_credentials([pair], (folder / "ca.pem").read_bytes() if is_mutual else None, is_mutual)


@pytest.mark.parametrize("kind", CLIENTS)
def test_tls_with_a_token(folder: Path, kind: str) -> None:
    stand_in = PlannerStandIn()
    with (
        serving(stand_in, _server(folder, False)) as target,
        CLIENTS[kind](target, tls_ca=folder / "ca.pem", token="s3cret") as client,
    ):
        assert client.status().version == "0.1.0"
    assert stand_in.metadata[0]["authorization"] == "Bearer s3cret"


@pytest.mark.parametrize("kind", CLIENTS)
def test_both_sides_prove_who_they_are(folder: Path, kind: str) -> None:
    proof = {"tls_ca": folder / "ca.pem", "tls_cert": folder / "client.pem", "tls_key": folder / "client.key"}
    once = Retry(attempts=1)
    with serving(PlannerStandIn(), _server(folder, True)) as target:
        with CLIENTS[kind](target, **proof) as client:
            assert client.robots()[0].name == "atlas"
        for less in ({"tls_ca": folder / "ca.pem"}, {**proof, "tls_ca": folder / "other.pem"}, {}):
            with (
                CLIENTS[kind](target, retry=once, timeout_s=60.0, **less) as client,
                pytest.raises(PlannerError) as end,
            ):
                client.robots()
            assert end.value.code is grpc.StatusCode.UNAVAILABLE


@contextmanager
def _sending(words: bytes) -> Iterator[str]:
    """Yield the address of a program that sends these bytes to every connection and closes it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                with connection:
                    connection.recv(1000)
                    connection.sendall(words)

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield f"127.0.0.1:{listener.getsockname()[1]}"
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


def _error_text(kind: str, target: str, **settings: Any) -> str:
    """Return the error text of an unreachable server."""
    once = Retry(attempts=1)
    with CLIENTS[kind](target, retry=once, timeout_s=60.0, **settings) as client, pytest.raises(PlannerError) as end:
        client.robots()
    assert end.value.code is grpc.StatusCode.UNAVAILABLE
    assert len(end.value.text) < 200
    return str(end.value.text)


@pytest.mark.parametrize("kind", CLIENTS)
def test_an_address_without_a_server_is_named(kind: str) -> None:
    for target in ("localhost:1", "unix:/tmp/no/such/socket"):
        words = "start one there with `scopt serve`, or try again if it is still starting"
        assert _error_text(kind, target) == f"no server answers at {target}; {words}"
    target = "no.such.host.invalid:50051"
    assert _error_text(kind, target) == f"target: no address is known for {target}; check the name"


@pytest.mark.parametrize("kind", CLIENTS)
@pytest.mark.parametrize("words", [b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n", b"SSH-2.0-OpenSSH\r\n"])
def test_another_program_at_the_address_is_no_planning_service(kind: str, words: bytes) -> None:
    with _sending(words) as target:
        assert _error_text(kind, target) == f"the program at {target} is no planning service; check the port"


@pytest.mark.parametrize("kind", CLIENTS)
def test_errors_name_the_missing_or_superfluous_tls_option(folder: Path, kind: str) -> None:
    ca = folder / "ca.pem"
    with serving(PlannerStandIn(), _server(folder, False)) as target:
        closed = f"the server at {target} closes the connection; it may use TLS: give tls_ca (--tls-ca)"
        assert _error_text(kind, target) == closed
        found = _error_text(kind, target, tls_ca=folder / "other.pem")
        assert found.startswith(f"the server's certificate at {target} does not come from the authority in tls_ca")
        by_number = target.replace("localhost", "127.0.0.1")
        assert _error_text(kind, by_number, tls_ca=ca).startswith(
            f"the server's certificate is not for {by_number}; use a host name"
        )
    with serving(PlannerStandIn(), _server(folder, True)) as target:
        assert "it may require a client certificate: give tls_cert" in _error_text(kind, target, tls_ca=ca)
    with serving(PlannerStandIn()) as target:
        assert _error_text(kind, target, tls_ca=ca).startswith(
            f"the server at {target} does not use TLS; leave out tls_ca"
        )


def test_a_servers_own_text_stays() -> None:
    connection = Connection("robot:50051")
    for text, expected in (
        ("the server is stopping", "the server is stopping"),
        ("Socket closed", "the connection to robot:50051 broke"),
    ):
        error = PlannerError(grpc.StatusCode.UNAVAILABLE, text, retry_delay_s=0.5)
        explained = explain_unreachable(error, connection)
        assert (explained.text, explained.retry_delay_s) == (expected, 0.5)


def test_a_token_is_sent_to_this_machine_without_tls_and_elsewhere_with_it(tmp_path: Path) -> None:
    for target in ("localhost:50051", "127.0.0.1:1", "[::1]:1", "unix:/tmp/socket"):
        assert Connection(target, token="abc").metadata == (("authorization", "Bearer abc"),)
    for target in ("robot:50051", "192.168.1.2:1", "[::2]:1", "localhost.evil.example:1"):
        with pytest.raises(RequestError, match="without TLS; give tls_ca"):
            Connection(target, token="abc")
        assert Connection(target, tls_ca=tmp_path / "ca.pem", token="abc").is_secure


@pytest.mark.parametrize("token", ["", "two words", "line\nend", "\u00e4"])
def test_a_token_unfit_for_a_header_is_refused_and_not_shown(token: str) -> None:
    with pytest.raises(RequestError, match="token: expected printable ASCII") as caught:
        Connection("localhost:1", token=token)
    assert not token or token not in str(caught.value)
    assert "abc" not in repr(Connection("localhost:1", token="abc"))


@pytest.mark.parametrize(
    "target", ["", "localhost", "localhost:", ":1", "localhost:70000", "a b:1", "unix:", "x:\u0661"]
)
def test_a_target_without_host_and_port_is_refused(target: str) -> None:
    with pytest.raises(RequestError, match="expected HOST:PORT or unix:PATH"):
        PlannerClient(target)


@given(st.text(max_size=30))
def test_any_text_is_a_target_or_refused(text: str) -> None:
    try:
        connection = Connection(text)
    except RequestError:
        return
    assert connection.target == text


def test_unusable_tls_files_are_refused(folder: Path) -> None:
    with pytest.raises(RequestError, match="tls_cert and tls_key: one is missing; give both or none"):
        PlannerClient("localhost:1", tls_cert=folder / "client.pem")
    with pytest.raises(RequestError, match=r"tls_ca: .*missing\.pem cannot be read: No such file"):
        PlannerClient("localhost:1", tls_ca=folder / "missing.pem")
    (folder / "notes.pem").write_text("no certificate")
    with pytest.raises(RequestError, match=r"tls_ca: .*notes\.pem contains no PEM certificate of an authority"):
        PlannerClient("localhost:1", tls_ca=folder / "notes.pem")
    with pytest.raises(RequestError, match=r"tls_cert and tls_key: .*server\.key are no PEM certificate"):
        PlannerClient("localhost:1", tls_cert=folder / "client.pem", tls_key=folder / "server.key")


def test_a_port_that_is_bound_and_does_not_answer_belongs_to_a_server_that_starts() -> None:
    text = (
        "failed to connect to all addresses; last error: UNKNOWN: ipv4:127.0.0.1:50051: connection attempt timed out "
        "before receiving SETTINGS frame"
    )
    error = PlannerError(grpc.StatusCode.UNAVAILABLE, text)
    words = explain_unreachable(error, Connection("localhost:50051")).text
    assert words.startswith("the server at localhost:50051 does not answer yet; it is starting")
