"""Address of a server, TLS files and token."""

from __future__ import annotations

import ssl
from dataclasses import dataclass, field
from pathlib import Path

import grpc

from service.errors import RequestError, shown
from service.trust import is_loopback

MAX_MESSAGE_BYTES = 256 * 2**20
MAX_SENT_BYTES = 4 * 2**20  # of one message; servers accept no larger ones
MAX_SECRET_BYTES = 1_000_000
OPTIONS = (
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_send_message_length", -1),  # the server knows its own limits
    ("grpc.enable_http_proxy", 0),  # the planner runs next to the robot
    # A silently dead link is noticed within half a minute.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 2000),
)


@dataclass(frozen=True)
class Connection:
    """Address of a server and proofs of identity, checked at construction.

    Each of the three files turns TLS on: ``tls_ca`` proves the server (the system's authorities by default),
    ``tls_cert`` and ``tls_key`` prove the client.

    Attributes:
        target: ``HOST:PORT`` or ``unix:PATH``.
        token: bearer token of the client; without TLS it is only sent to this machine.

    Raises:
        TypeError: a value is of a wrong type.
        RequestError: the values contradict each other.
    """

    target: str
    tls_ca: str | Path | None = None
    tls_cert: str | Path | None = None
    tls_key: str | Path | None = None
    token: str | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        _check_text("target", self.target)
        if self.token is not None:
            _check_text("token", self.token)
        if _parse_host(self.target) is None:
            raise RequestError(f"target: {shown(self.target)} is no address; expected HOST:PORT or unix:PATH")
        if (self.tls_cert is None) != (self.tls_key is None):
            raise RequestError("tls_cert and tls_key: one is missing; give both or none")
        if self.token is None:
            return
        if not self.token.isascii() or not self.token.isprintable() or not self.token or " " in self.token:
            raise RequestError("token: expected printable ASCII characters without blanks")
        if not self.is_secure and not self.is_this_machine:
            raise RequestError(f"token: it is not sent to {self.target} without TLS; give tls_ca")

    @property
    def is_secure(self) -> bool:
        """Whether TLS is on."""
        return self.tls_ca is not None or self.tls_cert is not None

    @property
    def is_this_machine(self) -> bool:
        """Whether the target is an address of this machine."""
        host = _parse_host(self.target)
        return host == "" or (host is not None and is_loopback(host))

    @property
    def metadata(self) -> tuple[tuple[str, str], ...]:
        """Metadata of every call."""
        return () if self.token is None else (("authorization", f"Bearer {self.token}"),)

    def credentials(self) -> grpc.ChannelCredentials | None:
        """Return the TLS credentials; None without TLS.

        Raises:
            RequestError: a file cannot be read, or has the wrong content.
        """
        if not self.is_secure:
            return None
        parts = (("tls_ca", self.tls_ca), ("tls_key", self.tls_key), ("tls_cert", self.tls_cert))
        contents = [_read_file(name, path) for name, path in parts]
        self._check_files(contents[0])
        return grpc.ssl_channel_credentials(*contents)

    def _check_files(self, authority: bytes | None) -> None:
        """Check the TLS files, because gRPC ignores unusable ones and reports an unreachable server.

        Raises:
            RequestError: a file has the wrong content.
        """
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        if authority is not None:
            try:
                context.load_verify_locations(cadata=authority.decode("ascii", "replace"))
            except (ssl.SSLError, ValueError):
                raise RequestError(f"tls_ca: {self.tls_ca} contains no PEM certificate of an authority") from None
        if self.tls_cert is not None and self.tls_key is not None and Path(self.tls_key).is_file():
            try:
                context.load_cert_chain(self.tls_cert, self.tls_key, password=b"")
            except (ssl.SSLError, OSError, ValueError):
                pair = f"{self.tls_cert} and {self.tls_key}"
                raise RequestError(
                    f"tls_cert and tls_key: {pair} are no PEM certificate with its unencrypted key"
                ) from None


def _read_file(name: str, path: str | Path | None) -> bytes | None:
    if path is None:
        return None
    try:
        with Path(path).open("rb") as file:
            return file.read(MAX_SECRET_BYTES)
    except OSError as error:
        raise RequestError(f"{name}: {path} cannot be read: {error.strerror}") from None


def _parse_host(target: str) -> str | None:
    """Return the host of a target; empty for a Unix socket, None for a target without one."""
    if not target.isprintable() or " " in target:
        return None
    if target.startswith("unix:"):
        return "" if len(target) > len("unix:") else None
    host, _, port = target.removeprefix("dns:///").rpartition(":")
    return host.strip("[]") or None if port.isascii() and port.isdecimal() and 0 < int(port) < 2**16 else None


def _check_text(name: str, value: object) -> None:
    """
    Raises:
        TypeError: the value is no text.
    """
    if not isinstance(value, str):
        raise TypeError(f"{name}: expected str, got {type(value).__name__}")
