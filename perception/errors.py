"""The errors this package raises for input it refuses."""

from __future__ import annotations


class PerceptionError(ValueError):
    """Base of all errors of this package."""


class CloudError(PerceptionError):
    """A cloud or cloud file that cannot be used; one line: what, what is wrong with it, what would do."""


class MeshError(PerceptionError):
    """A mesh or mesh file that cannot be used; one line: what, what is wrong with it, what would do."""
