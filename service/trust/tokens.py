"""The file of known clients: names, roles, and the hash of a token or the name on a certificate."""

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
TOKEN_PREFIX = "scopt_"  # lets secret scanners recognise a token
_FORBIDDEN_MODE = 0o027  # the group may read, as for mounted secrets
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,99}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_KEYS = ("name", "roles", "token_sha256", "certificate")


@dataclass(frozen=True)
class _Entry:
    identity: Identity
    token_sha256: str
    certificate: str


class Tokens:
    """Known clients of a YAML file: a list of ``{name, roles, token_sha256 and/or certificate}``.

    ``certificate`` is the common name of a client certificate. A name may have several entries with the same roles, so
    that the old and the new token are valid while one replaces the other.

    Raises:
        TrustError: the file cannot be read, others may read it, or an entry is wrong.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._entries: tuple[_Entry, ...] = ()
        self.reload()

    def reload(self) -> None:
        """Read the file again.

        Raises:
            TrustError: as in the constructor; the previous entries stay valid.
        """
        self._entries = _read(self.path)

    @property
    def has_tokens(self) -> bool:
        """Whether an entry has a token."""
        return any(entry.token_sha256 for entry in self._entries)

    @property
    def has_certificates(self) -> bool:
        """Whether an entry has a certificate."""
        return any(entry.certificate for entry in self._entries)

    def find_token(self, token: str) -> Identity | None:
        """Return the identity of a token; takes as long for an unknown token."""
        digest = hash_token(token)
        identity = None
        for entry in self._entries:
            if hmac.compare_digest(entry.token_sha256, digest):
                identity = entry.identity
        return identity

    def find_common_name(self, name: str) -> Identity | None:
        """Return the identity of a certificate's common name."""
        return next(
            (entry.identity for entry in self._entries if entry.certificate and entry.certificate == name), None
        )


def hash_token(token: str) -> str:
    """Return ``token_sha256`` of a tokens file."""
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).hexdigest()


def make_token(name: str, roles: Sequence[Role]) -> tuple[str, str]:
    """Return a new token and its line of a tokens file.

    Raises:
        TrustError: the name is invalid, or there is no role.
    """
    if not _NAME.fullmatch(name):
        raise TrustError(f"name: {_EXPECTED_NAME}, got {shown(name)}")
    if not roles:
        raise TrustError(f"roles: expected at least one of {', '.join(Role)}")
    token = TOKEN_PREFIX + secrets.token_urlsafe(32)
    line = f"- {{name: {name}, roles: [{', '.join(dict.fromkeys(roles))}], token_sha256: {hash_token(token)}}}"
    return token, line


_EXPECTED_NAME = "expected 1 to 100 letters, digits, '.', '_', '@' or '-', the first a letter or a digit"


def _read(path: Path) -> tuple[_Entry, ...]:
    try:
        with path.open("rb") as file:
            stat = os.fstat(file.fileno())
            text = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise TrustError(f"{path}: cannot be read ({error.strerror})") from None
    if stat.st_mode & _FORBIDDEN_MODE:
        raise TrustError(f"{path}: others may read or change it (mode {stat.st_mode & 0o777:o}); run chmod 600")
    if len(text) > MAX_FILE_BYTES:
        raise TrustError(f"{path}: has more than {MAX_FILE_BYTES} bytes")
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)  # the error's text would quote the file
        raise TrustError(f"{path}: is no valid YAML" + (f" (line {mark.line + 1})" if mark else "")) from None
    if not isinstance(data, list) or not data:
        raise TrustError(f"{path}: expected a list of {{name, roles, token_sha256}}; `scopt token` makes its lines")
    problems = [problem for index, entry in enumerate(data) for problem in _find_problems(entry, f"[{index}]")]
    entries = () if problems else tuple(_make_entry(entry) for entry in data)
    problems += _find_contradictions(entries)
    if problems:
        raise TrustError("\n".join(f"{path}: {problem}" for problem in problems[:10]))
    return entries


def _find_problems(entry: object, path: str) -> Iterator[str]:
    """Yield the problems of one entry; hashes are not shown."""
    if not isinstance(entry, Mapping):
        yield f"{path}: expected a mapping of {', '.join(_KEYS)}"
        return
    for key in entry:
        if key not in _KEYS:
            yield f"{path}: unknown key {shown(key)}; expected {would_do(key, _KEYS)}"
    name, roles = entry.get("name"), entry.get("roles")
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        yield f"{path}.name: {_EXPECTED_NAME}, got {shown(name)}"
    if not isinstance(roles, list) or not roles:
        yield f"{path}.roles: expected a list of {', '.join(Role)}"
    else:
        for role in roles:
            if role not in list(Role):
                yield f"{path}.roles: unknown role {shown(role)}; expected {', '.join(Role)}"
    token, certificate = entry.get("token_sha256"), entry.get("certificate")
    if token is None and certificate is None:
        yield f"{path}: expected token_sha256 or certificate"
    if token is not None and not (isinstance(token, str) and _SHA256.fullmatch(token)):
        yield f"{path}.token_sha256: expected 64 hexadecimal digits; `scopt token` makes them"
    if certificate is not None and not (isinstance(certificate, str) and 0 < len(certificate) <= 200):
        yield f"{path}.certificate: expected the common name of a client certificate"


def _make_entry(entry: Mapping[str, Any]) -> _Entry:
    identity = Identity(entry["name"], frozenset(Role(role) for role in entry["roles"]))
    return _Entry(identity, entry.get("token_sha256") or "", entry.get("certificate") or "")


def _find_contradictions(entries: Sequence[_Entry]) -> list[str]:
    problems = []
    roles: dict[str, frozenset[Role]] = {}
    for entry in entries:
        if roles.setdefault(entry.identity.name, entry.identity.roles) != entry.identity.roles:
            problems.append(f"{entry.identity.name}: its entries have different roles; expected the same")
    for key in ("token_sha256", "certificate"):
        given = [value for entry in entries if (value := getattr(entry, key))]
        if len(set(given)) < len(given):
            problems.append(f"{key}: two entries have the same; expected one")
    return problems
