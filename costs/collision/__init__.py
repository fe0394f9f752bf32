"""Swept collision checking of a robot with the world and with itself."""

from costs.collision.checker import SweptCollisionChecker
from costs.collision.contacts import Contacts
from costs.collision.pairs import PairMargins

__all__ = ["Contacts", "PairMargins", "SweptCollisionChecker"]
