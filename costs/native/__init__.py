"""The compiled kernel: distances of many convex hulls in one call, and the library that other folders call."""

from costs.native.hulls import APART, BEYOND, TOUCHING, HullSet
from costs.native.library import bind, call, describe_missing, find_library, without_library

__all__ = [
    "APART",
    "BEYOND",
    "TOUCHING",
    "HullSet",
    "bind",
    "call",
    "describe_missing",
    "find_library",
    "without_library",
]
