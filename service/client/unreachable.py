"""What it means that a server could not be reached, said of what a user can mend rather than of sockets."""

from __future__ import annotations

from service.client.connection import Connection

# How gRPC begins what it says itself of a connection that never was, and of one that went.
_NEVER = ("failed to connect to all addresses", "errors resolving", "DNS resolution failed")
_WENT = (
    "Socket closed",
    "recvmsg:",
    "sendmsg:",
    "Stream removed",
    "Connection reset",
    "Broken pipe",
    "keepalive watchdog",
)
_HUNG_UP = ("Socket closed", "Connection reset", "Broken pipe", "Stream removed")
_NO_GRPC = ("Failed parsing HTTP/2", "http1.x", "SETTINGS frame", "Handshake read failed")


def explained(text: str, connection: Connection) -> str:
    """The sentence for gRPC's own text of an unreachable server; that of a server is left as it is."""
    target = connection.target
    if text.startswith(_WENT):
        return f"the connection to {target} broke off"
    if not text.startswith(_NEVER):
        return text
    if "resolv" in text.lower():
        return f"target: no address is known for {target}; is the name right?"
    if "CERTIFICATE_VERIFY_FAILED" in text:
        known = "the authority in tls_ca (--tls-ca)" if connection.tls_ca is not None else "any that is known here"
        return f"the server's certificate at {target} does not come from {known}; give the one that it comes from"
    if "Hostname Verification" in text:
        return f"the server's certificate is not for {target}; ask for the server by a name that the certificate has"
    if "WRONG_VERSION_NUMBER" in text:
        return f"what listens at {target} speaks no TLS; leave out tls_ca (--tls-ca), or is it the wrong port?"
    if any(words in text for words in _NO_GRPC):
        return f"what listens at {target} is no planning service; is it the right port?"
    if any(words in text for words in _HUNG_UP):
        return f"the server at {target} hangs up; {_wanted(connection)}"
    return f"nothing answers at {target}; is `scopt serve` running there?"


def _wanted(connection: Connection) -> str:
    if not connection.is_secure:
        return "it may speak TLS: give tls_ca (--tls-ca)"
    if connection.tls_cert is None:
        return "it may want a certificate of this client: give tls_cert and tls_key (--tls-cert, --tls-key)"
    return "it may not know the authority that tls_cert (--tls-cert) comes from"
