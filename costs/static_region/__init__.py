"""Places of the centre of mass at which contact forces hold the robot still, with the forces that prove it.

Bretl and Lall, Testing static equilibrium for legged robots, T-RO 2008: for contacts fixed in the world these places
are a convex polygon in (x, y), whatever the height. Cones of friction and balances of forces are convex: a centre of
mass inside the polygon is held by the same combination of forces (witnesses) as it is of the vertices. No solver is
needed to check a region (``service.verify.forces.equilibrium``).
"""

from costs.static_region.errors import DegenerateRegionError, NothingHoldsError, StaticRegionError
from costs.static_region.region import StaticRegion, find_static_region

__all__ = [
    "DegenerateRegionError",
    "NothingHoldsError",
    "StaticRegion",
    "StaticRegionError",
    "find_static_region",
]
