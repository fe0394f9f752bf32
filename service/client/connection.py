"""Where the server is, and how it knows the client."""

from __future__ import annotations

import ssl
from dataclasses import dataclass, field
from pathlib import Path

import grpc

from service.errors import RequestError, shown
from service.trust import is_loopback

MAX_MESSAGE_BYTES = 256 * 2**20
MAX_SENT_BYTES = 4 * 2**20  # of one message; a server takes no larger ones
MAX_SECRET_BYTES = 1_000_000
OPTIONS = (
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_send_message_length", -1),  # the server knows its own limits
    ("grpc.enable_http_proxy", 0),  # the planner runs next to the robot
    # A link that went dead without a word is noticed in half a minute.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 2000),
)


@dataclass(frozen=True)
class Connection:
    """How to reach a server.

    TLS is spoken as soon as one of its three files is given: ``tls_ca`` proves the server (the system's authorities do
    without it), ``tls_cert`` and ``tls_key`` prove the client.

    Attributes:
        target: ``HOST:PORT`` or ``unix:PATH``.
        token: what the server knows the client by; without TLS it is told to this machine only.

    Raises:
        RequestError: the parts do not go together.
    """

    target: str
    tls_ca: str | Path | None = None
    tls_cert: str | Path | None = None
    tls_key: str | Path | None = None
    token: str | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if _host(self.target) is None:
            raise RequestError(f"target: HOST:PORT is needed, got {shown(self.target)}")
        if (self.tls_cert is None) != (self.tls_key is None):
            raise RequestError("tls_cert and tls_key belong together; give both or none")
        if self.token is None:
            return
        if not self.token.isascii() or not self.token.isprintable() or not self.token or " " in self.token:
            raise RequestError("token: printable ASCII characters without blanks are needed")
        if not self.is_secure and not self.is_this_machine:
            raise RequestError(f"token: is not sent to {self.target} in the clear; give tls_ca")

    @property
    def is_secure(self) -> bool:
        """Whether TLS is spoken."""
        return self.tls_ca is not None or self.tls_cert is not None

    @property
    def is_this_machine(self) -> bool:
        """Whether the server runs here, or what leads to it does."""
        return _is_this_machine(self.target)

    @property
    def metadata(self) -> tuple[tuple[str, str], ...]:
        """What goes with every call."""
        return () if self.token is None else (("authorization", f"Bearer {self.token}"),)

    def credentials(self) -> grpc.ChannelCredentials | None:
        """Of TLS; None where it is not spoken.

        Raises:
            RequestError: a file cannot be read, or holds something else.
        """
        if not self.is_secure:
            return None
        parts = (("tls_ca", self.tls_ca), ("tls_key", self.tls_key), ("tls_cert", self.tls_cert))
        contents = [_content(name, path) for name, path in parts]
        self._check(contents[0])
        return grpc.ssl_channel_credentials(*contents)

    def _check(self, authority: bytes | None) -> None:
        """gRPC would go without what it cannot use, and say that nobody answers.

        Raises:
            RequestError: a file holds something else than it should.
        """
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        if authority is not None:
            try:
                context.load_verify_locations(cadata=authority.decode("ascii", "replace"))
            except (ssl.SSLError, ValueError):
                raise RequestError(f"tls_ca: {self.tls_ca} holds no certificate of an authority in PEM") from None
        if self.tls_cert is not None and self.tls_key is not None and Path(self.tls_key).is_file():
            try:
                context.load_cert_chain(self.tls_cert, self.tls_key, password=b"")
            except (ssl.SSLError, OSError, ValueError):
                pair = f"{self.tls_cert} and {self.tls_key}"
                raise RequestError(
                    f"tls_cert and tls_key: {pair} do not go together as certificate and unencrypted key in PEM"
                ) from None


def _content(name: str, path: str | Path | None) -> bytes | None:
    if path is None:
        return None
    try:
        with Path(path).open("rb") as file:
            return file.read(MAX_SECRET_BYTES)
    except OSError as error:
        raise RequestError(f"{name}: {path} cannot be read: {error.strerror}") from None


def _host(target: str) -> str | None:
    """The host of a target; empty for a socket of this machine, None where there is none."""
    if not target.isprintable() or " " in target:
        return None
    if target.startswith("unix:"):
        return "" if len(target) > len("unix:") else None
    host, _, port = target.removeprefix("dns:///").rpartition(":")
    return host.strip("[]") or None if port.isascii() and port.isdecimal() and 0 < int(port) < 2**16 else None


def _is_this_machine(target: str) -> bool:
    host = _host(target)
    return host == "" or (host is not None and is_loopback(host))
