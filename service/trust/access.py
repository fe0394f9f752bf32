"""Access control of every RPC: the caller's identity, its role, and its limits."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

import grpc

from service.trust.identity import LOCAL, OPEN_TO_ALL, ROLE_NEEDED, Caller, Identity, set_caller
from service.trust.limits import ClientLimiter, peer_key
from service.trust.rpc import Context, Interceptor, Refusal, refuse
from service.trust.tokens import Tokens

_SCHEME = "bearer"


class AccessInterceptor(Interceptor):
    """Refuses calls before their request is read; the accepted caller is ``current_caller``.

    A call with a refused identity counts as a request of its peer's address, which slows the guessing of tokens.

    Args:
        tokens: known clients; None accepts everybody as ``LOCAL``, for a server that only this machine can reach.
        limiter: limits of each client.
        uses_certificates: whether the server asks its peers for certificates.
    """

    def __init__(self, tokens: Tokens | None, limiter: ClientLimiter, uses_certificates: bool = False) -> None:
        self._tokens = tokens
        self._limiter = limiter
        self._uses_certificates = uses_certificates

    @asynccontextmanager
    async def wrap_call(self, method: str, context: Context) -> AsyncIterator[None]:
        try:
            caller = self._accept(method, context)
        except Refusal as refusal:
            await refuse(context, refusal)
        try:
            yield
        finally:
            self._limiter.leave(caller.key)

    def _accept(self, method: str, context: Context) -> Caller:
        """Return the caller of an accepted call.

        Raises:
            Refusal: the call is not accepted.
        """
        peer = peer_key(context.peer())
        caller = Caller(None, peer, context.peer()) if method in OPEN_TO_ALL else self._identify(context, peer)
        set_caller(caller)  # for this call alone, since gRPC answers each call in a task of its own
        _raise_if(self._limiter.request(caller.key))
        if caller.identity is not None:
            authorize(method, caller.identity)
        _raise_if(self._limiter.enter(caller.key))
        return caller

    def _identify(self, context: Context, peer: str) -> Caller:
        metadata: Iterable[tuple[str, str | bytes]] = context.invocation_metadata() or ()
        try:
            names = context.auth_context().get("x509_common_name", ())
            identity = authenticate(metadata, names, self._tokens, self._uses_certificates)
        except Refusal:
            _raise_if(self._limiter.request(peer))
            raise
        # Anonymous callers share the name LOCAL, but not its limits.
        return Caller(identity, peer if identity is LOCAL else identity.name, context.peer())


def authenticate(
    metadata: Iterable[tuple[str, str | bytes]],
    common_names: Iterable[bytes],
    tokens: Tokens | None,
    uses_certificates: bool = False,
) -> Identity:
    """Return the identity of a caller.

    Args:
        metadata: metadata of the call; ``authorization: Bearer TOKEN`` takes precedence over a certificate.
        common_names: names on the peer's certificate, which TLS has verified; empty without one.
        tokens: known clients; None accepts everybody.
        uses_certificates: whether the server asks its peers for certificates.

    Raises:
        Refusal: UNAUTHENTICATED, with a text that never repeats a token.
    """
    if tokens is None:
        return LOCAL
    headers = [value for key, value in metadata if key == "authorization"]
    if headers:
        scheme, _, token = str(headers[0]).partition(" ")
        if len(headers) > 1 or scheme.lower() != _SCHEME or not token.strip():
            raise _refuse_identity("authorization: expected one 'authorization: Bearer TOKEN'")
        identity = tokens.find_token(token.strip())
        if identity is None:
            raise _refuse_identity("authorization: the token is unknown to this server, or no longer valid")
        return identity
    names = [name.decode("utf-8", "replace") for name in common_names]
    if not names:
        by_certificate = uses_certificates and tokens.has_certificates
        ways = ["metadata 'authorization: Bearer TOKEN'"] if tokens.has_tokens or not by_certificate else []
        ways += ["a client certificate with a common name"] if by_certificate else []
        raise _refuse_identity(f"the caller is not identified; expected {' or '.join(ways)}")
    identity = tokens.find_common_name(names[0]) if len(names) == 1 else None
    if identity is None:
        raise _refuse_identity("the client certificate's common name is unknown to this server")
    return identity


def authorize(method: str, identity: Identity) -> None:
    """Check that an identity may call a method.

    Raises:
        Refusal: PERMISSION_DENIED, naming the missing role.
    """
    if method not in ROLE_NEEDED:
        raise Refusal(grpc.StatusCode.PERMISSION_DENIED, "nobody may call this method")
    needed = ROLE_NEEDED[method]
    if identity.roles.isdisjoint(needed):
        roles = ", ".join(sorted(identity.roles))
        text = f"{method.rpartition('/')[2]} needs the role {' or '.join(needed)}; {identity.name} has {roles}"
        raise Refusal(grpc.StatusCode.PERMISSION_DENIED, text)


def _raise_if(refusal: Refusal | None) -> None:
    if refusal is not None:
        raise refusal


def _refuse_identity(text: str) -> Refusal:
    return Refusal(grpc.StatusCode.UNAUTHENTICATED, text)
