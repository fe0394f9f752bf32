"""Who is it, and may they: from what came with a call to an identity, or to the reason why not."""

from __future__ import annotations

from collections.abc import Iterable

import grpc

from service.trust.identity import LOCAL, ROLE_NEEDED, Identity
from service.trust.rpc import Refusal
from service.trust.tokens import Tokens

_SCHEME = "bearer"


def authenticate(
    metadata: Iterable[tuple[str, str | bytes]],
    common_names: Iterable[bytes],
    tokens: Tokens | None,
    asks_for_certificates: bool = False,
) -> Identity:
    """Who makes a call.

    Args:
        metadata: of the call; ``authorization: Bearer TOKEN`` counts, and comes before a certificate.
        common_names: on the certificate of the peer, which TLS has verified; none without one.
        tokens: who is known; None: nobody has to say who they are.
        asks_for_certificates: whether the server asks its peers for theirs; it sees none otherwise.

    Raises:
        Refusal: UNAUTHENTICATED, with a text that never repeats what was sent as a token.
    """
    if tokens is None:
        return LOCAL
    headers = [value for key, value in metadata if key == "authorization"]
    if headers:
        scheme, _, token = str(headers[0]).partition(" ")
        if len(headers) > 1 or scheme.lower() != _SCHEME or not token.strip():
            raise _unknown("authorization is not understood; one 'authorization: Bearer TOKEN' would do")
        identity = tokens.of_token(token.strip())
        if identity is None:
            raise _unknown("the token is not known to this server, or not any more")
        return identity
    names = [name.decode("utf-8", "replace") for name in common_names]
    if not names:
        by_certificate = asks_for_certificates and tokens.has_certificates
        ways = ["metadata 'authorization: Bearer TOKEN'"] if tokens.has_tokens or not by_certificate else []
        ways += ["a client certificate with a common name"] if by_certificate else []
        raise _unknown(f"who calls is not said; {' or '.join(ways)} would do")
    identity = tokens.of_common_name(names[0]) if len(names) == 1 else None
    if identity is None:
        raise _unknown("the client certificate's common name is not known to this server")
    return identity


def authorize(method: str, identity: Identity) -> None:
    """Whether an identity may call a method.

    Raises:
        Refusal: PERMISSION_DENIED, naming the role that is missing.
    """
    if method not in ROLE_NEEDED:
        raise Refusal(grpc.StatusCode.PERMISSION_DENIED, "nobody may call this method")
    needed = ROLE_NEEDED[method]
    if identity.roles.isdisjoint(needed):
        has = ", ".join(sorted(identity.roles))
        words = f"{method.rpartition('/')[2]} needs the role {' or '.join(needed)}; {identity.name} has {has}"
        raise Refusal(grpc.StatusCode.PERMISSION_DENIED, words)


def _unknown(words: str) -> Refusal:
    return Refusal(grpc.StatusCode.UNAUTHENTICATED, words)
