"""Errors for stances that contact forces hold nowhere, or not on an area."""

from __future__ import annotations


class StaticRegionError(ValueError):
    """Error for a stance without a region.

    Attributes:
        wrench: index of the given wrench, None where it takes several wrenches to leave no region.
    """

    def __init__(self, message: str, wrench: int | None) -> None:
        super().__init__(message)
        self.wrench = wrench


class NothingHoldsError(StaticRegionError):
    """Error for wrenches under which no place of the centre of mass was found to be in equilibrium.

    It is no proof of impossibility: forces were sought in pyramids inside the friction cones.
    """


class DegenerateRegionError(StaticRegionError):
    """Error for a region that is a line or a point, as that of two contact points: no motion keeps a margin in it."""
