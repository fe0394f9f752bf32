"""Convex pieces that cover the points of a scan and contain no space that rays passed through."""
