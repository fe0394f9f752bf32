"""The file that says who may come in: names, roles, and the hashes of tokens or the names on certificates."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from service.errors import shown, would_do
from service.trust.errors import TrustError
from service.trust.identity import Identity, Role

MAX_FILE_BYTES = 1_000_000
TOKEN_PREFIX = "scopt_"  # secret scanners find a token by it
_OTHERS = 0o027  # group may read (mounted secrets are so), the rest of the world nothing
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,99}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_KEYS = ("name", "roles", "token_sha256", "certificate")


@dataclass(frozen=True)
class _Entry:
    identity: Identity
    token_sha256: str
    certificate: str


class Tokens:
    """Who may come in, as a YAML file says: a list of ``{name, roles, token_sha256 and/or certificate}``.

    ``certificate`` is the common name of a client certificate. A name may have several entries with the same roles, so
    that a token can be replaced while both are good.

    Raises:
        TrustError: the file cannot be read, others may read it, or what is wrong in it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._entries: tuple[_Entry, ...] = ()
        self.reload()

    def reload(self) -> None:
        """Read the file anew; on an error what was read before stays in force.

        Raises:
            TrustError: as at the beginning.
        """
        self._entries = _read(self.path)

    @property
    def has_tokens(self) -> bool:
        """Whether anybody comes in by a token."""
        return any(entry.token_sha256 for entry in self._entries)

    @property
    def has_certificates(self) -> bool:
        """Whether anybody comes in by a certificate."""
        return any(entry.certificate for entry in self._entries)

    def of_token(self, token: str) -> Identity | None:
        """Whose token this is; takes as long whether or not it is anybody's."""
        digest = token_sha256(token)
        found = None
        for entry in self._entries:
            if hmac.compare_digest(entry.token_sha256, digest):
                found = entry.identity
        return found

    def of_common_name(self, name: str) -> Identity | None:
        """Who has the certificate with this common name."""
        return next(
            (entry.identity for entry in self._entries if entry.certificate and entry.certificate == name), None
        )


def token_sha256(token: str) -> str:
    """What a tokens file keeps of a token."""
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).hexdigest()


def make_token(name: str, roles: Sequence[Role]) -> tuple[str, str]:
    """A new token, and the line of a tokens file that lets it in.

    Raises:
        TrustError: the name cannot be one, or there is no role.
    """
    if not _NAME.fullmatch(name):
        raise TrustError(f"name {shown(name)}: {_NAME_WORDS}")
    if not roles:
        raise TrustError(f"a token needs a role; {', '.join(Role)} would do")
    token = TOKEN_PREFIX + secrets.token_urlsafe(32)
    line = f"- {{name: {name}, roles: [{', '.join(dict.fromkeys(roles))}], token_sha256: {token_sha256(token)}}}"
    return token, line


_NAME_WORDS = "1 to 100 letters, digits, '.', '_', '@' or '-' are needed, the first a letter or a digit"


def _read(path: Path) -> tuple[_Entry, ...]:
    try:
        with path.open("rb") as file:
            stat = os.fstat(file.fileno())
            text = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise TrustError(f"{path}: cannot be read ({error.strerror})") from None
    if stat.st_mode & _OTHERS:
        raise TrustError(f"{path}: others may read or change it (mode {stat.st_mode & 0o777:o}); chmod 600 would do")
    if len(text) > MAX_FILE_BYTES:
        raise TrustError(f"{path}: has more than {MAX_FILE_BYTES} bytes")
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)  # its text would quote the file
        raise TrustError(f"{path}: is no valid YAML" + (f" (line {mark.line + 1})" if mark else "")) from None
    if not isinstance(data, list) or not data:
        raise TrustError(f"{path}: a list of {{name, roles, token_sha256}} is needed; `scopt token` makes its lines")
    problems = [problem for index, entry in enumerate(data) for problem in _problems(entry, f"[{index}]")]
    entries = () if problems else tuple(_entry(entry) for entry in data)
    problems += _contradictions(entries)
    if problems:
        raise TrustError("\n".join(f"{path}: {problem}" for problem in problems[:10]))
    return entries


def _problems(entry: object, where: str) -> Iterator[str]:
    """What is wrong with one entry; hashes are not shown."""
    if not isinstance(entry, Mapping):
        yield f"{where}: a mapping of {', '.join(_KEYS)} is needed"
        return
    for key in entry:
        if key not in _KEYS:
            yield f"{where}: unknown key {shown(key)}; {would_do(key, _KEYS)} would do"
    name, roles = entry.get("name"), entry.get("roles")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        yield f"{where}.name: {_NAME_WORDS}, got {shown(name)}"
    if not isinstance(roles, list) or not roles:
        yield f"{where}.roles: a list of {', '.join(Role)} is needed"
    else:
        for role in roles:
            if role not in list(Role):
                yield f"{where}.roles: unknown role {shown(role)}; {', '.join(Role)} would do"
    token, certificate = entry.get("token_sha256"), entry.get("certificate")
    if token is None and certificate is None:
        yield f"{where}: token_sha256 or certificate is needed"
    if token is not None and not (isinstance(token, str) and _SHA256.fullmatch(token)):
        yield f"{where}.token_sha256: 64 hexadecimal digits are needed; `scopt token` makes them"
    if certificate is not None and not (isinstance(certificate, str) and 0 < len(certificate) <= 200):
        yield f"{where}.certificate: the common name of a client certificate is needed"


def _entry(entry: Mapping[str, Any]) -> _Entry:
    identity = Identity(entry["name"], frozenset(Role(role) for role in entry["roles"]))
    return _Entry(identity, entry.get("token_sha256") or "", entry.get("certificate") or "")


def _contradictions(entries: Sequence[_Entry]) -> list[str]:
    problems = []
    roles: dict[str, frozenset[Role]] = {}
    for entry in entries:
        if roles.setdefault(entry.identity.name, entry.identity.roles) != entry.identity.roles:
            problems.append(f"{entry.identity.name} has entries with different roles; the same roles would do")
    for key in ("token_sha256", "certificate"):
        given = [value for entry in entries if (value := getattr(entry, key))]
        if len(set(given)) < len(given):
            problems.append(f"the same {key} stands in two entries; one would do")
    return problems
