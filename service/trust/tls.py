"""Credentials of a gRPC server from its certificate files."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

import grpc

from service.trust.errors import TrustError

MAX_FILE_BYTES = 1_000_000


@dataclass(frozen=True)
class TlsFiles:
    """PEM files of a server.

    Attributes:
        cert: certificate chain.
        key: private key.
        client_ca: authority that must have signed every client's certificate; None needs no client certificates.
    """

    cert: Path
    key: Path
    client_ca: Path | None = None


class Certificates:
    """Certificates of a server, which can be reloaded while it runs.

    Raises:
        TrustError: a file cannot be used.
    """

    def __init__(self, files: TlsFiles) -> None:
        self._files = files
        self._newest = _read_configuration(files)

    @property
    def credentials(self) -> grpc.ServerCredentials:
        """Credentials for ``Server.add_secure_port``; every new connection uses the files as last read."""
        return grpc.dynamic_ssl_server_credentials(
            self._newest, lambda: self._newest, require_client_authentication=self._files.client_ca is not None
        )

    def reload(self) -> None:
        """Read the files again.

        Raises:
            TrustError: a file cannot be used; the previous certificates stay valid.
        """
        self._newest = _read_configuration(self._files)


def _read_configuration(files: TlsFiles) -> grpc.ServerCertificateConfiguration:
    cert, key = _read_pem(files.cert), _read_pem(files.key)
    if files.key.stat().st_mode & 0o027:
        raise TrustError(f"{files.key}: others may read the private key; run chmod 600")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        # An empty password prevents a prompt at the terminal.
        context.load_cert_chain(files.cert, files.key, password=b"")
    except (ssl.SSLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or "no certificate and unencrypted key in PEM"
        text = str(reason).lower().replace("_", " ")
        raise TrustError(f"{files.cert} and {files.key} do not match as certificate and key ({text})") from None
    authority = None
    if files.client_ca is not None:
        authority = _read_pem(files.client_ca)
        try:
            context.load_verify_locations(files.client_ca)
        except (ssl.SSLError, OSError):
            raise TrustError(f"{files.client_ca}: expected the certificate of an authority in PEM") from None
    return grpc.ssl_server_certificate_configuration([(key, cert)], authority)


def _read_pem(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES)
    except OSError as error:
        raise TrustError(f"{path}: cannot be read ({error.strerror})") from None
    if b"-----BEGIN " not in data:
        raise TrustError(f"{path}: is no PEM file")
    return data
