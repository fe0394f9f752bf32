"""Where a server may listen: on this machine as it likes, elsewhere only with TLS and with clients that are known."""

from __future__ import annotations

import ipaddress
import re
import socket
from pathlib import Path

from service.errors import shown
from service.trust.tls import TlsFiles
from service.trust.tokens import Tokens

_ADDRESS = re.compile(r"(?P<host>\[[^\[\]]+\]|[^:\[\]/]+):(?P<port>\d{1,5})")
UNIX = "unix:"


def listen_problems(address: str, tls: TlsFiles | None, tokens: Tokens | None) -> list[str]:
    """What keeps a server from listening safely, one line each that says what would do; none: it may.

    Args:
        address: ``HOST:PORT``, ``[IPV6]:PORT`` or ``unix:PATH``.
        tls: its certificate.
        tokens: who may come in.
    """
    if address.startswith(UNIX):
        return _socket_problems(address)
    match = _ADDRESS.fullmatch(address)
    if match is None or int(match["port"]) > 65535:
        return [f"--listen {shown(address)} is no address; HOST:PORT, [IPV6]:PORT or unix:PATH would do"]
    problems = []
    if not is_loopback(match["host"]):
        where = f"--listen {address} can be reached from other machines"
        if tls is None:
            problems.append(f"{where}: --tls-cert and --tls-key are needed; 127.0.0.1 would do without")
        if tokens is None:
            problems.append(f"{where}: --tokens is needed to say who may plan; `scopt token` makes its lines")
    if tokens is not None:
        asks_for_certificates = tls is not None and tls.client_ca is not None
        if not tokens.has_tokens and not asks_for_certificates:
            problems.append(f"{tokens.path} knows clients by certificate only: --client-ca is needed, or token_sha256")
    elif tls is not None and tls.client_ca is not None:
        problems.append("--client-ca without --tokens: the file is needed to say which certificate may do what")
    return problems


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a host; a name other than localhost may mean anything."""
    host = host.strip("[]")
    if host.lower() == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def _socket_problems(address: str) -> list[str]:
    """Of ``unix:PATH``, where gRPC would take the path away from whoever listens there."""
    path = address.removeprefix(UNIX)
    if not path:
        return ["--listen unix: needs a path"]
    if not Path(path).parent.is_dir():
        return [f"--listen {address}: {Path(path).parent} is no folder"]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(path)
    except (FileNotFoundError, ConnectionRefusedError):  # nothing there, or left behind by a server that was killed
        return []
    except OSError as error:
        return [f"--listen {address}: cannot listen there ({error.strerror or error})"]
    return [f"--listen {address}: another server listens there; stop it, or choose another path"]
