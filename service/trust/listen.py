"""Addresses a server may listen at: any on this machine, others only with TLS and known clients."""

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


def find_listen_problems(address: str, tls: TlsFiles | None, tokens: Tokens | None) -> list[str]:
    """Return the reasons why a server cannot listen safely, one line each.

    Args:
        address: ``HOST:PORT``, ``[IPV6]:PORT`` or ``unix:PATH``.
        tls: certificate files.
        tokens: known clients.
    """
    if address.startswith(UNIX):
        return find_socket_problems(address.removeprefix(UNIX))
    match = _ADDRESS.fullmatch(address)
    if match is None or int(match["port"]) > 65535:
        return [f"--listen {shown(address)}: expected HOST:PORT, [IPV6]:PORT or unix:PATH"]
    problems = []
    if not is_loopback(match["host"]):
        prefix = f"--listen {address}: can be reached from other machines and needs"
        if tls is None:
            problems.append(f"{prefix} --tls-cert and --tls-key; 127.0.0.1 needs neither")
        if tokens is None:
            problems.append(f"{prefix} --tokens, the file of known clients; `scopt token` makes its lines")
    if tokens is not None:
        uses_certificates = tls is not None and tls.client_ca is not None
        if not tokens.has_tokens and not uses_certificates:
            problems.append(f"{tokens.path}: identifies clients by certificate only; expected --client-ca too")
    elif tls is not None and tls.client_ca is not None:
        problems.append("--client-ca: needs --tokens, which names the roles of each certificate")
    return problems


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach a host; of names only localhost is known to be so."""
    host = host.strip("[]")
    if host.lower() == "localhost":
        return True
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return (mapped or address).is_loopback


def find_socket_problems(path: Path | str) -> list[str]:
    """Return the problems of ``--listen unix:PATH``; gRPC itself would take the path over from another server."""
    address = f"{UNIX}{path}"
    if not str(path):
        return ["--listen unix: expected a path"]
    if not Path(path).parent.is_dir():
        return [f"--listen {address}: {Path(path).parent} is no folder"]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(str(path))
    except (FileNotFoundError, ConnectionRefusedError):  # no file, or that of a server that was killed
        return []
    except OSError as error:
        return [f"--listen {address}: cannot listen there ({error.strerror or error})"]
    return [f"--listen {address}: in use by another server; stop it, or choose another path"]
