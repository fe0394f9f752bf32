"""Swept collision checking of a robot with the world and with itself."""

from costs.collision.checker import SweptCollisionChecker
from costs.collision.contacts import Contacts
from costs.collision.many_poses import MOST_PAIRS, ManyPosesChecker, count_checked
from costs.collision.pairs import PairMargins
from costs.collision.poses import PoseChecker

__all__ = [
    "MOST_PAIRS",
    "Contacts",
    "ManyPosesChecker",
    "PairMargins",
    "PoseChecker",
    "SweptCollisionChecker",
    "count_checked",
]
