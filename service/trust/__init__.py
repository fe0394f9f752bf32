"""Who may come in, how often, and which files of the server a request may name."""

from __future__ import annotations

from service.trust.access import authenticate, authorize
from service.trust.errors import TrustError
from service.trust.folders import AllowedFolders, allowed_folders
from service.trust.gate import Gate
from service.trust.identity import LOCAL, OPEN_TO_ALL, ROLE_NEEDED, Caller, Identity, Role, current_caller
from service.trust.limits import ClientLimits, Limits, TokenBuckets, peer_key
from service.trust.listen import UNIX, is_loopback, listen_problems
from service.trust.tls import Certificates, TlsFiles
from service.trust.tokens import Tokens, make_token, token_sha256

__all__ = [
    "LOCAL",
    "OPEN_TO_ALL",
    "ROLE_NEEDED",
    "UNIX",
    "AllowedFolders",
    "Caller",
    "Certificates",
    "ClientLimits",
    "Gate",
    "Identity",
    "Limits",
    "Role",
    "TlsFiles",
    "TokenBuckets",
    "Tokens",
    "TrustError",
    "allowed_folders",
    "authenticate",
    "authorize",
    "current_caller",
    "is_loopback",
    "listen_problems",
    "make_token",
    "peer_key",
    "token_sha256",
]
