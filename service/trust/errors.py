"""Errors of access control."""

from __future__ import annotations

from service.errors import ServiceError


class TrustError(ServiceError):
    """A file, folder or address of access control that cannot be used."""
