"""With certificates made on the spot: the server shows its own, and knows its clients by theirs."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

import grpc
import pytest
import trustme
from small_service import serving

from service.proto.planner.v1 import planner_pb2, planner_pb2_grpc
from service.trust import AccessInterceptor, Certificates, ClientLimiter, Role, TlsFiles, Tokens, TrustError, make_token


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture
def files(tmp_path: Path, authority: trustme.CA) -> TlsFiles:
    return _written(tmp_path, authority, authority.issue_cert("127.0.0.1", common_name="server"))


def _written(folder: Path, authority: trustme.CA, leaf: trustme.LeafCert) -> TlsFiles:
    files = TlsFiles(folder / "cert.pem", folder / "key.pem", folder / "ca.pem")
    leaf.cert_chain_pems[0].write_to_path(files.cert)
    leaf.private_key_pem.write_to_path(files.key)
    files.key.chmod(0o600)
    authority.cert_pem.write_to_path(folder / "ca.pem")
    return files


def _client(authority: trustme.CA, leaf: trustme.LeafCert | None = None) -> grpc.ChannelCredentials:
    if leaf is None:
        return grpc.ssl_channel_credentials(authority.cert_pem.bytes())
    return grpc.ssl_channel_credentials(
        authority.cert_pem.bytes(), leaf.private_key_pem.bytes(), leaf.cert_chain_pems[0].bytes()
    )


def _run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(coroutine, 240))


async def _ask(address: str, credentials: grpc.ChannelCredentials, token: str = "") -> grpc.StatusCode:
    metadata = (("authorization", f"Bearer {token}"),) if token else ()
    async with grpc.aio.secure_channel(address, credentials) as channel:
        stub = planner_pb2_grpc.PlannerServiceStub(channel)
        try:
            await stub.ListRobots(planner_pb2.ListRobotsRequest(), metadata=metadata, timeout=60)
        except grpc.aio.AioRpcError as error:
            return error.code()
    return grpc.StatusCode.OK


def _tokens(folder: Path, text: str) -> Tokens:
    path = folder / "tokens.yaml"
    path.write_text(text)
    path.chmod(0o600)
    return Tokens(path)


def test_a_token_comes_in_over_tls_and_nothing_without_it(
    tmp_path: Path, authority: trustme.CA, files: TlsFiles
) -> None:
    token, line = make_token("ann", [Role.PLAN])
    tokens = _tokens(tmp_path, line)
    credentials = Certificates(TlsFiles(files.cert, files.key)).credentials

    async def calls() -> None:
        async with serving([AccessInterceptor(tokens, ClientLimiter())], credentials) as (address, answering):
            assert await _ask(address, _client(authority), token) is grpc.StatusCode.OK
            assert await _ask(address, _client(authority)) is grpc.StatusCode.UNAUTHENTICATED
            assert await _ask(address, _client(trustme.CA()), token) is grpc.StatusCode.UNAVAILABLE
            async with grpc.aio.insecure_channel(address) as channel:
                stub = planner_pb2_grpc.PlannerServiceStub(channel)
                with pytest.raises(grpc.aio.AioRpcError):
                    await stub.ListRobots(planner_pb2.ListRobotsRequest(), timeout=1)
        assert answering.callers == [("ListRobots", "ann")]

    _run(calls())


def test_a_client_is_known_by_its_certificate_and_a_strangers_is_not_let_in(
    tmp_path: Path, authority: trustme.CA, files: TlsFiles
) -> None:
    tokens = _tokens(
        tmp_path,
        "- {name: robot-7, roles: [plan], certificate: robot-7.local}\n- {name: watch, roles: [admin], certificate: w}",
    )
    credentials = Certificates(files).credentials

    async def calls() -> None:
        async with serving([AccessInterceptor(tokens, ClientLimiter())], credentials) as (address, answering):
            codes = [
                await _ask(address, _client(authority, issuer.issue_cert("x.local", common_name=name)))
                for issuer, name in (
                    (authority, "robot-7.local"),
                    (authority, "w"),
                    (authority, "robot-8.local"),
                    (trustme.CA(), "robot-7.local"),
                )
            ]
            codes.append(await _ask(address, _client(authority)))
        assert codes == [
            grpc.StatusCode.OK,
            grpc.StatusCode.PERMISSION_DENIED,
            grpc.StatusCode.UNAUTHENTICATED,
            grpc.StatusCode.UNAVAILABLE,
            grpc.StatusCode.UNAVAILABLE,
        ]
        assert answering.callers == [("ListRobots", "robot-7")]

    _run(calls())


def test_what_is_wrong_with_certificates_is_named(tmp_path: Path, authority: trustme.CA, files: TlsFiles) -> None:
    (tmp_path / "other").mkdir()
    other = _written(tmp_path / "other", authority, authority.issue_cert("127.0.0.1"))
    (tmp_path / "text").write_text("-----BEGIN nothing")
    (tmp_path / "text").chmod(0o600)
    for wrong, words in (
        (TlsFiles(files.cert, other.key), r"do not match as certificate and key \(key values mismatch\)"),
        (TlsFiles(files.key, files.key), "do not match"),
        (TlsFiles(tmp_path / "text", files.key), "do not match"),
        (TlsFiles(files.cert, files.key, tmp_path / "text"), "text: expected the certificate of an authority"),
        (TlsFiles(files.cert, files.key, tmp_path / "none.pem"), r"none\.pem: cannot be read"),
        (TlsFiles(tmp_path, files.key), "cannot be read"),
    ):
        with pytest.raises(TrustError, match=words):
            Certificates(wrong)
    files.key.chmod(0o644)
    with pytest.raises(TrustError, match=r"key\.pem: others may read the private key; run chmod 600"):
        Certificates(files)
