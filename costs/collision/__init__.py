"""Swept collision checking of a robot with the world and with itself."""

from costs.collision.checker import SweptCollisionChecker
from costs.collision.compiled_poses import CompiledPosesChecker
from costs.collision.contacts import Contacts
from costs.collision.many_poses import ManyPosesChecker, SearchChecker, count_checked, make_search_checker
from costs.collision.pairs import PairMargins
from costs.collision.poses import PoseChecker

__all__ = [
    "CompiledPosesChecker",
    "Contacts",
    "ManyPosesChecker",
    "PairMargins",
    "PoseChecker",
    "SearchChecker",
    "SweptCollisionChecker",
    "count_checked",
    "make_search_checker",
]
