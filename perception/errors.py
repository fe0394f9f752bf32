"""Errors that this package raises for input it refuses."""

from __future__ import annotations


class PerceptionError(ValueError):
    """Base of all errors of this package."""


class CloudError(PerceptionError):
    """Unusable cloud or cloud file; the one-line message names the file, the fault and what is expected."""


class MeshError(PerceptionError):
    """Unusable mesh or mesh file; the one-line message names the file, the fault and what is expected."""
