"""Access to a server: identities, roles, limits of each client, TLS, and the files that requests may name."""

from __future__ import annotations

from service.trust.access import AccessInterceptor, authenticate, authorize
from service.trust.errors import TrustError
from service.trust.folders import BUILT, UPLOADED, AllowedFolders, resolve_folders
from service.trust.identity import LOCAL, OPEN_TO_ALL, ROLE_NEEDED, Caller, Identity, Role, current_caller
from service.trust.limits import ClientLimiter, ClientLimits, TokenBuckets, peer_key
from service.trust.listen import UNIX, find_listen_problems, find_socket_problems, is_loopback
from service.trust.tls import Certificates, TlsFiles
from service.trust.tokens import Tokens, hash_token, make_token

__all__ = [
    "BUILT",
    "LOCAL",
    "OPEN_TO_ALL",
    "ROLE_NEEDED",
    "UNIX",
    "UPLOADED",
    "AccessInterceptor",
    "AllowedFolders",
    "Caller",
    "Certificates",
    "ClientLimiter",
    "ClientLimits",
    "Identity",
    "Role",
    "TlsFiles",
    "TokenBuckets",
    "Tokens",
    "TrustError",
    "authenticate",
    "authorize",
    "current_caller",
    "find_listen_problems",
    "find_socket_problems",
    "hash_token",
    "is_loopback",
    "make_token",
    "peer_key",
    "resolve_folders",
]
