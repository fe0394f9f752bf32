"""The gate that every RPC comes through: who is it, may they, and not too often."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager

from service.trust.access import authenticate, authorize
from service.trust.identity import _CALLER, LOCAL, OPEN_TO_ALL, Caller
from service.trust.limits import Limits, peer_key
from service.trust.rpc import Context, Interceptor, Refusal, refuse
from service.trust.tokens import Tokens


class Gate(Interceptor):
    """Refuses what may not come in before its request is read; who came in is ``current_caller``.

    A refused identity counts as a request of its peer's address, so that tokens cannot be tried at leisure.

    Args:
        tokens: who is known; None: everybody is ``LOCAL``, for a server that only this machine can reach.
        limits: of how often.
        asks_for_certificates: whether the server asks its peers for theirs.
    """

    def __init__(self, tokens: Tokens | None, limits: Limits, asks_for_certificates: bool = False) -> None:
        self._tokens = tokens
        self._limits = limits
        self._asks_for_certificates = asks_for_certificates

    @asynccontextmanager
    async def wrap_call(self, method: str, context: Context) -> AsyncIterator[None]:
        try:
            caller = self._caller(method, context)
        except Refusal as refusal:
            await refuse(context, refusal)
        try:
            yield
        finally:
            self._limits.leave(caller.key)

    def _caller(self, method: str, context: Context) -> Caller:
        """Raises: Refusal: this call may not come in."""
        peer = peer_key(context.peer())
        caller = Caller(None, peer) if method in OPEN_TO_ALL else self._known(context, peer)
        _CALLER.set(caller)  # for this call alone: gRPC answers each in a task of its own
        self._unless(self._limits.request(caller.key))
        if caller.identity is not None:
            authorize(method, caller.identity)
        self._unless(self._limits.enter(caller.key))
        return caller

    def _known(self, context: Context, peer: str) -> Caller:
        metadata: Iterable[tuple[str, str | bytes]] = context.invocation_metadata() or ()
        try:
            names = context.auth_context().get("x509_common_name", ())
            identity = authenticate(metadata, names, self._tokens, self._asks_for_certificates)
        except Refusal:
            self._unless(self._limits.request(peer))
            raise
        # Those who need not say who they are share a name, but not its limits.
        return Caller(identity, peer if identity is LOCAL else identity.name)

    def _unless(self, refusal: Refusal | None) -> None:
        if refusal is not None:
            raise refusal
