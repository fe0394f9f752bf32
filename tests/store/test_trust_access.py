"""Who calls follows from a token or a certificate, what they may from their roles; limits hold for each client."""

from __future__ import annotations

import socket
from pathlib import Path

import grpc
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.proto.planner.v1 import planner_pb2
from service.trust import (
    LOCAL,
    OPEN_TO_ALL,
    ROLE_NEEDED,
    ClientLimiter,
    ClientLimits,
    Identity,
    Role,
    TlsFiles,
    TokenBuckets,
    Tokens,
    authenticate,
    authorize,
    find_listen_problems,
    is_loopback,
    make_token,
    peer_key,
)
from service.trust.rpc import Refusal

PLAN = "/planner.v1.PlannerService/Plan"


@pytest.fixture
def known(tmp_path: Path) -> tuple[str, Tokens]:
    token, line = make_token("ann", [Role.PLAN])
    path = tmp_path / "tokens.yaml"
    path.write_text(f"{line}\n- {{name: robot, roles: [plan, review], certificate: robot.local}}\n")
    path.chmod(0o600)
    return token, Tokens(path)


def test_a_bearer_token_or_a_verified_certificate_says_who_calls(known: tuple[str, Tokens]) -> None:
    token, tokens = known
    assert authenticate([("x", "y"), ("authorization", f"Bearer {token}")], (), tokens).name == "ann"
    assert authenticate([("authorization", f"bearer  {token} ")], (), tokens).name == "ann"
    assert authenticate([], [b"robot.local"], tokens).name == "robot"
    assert authenticate([("authorization", f"Bearer {token}")], [b"robot.local"], tokens).name == "ann"


@pytest.mark.parametrize(
    ("metadata", "names", "words"),
    [
        ([], [], "the caller is not identified; expected metadata 'authorization: Bearer TOKEN'"),
        ([("authorization", "Bearer scopt_wrong")], [], "the token is unknown"),
        ([("authorization", "Bearer scopt_wrong")], [b"robot.local"], "the token is unknown"),
        ([("authorization", "Basic c2NvcHQ=")], [], "authorization: expected one"),
        ([("authorization", "Bearer ")], [], "authorization: expected one"),
        ([("authorization", "Bearer a"), ("authorization", "Bearer b")], [], "authorization: expected one"),
        ([], [b"other.local"], "common name is unknown"),
        ([], [b"robot.local", b"other.local"], "common name is unknown"),
        ([], [b"\xff"], "common name is unknown"),
    ],
)
def test_whoever_is_not_known_is_unauthenticated_and_told_what_would_do(
    known: tuple[str, Tokens], metadata: list[tuple[str, str]], names: list[bytes], words: str
) -> None:
    with pytest.raises(Refusal) as caught:
        authenticate(metadata, names, known[1])
    assert caught.value.code is grpc.StatusCode.UNAUTHENTICATED
    assert words in caught.value.text
    assert "scopt_wrong" not in caught.value.text


def test_who_says_nothing_is_offered_what_the_server_takes_and_no_more(
    known: tuple[str, Tokens], tmp_path: Path
) -> None:
    path = tmp_path / "certificates.yaml"
    path.write_text("- {name: robot, roles: [plan], certificate: robot.local}\n")
    path.chmod(0o600)
    bearer, certificate = "metadata 'authorization: Bearer TOKEN'", "a client certificate with a common name"
    for tokens, asks, expected in (
        (known[1], False, bearer),
        (known[1], True, f"{bearer} or {certificate}"),
        (Tokens(path), True, certificate),
    ):
        with pytest.raises(Refusal) as caught:
            authenticate([], [], tokens, asks)
        assert caught.value.text == f"the caller is not identified; expected {expected}"


def test_without_tokens_everybody_is_local_and_may_everything() -> None:
    assert authenticate([("authorization", "Bearer x")], (), None) is LOCAL
    for method in ROLE_NEEDED:
        authorize(method, LOCAL)


def test_every_method_of_the_planner_has_its_role() -> None:
    service = planner_pb2.DESCRIPTOR.services_by_name["PlannerService"]
    methods = {f"/{service.full_name}/{method.name}" for method in service.methods}
    assert methods == {method for method in ROLE_NEEDED if method.startswith("/planner.")}
    needs = {method.rpartition("/")[2]: ROLE_NEEDED[method] for method in methods}
    assert {name for name, roles in needs.items() if Role.PLAN not in roles} == {
        "ReviewPlan", "GetStatus", "Execute", "Command", "Watch",
    }  # fmt: skip
    assert (needs["ReviewPlan"], needs["GetStatus"]) == ((Role.REVIEW,), (Role.ADMIN,))
    assert (needs["Execute"], needs["Command"]) == ((Role.EXECUTE,), (Role.COMMAND,))
    # Who reviews a plan can look at it, and have it checked anew and simulated.
    assert {name for name, roles in needs.items() if Role.REVIEW in roles} == {
        "ReviewPlan", "GetPlan", "GetScene", "ListPlans", "ListScenes", "SimulatePlan", "Verify", "Watch",
    }  # fmt: skip
    assert not OPEN_TO_ALL & set(ROLE_NEEDED)


@pytest.mark.parametrize("method", sorted(ROLE_NEEDED))
@pytest.mark.parametrize("role", list(Role))
def test_one_role_includes_no_other(method: str, role: Role) -> None:
    identity = Identity("ann", frozenset({role}))
    if role in ROLE_NEEDED[method]:
        authorize(method, identity)
    else:
        with pytest.raises(Refusal, match=rf"needs the role {' or '.join(ROLE_NEEDED[method])}; ann has {role}"):
            authorize(method, identity)


def test_a_method_without_a_role_nobody_may_call() -> None:
    for method in ("/planner.v1.PlannerService/NewOne", "/other.Service/Plan", ""):
        with pytest.raises(Refusal, match="nobody may call") as caught:
            authorize(method, LOCAL)
        assert caught.value.code is grpc.StatusCode.PERMISSION_DENIED


class _Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_bucket_gives_its_burst_at_once_and_its_rate_in_the_long_run() -> None:
    clock = _Clock()
    buckets = TokenBuckets(rate=2.0, burst=3.0, clock=clock)
    assert [buckets.take("ann") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert buckets.take("bob") == 0.0
    clock.now = 0.5
    assert [buckets.take("ann") for _ in range(2)] == [0.0, 0.5]
    clock.now = 1000.0
    assert [buckets.take("ann") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]


@given(st.lists(st.tuples(st.floats(0, 5), st.floats(0, 20)), max_size=50))
def test_what_a_bucket_gives_never_exceeds_burst_and_rate_by_more_than_one_amount(
    asked: list[tuple[float, float]],
) -> None:
    clock = _Clock()
    buckets = TokenBuckets(rate=2.0, burst=10.0, clock=clock)
    given_out = 0.0
    for wait, amount in asked:
        clock.now += wait
        if buckets.take("ann", amount) == 0.0:
            given_out += amount
        assert given_out <= 10.0 + 2.0 * clock.now + max(0.0, max(one for _, one in asked) - 10.0) + 1e-9


@given(st.lists(st.floats(0.1, 20), min_size=1, max_size=20))
def test_after_the_wait_it_was_told_a_client_gets_what_it_asked_for(amounts: list[float]) -> None:
    clock = _Clock()
    buckets = TokenBuckets(rate=3.0, burst=7.0, clock=clock)
    for amount in amounts:
        wait = buckets.take("ann", amount)
        if wait > 0.0:
            clock.now += wait + 1e-9
            assert buckets.take("ann", amount) == 0.0


def test_the_number_of_buckets_is_bounded() -> None:
    buckets = TokenBuckets(1.0, 1.0, max_keys=100)
    for number in range(1000):
        buckets.take(str(number))
    assert len(buckets) == 100


def test_a_client_above_its_limits_is_told_when_to_come_again() -> None:
    clock = _Clock()
    limits = ClientLimiter(ClientLimits(requests_per_s=4, requests_burst=1, max_open_calls=2), clock=clock)
    assert limits.request("ann") is None
    refusal = limits.request("ann")
    assert refusal is not None
    assert (refusal.code, refusal.retry_after_s) == (grpc.StatusCode.RESOURCE_EXHAUSTED, 0.25)
    assert refusal.text == "more than 4 requests a second; try again in 0.2 s"
    assert [limits.enter("ann") is None for _ in range(3)] == [True, True, False]
    limits.leave("ann")
    assert limits.enter("ann") is None


def test_uploaded_bytes_are_limited_by_themselves() -> None:
    clock = _Clock()
    limits = ClientLimiter(ClientLimits(upload_bytes_per_s=10, upload_bytes_burst=100), clock=clock)
    assert limits.upload("ann", 100) is None
    refusal = limits.upload("ann", 50)
    assert refusal is not None
    assert refusal.retry_after_s == 5.0
    all_of_it = limits.upload("ann", 50, already_counted=20)
    assert all_of_it is not None
    assert all_of_it.retry_after_s == 7.0
    clock.now = 5.0
    assert limits.upload("ann", 50) is None


@pytest.mark.parametrize(
    ("peer", "key"),
    [
        ("ipv4:127.0.0.1:53210", "127.0.0.1"),
        ("ipv6:%5B::1%5D:53210", "::/64"),
        ("ipv6:[2001:db8:1:2:3:4:5:6]:1", "2001:db8:1:2::/64"),
        ("ipv6:[2001:db8:1:2:9::]:2", "2001:db8:1:2::/64"),
        ("ipv6:[::ffff:10.0.0.7]:80", "10.0.0.7"),
        ("ipv6:[fe80::1%eth0]:80", "fe80::/64"),
        ("unix:", "unix"),
        ("unix:/run/x.sock", "unix"),
        ("ipv4:nonsense", "ipv4"),
        ("ipv4:nonsense:5", "unknown"),
        ("", "unknown"),
    ],
)
def test_a_peer_is_counted_under_its_address_and_not_its_port(peer: str, key: str) -> None:
    assert peer_key(peer) == key


@pytest.mark.parametrize(
    "address", ["127.0.0.1:50051", "localhost:0", "[::1]:50051", "127.8.8.8:1", "unix:/run/scopt.sock"]
)
def test_a_server_on_its_own_machine_listens_as_it_likes(address: str) -> None:
    assert find_listen_problems(address, None, None) == []


@pytest.mark.parametrize("address", ["0.0.0.0:50051", "[::]:50051", "10.0.0.7:50051", "robot.local:50051"])
def test_a_server_that_others_reach_needs_both_tls_and_tokens(address: str, known: tuple[str, Tokens]) -> None:
    tls = TlsFiles(Path("cert.pem"), Path("key.pem"))
    words = find_listen_problems(address, None, None)
    assert len(words) == 2
    assert "needs --tls-cert and --tls-key; 127.0.0.1 needs neither" in words[0]
    assert "needs --tokens" in words[1]
    assert len(find_listen_problems(address, tls, None)) == len(find_listen_problems(address, None, known[1])) == 1
    assert find_listen_problems(address, tls, known[1]) == []


def test_certificates_of_clients_and_who_they_are_go_together(tmp_path: Path) -> None:
    path = tmp_path / "tokens.yaml"
    path.write_text("- {name: robot, roles: [plan], certificate: robot.local}\n")
    path.chmod(0o600)
    tokens, cert, key = Tokens(path), Path("cert.pem"), Path("key.pem")
    assert "expected --client-ca too" in find_listen_problems("10.0.0.7:1", TlsFiles(cert, key), tokens)[0]
    assert find_listen_problems("10.0.0.7:1", TlsFiles(cert, key, Path("ca.pem")), tokens) == []
    assert (
        "--client-ca: needs --tokens"
        in find_listen_problems("127.0.0.1:1", TlsFiles(cert, key, Path("ca.pem")), None)[0]
    )


@pytest.mark.parametrize(
    "address", ["", "50051", "host", "a:b", "[::1]", "::1:50051", "127.0.0.1:70000", "unix:", "a/b:1"]
)
def test_what_is_no_address_is_refused(address: str) -> None:
    assert len(find_listen_problems(address, None, None)) == 1


def test_a_socket_is_not_taken_from_whoever_listens_there(tmp_path: Path) -> None:
    path = tmp_path / "s"
    address = f"unix:{path}"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        assert find_listen_problems(address, None, None) == []  # left behind: nobody answers
        listening.listen()
        (problem,) = find_listen_problems(address, None, None)
        assert problem == f"--listen {address}: in use by another server; stop it, or choose another path"


@pytest.mark.parametrize(
    ("path", "words"), [("none/s", "none is no folder"), (200 * "s", "cannot listen there (AF_UNIX path too long)")]
)
def test_why_there_can_be_no_socket_is_told(tmp_path: Path, path: str, words: str) -> None:
    (problem,) = find_listen_problems(f"unix:{tmp_path / path}", None, None)
    assert problem.endswith(words)


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "", "192.168.1.1", "localhost.evil.org", "127.0.0.1.evil.org", "2130706433"]
)
def test_only_what_surely_is_this_machine_is_loopback(host: str) -> None:
    assert not is_loopback(host)
