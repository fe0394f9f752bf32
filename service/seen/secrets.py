"""Secrets in a text, taken out before anybody can read it."""

from __future__ import annotations

import re

_PUT_FOR_IT = "[secret]"
_SECRETS = (
    re.compile(r"scopt_[A-Za-z0-9_-]{20,}"),
    re.compile(r"(?i)(?<=\bbearer )[^\s\"'\\,)\]}]+"),
    re.compile(r"(?i)(?<=\bbasic )[A-Za-z0-9+/=]{6,}"),
    re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(-----END [A-Z ]*PRIVATE KEY-----|\Z)", re.DOTALL),
)


def without_secrets(text: str) -> str:
    """The text with every token and private key in it replaced, also in the middle of JSON or of a traceback."""
    for secret in _SECRETS:
        text = secret.sub(_PUT_FOR_IT, text)
    return text
