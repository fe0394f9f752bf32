"""Convex pieces that cover the points of a scan and leave free what was seen free."""
