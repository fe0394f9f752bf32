"""The compiled kernel: distances of many convex hulls in one call, and the library that other folders call."""

from costs.native.hulls import APART, BEYOND, TOUCHING, HullSet, share_swept_gradient
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
    "share_swept_gradient",
    "without_library",
]
