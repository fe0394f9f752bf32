"""Swept collision checking of a robot with the world and with itself."""

from costs.collision.checker import SweptCollisionChecker
from costs.collision.contacts import Contacts
from costs.collision.pairs import PairMargins
from costs.collision.poses import PoseChecker

__all__ = ["Contacts", "PairMargins", "PoseChecker", "SweptCollisionChecker"]
