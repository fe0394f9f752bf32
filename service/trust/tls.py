"""Certificates: files in, credentials of a gRPC server out, with a plain word on what is wrong in between."""

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
        cert: its certificate chain; key: its private key.
        client_ca: with it, every client must bring a certificate that this authority has signed.
    """

    cert: Path
    key: Path
    client_ca: Path | None = None


class Certificates:
    """What a server shows its clients, and whom it asks for the same; read anew while it runs.

    Args:
        files: that hold it.

    Raises:
        TrustError: naming the file that cannot be used.
    """

    def __init__(self, files: TlsFiles) -> None:
        self._files = files
        self._newest = _configuration(files)

    @property
    def credentials(self) -> grpc.ServerCredentials:
        """Credentials for ``Server.add_secure_port``; every new connection meets what was read last."""
        return grpc.dynamic_ssl_server_credentials(
            self._newest, lambda: self._newest, require_client_authentication=self._files.client_ca is not None
        )

    def reload(self) -> None:
        """Read the files again.

        Raises:
            TrustError: naming the file that cannot be used; what was read before is in force still.
        """
        self._newest = _configuration(self._files)


def _configuration(files: TlsFiles) -> grpc.ServerCertificateConfiguration:
    cert, key = _pem(files.cert), _pem(files.key)
    if files.key.stat().st_mode & 0o027:
        raise TrustError(f"{files.key}: others may read the private key; chmod 600 would do")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        # Without a password nobody is asked for one at a terminal.
        context.load_cert_chain(files.cert, files.key, password=b"")
    except (ssl.SSLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or "no certificate and unencrypted key in PEM"
        words = str(reason).lower().replace("_", " ")
        raise TrustError(f"{files.cert} and {files.key} do not go together as certificate and key ({words})") from None
    authority = None
    if files.client_ca is not None:
        authority = _pem(files.client_ca)
        try:
            context.load_verify_locations(files.client_ca)
        except (ssl.SSLError, OSError):
            raise TrustError(f"{files.client_ca}: holds no certificate of an authority in PEM") from None
    return grpc.ssl_server_certificate_configuration([(key, cert)], authority)


def _pem(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES)
    except OSError as error:
        raise TrustError(f"{path}: cannot be read ({error.strerror})") from None
    if b"-----BEGIN " not in data:
        raise TrustError(f"{path}: is no PEM file")
    return data
