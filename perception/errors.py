"""The errors this package raises for input it refuses."""

from __future__ import annotations


class PerceptionError(ValueError):
    """Base of all errors of this package."""


class CloudError(PerceptionError):
    """A cloud or cloud file that cannot be used; the one-line message names it, the fault and what is expected."""


class MeshError(PerceptionError):
    """A mesh or mesh file that cannot be used; the one-line message names it, the fault and what is expected."""
