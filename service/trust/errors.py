"""Errors of what decides who may come in."""

from __future__ import annotations

from service.errors import ServiceError


class TrustError(ServiceError):
    """A file of tokens or certificates that cannot be used."""
