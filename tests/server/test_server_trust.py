"""A real server with TLS, client certificates and tokens made on the spot, and those it lets in."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import grpc
import pytest
import trustme
from executor_waiting import until
from grpc_health.v1 import health_pb2, health_pb2_grpc
from planner_calls import plan_request, refusal
from planner_server import ServerProcess, never_ready, planner_server
from typer.testing import CliRunner

from service.cli.app import app
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.trust import Role, make_token

pytestmark = pytest.mark.filterwarnings("error")

Answer = tuple[str, str]


@dataclass
class Fort:
    """A server that asks for a certificate and a token.

    Attributes:
        authority: of all certificates; tokens: by the name of their client; lines: of the tokens file.
        arm: the certificate of a client who is known by it.
    """

    process: ServerProcess
    folder: Path
    authority: trustme.CA
    arm: trustme.LeafCert
    tokens: dict[str, str]
    lines: str

    def write_tokens(self, text: str) -> None:
        """Replace the file, and have it read."""
        (self.folder / "tokens.yaml").write_text(text)
        self.read_anew()

    def show(self, leaf: trustme.LeafCert) -> None:
        """Replace the server's certificate, and have it read."""
        _write(self.folder / "key.pem", leaf.private_key_pem.bytes())
        _write(self.folder / "cert.pem", leaf.cert_chain_pems[0].bytes())
        self.read_anew()

    def read_anew(self) -> None:
        """Have the files read that were changed."""
        told = self.log().count("certificates ")  # which come last
        os.kill(self.process.process.pid, signal.SIGHUP)
        assert until(lambda: self.log().count("certificates ") > told)

    def log(self) -> str:
        """All that the server said of itself."""
        return self.process.log.read_text()

    def ask(self, token: str = "", *, leaf: trustme.LeafCert | None = None, stranger: bool = False) -> Answer:
        """Code and text of a call of ``GetPlan`` as this client; ``NOT_FOUND`` means that it was let in.

        Args:
            leaf: the client's certificate; None for none.
            stranger: whether another authority is expected of the server.
        """
        return self._called(
            lambda stub, said: stub.GetPlan(wire.GetPlanRequest(plan_id="x"), **said), token, leaf, stranger
        )

    def status(self, token: str) -> Answer:
        """Of a call of ``GetStatus``, which takes another role."""
        return self._called(lambda stub, said: stub.GetStatus(wire.GetStatusRequest(), **said), token, self.arm, False)

    def plan(self, token: str) -> Answer:
        """Of a call of ``Plan``."""
        return self._called(lambda stub, said: stub.Plan(plan_request(), **said), token, self.arm, False)

    def _called(self, call: Callable[..., object], token: str, leaf: trustme.LeafCert | None, stranger: bool) -> Answer:
        root = (trustme.CA() if stranger else self.authority).cert_pem.bytes()
        own = () if leaf is None else (leaf.private_key_pem.bytes(), leaf.cert_chain_pems[0].bytes())
        said = {"metadata": (("authorization", f"Bearer {token}"),) if token else (), "timeout": 30}
        credentials = grpc.ssl_channel_credentials(root, *own)
        with grpc.secure_channel(self.process.address, credentials) as channel:
            return refusal(lambda: call(PlannerServiceStub(channel), said))[:2]


@pytest.fixture(scope="module")
def fort(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fort]:
    folder, authority = tmp_path_factory.mktemp("fort"), trustme.CA()
    tokens, lines = {}, "- {name: arm, roles: [plan], certificate: arm-3}\n"
    for role in Role:
        tokens[role.value], line = make_token(f"{role}-desk", (role,))
        lines += f"{line}\n"
    _write(folder / "tokens.yaml", lines.encode())
    leaf = authority.issue_cert("127.0.0.1", common_name="server")
    _write(folder / "key.pem", leaf.private_key_pem.bytes())
    _write(folder / "cert.pem", leaf.cert_chain_pems[0].bytes())
    authority.cert_pem.write_to_path(folder / "ca.pem")
    options = {"tls-cert": "cert.pem", "tls-key": "key.pem", "client-ca": "ca.pem", "tokens": "tokens.yaml"}
    words = [word for name, file in options.items() for word in (f"--{name}", str(folder / file))]
    with planner_server(folder / "data", *words) as process:
        arm = authority.issue_cert("arm.local", common_name="arm-3")
        yield Fort(process, folder, authority, arm, tokens, lines)


def _write(path: Path, data: bytes) -> None:
    path.touch(mode=0o600)
    path.write_bytes(data)


def test_client_is_known_by_its_certificate_and_by_its_token(fort: Fort) -> None:
    assert fort.ask(leaf=fort.arm)[0] == "NOT_FOUND"
    assert fort.ask(fort.tokens["plan"], leaf=fort.authority.issue_cert("a.local", common_name="a"))[0] == "NOT_FOUND"
    assert fort.plan(fort.tokens["plan"])[0] == "OK"


def test_who_has_no_certificate_of_the_authority_is_not_let_in(fort: Fort) -> None:
    token = fort.tokens["plan"]
    assert fort.ask(token)[0] == "UNAVAILABLE"
    assert fort.ask(token, leaf=trustme.CA().issue_cert("a.local", common_name="arm-3"))[0] == "UNAVAILABLE"


def test_client_does_not_talk_to_a_server_of_another_authority(fort: Fort) -> None:
    code, words = fort.ask(fort.tokens["plan"], leaf=fort.arm, stranger=True)
    assert code == "UNAVAILABLE"
    assert "CERTIFICATE_VERIFY_FAILED" in words


def test_client_without_tls_gets_nothing(fort: Fort) -> None:
    with grpc.insecure_channel(fort.process.address) as channel:
        check = health_pb2_grpc.HealthStub(channel).Check
        assert refusal(lambda: check(health_pb2.HealthCheckRequest(), timeout=120))[0] == "UNAVAILABLE"


def test_unknown_token_and_certificate_are_told_apart_and_not_repeated(fort: Fort) -> None:
    made_up = "scopt_" + "A" * 43
    assert fort.ask(made_up, leaf=fort.arm) == (
        "UNAUTHENTICATED", "authorization: the token is unknown to this server, or no longer valid",
    )  # fmt: skip
    nobody = fort.authority.issue_cert("n.local", common_name="nobody")
    assert fort.ask(leaf=nobody) == (
        "UNAUTHENTICATED", "the client certificate's common name is unknown to this server",
    )  # fmt: skip


def test_every_role_may_what_it_says_and_no_more(fort: Fort) -> None:
    assert fort.status(fort.tokens["admin"])[0] == "OK"
    assert fort.status(fort.tokens["plan"]) == (
        "PERMISSION_DENIED", "GetStatus needs the role admin; plan-desk has plan",
    )  # fmt: skip
    assert fort.plan(fort.tokens["review"])[0] == "PERMISSION_DENIED"


def test_tokens_come_and_go_while_the_server_runs(fort: Fort) -> None:
    token, line = make_token("new-desk", (Role.PLAN,))
    assert fort.ask(token, leaf=fort.arm)[0] == "UNAUTHENTICATED"
    fort.write_tokens(line)
    assert fort.ask(token, leaf=fort.arm)[0] == "NOT_FOUND"
    assert fort.ask(fort.tokens["plan"], leaf=fort.arm)[0] == "UNAUTHENTICATED"
    fort.write_tokens("nonsense: [")  # what was in force before stays
    assert fort.ask(token, leaf=fort.arm)[0] == "NOT_FOUND"
    fort.write_tokens(fort.lines)
    assert fort.ask(fort.tokens["plan"], leaf=fort.arm)[0] == "NOT_FOUND"


def test_certificate_is_renewed_while_the_server_runs(fort: Fort) -> None:
    token = fort.tokens["plan"]
    fort.show(trustme.CA().issue_cert("127.0.0.1", common_name="server"))
    code, words = fort.ask(token, leaf=fort.arm)
    assert code == "UNAVAILABLE"
    assert "CERTIFICATE_VERIFY_FAILED" in words
    fort.show(fort.authority.issue_cert("127.0.0.1", common_name="server"))
    assert fort.ask(token, leaf=fort.arm)[0] == "NOT_FOUND"
    _write(fort.folder / "cert.pem", b"nonsense")
    fort.read_anew()  # what was in force before stays
    assert fort.ask(token, leaf=fort.arm)[0] == "NOT_FOUND"
    fort.show(fort.authority.issue_cert("127.0.0.1", common_name="server"))


def test_no_secret_is_in_the_log_or_in_what_is_kept(fort: Fort) -> None:
    fort.ask(fort.tokens["plan"], leaf=fort.arm)
    kept = [path.read_bytes() for path in (fort.folder / "data").rglob("*") if path.is_file()]
    everything = b"".join([fort.log().encode(), *kept])
    assert b"plan-desk" in everything
    for token in fort.tokens.values():
        assert token.removeprefix("scopt_").encode() not in everything
    assert b"PRIVATE KEY" not in everything


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--tls-cert", "gone.pem", "--tls-key", "gone.pem"), ("gone.pem: cannot be read",)),
        (("--allow", "/"), ("is the whole disk",)),
    ],
)
def test_server_that_would_not_be_safe_does_not_start(
    tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    code, told = never_ready(tmp_path / "data", *arguments)
    assert code == 3
    assert "Traceback" not in told
    for some in words:
        assert some in told


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--listen", "0.0.0.0:0"), ("needs --tls-cert and --tls-key", "needs --tokens")),
        (("--robots", "/gone", "--listen", "127.0.0.1:0"), ("--robots /gone: is no folder",)),
    ],
)
def test_options_that_would_not_be_safe_are_refused_before_anything_starts(
    tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    done = CliRunner().invoke(app, ["serve", "--data", str(tmp_path / "data"), *arguments])
    assert done.exit_code == 3
    assert not (tmp_path / "data").exists()
    for some in words:
        assert some in done.output
