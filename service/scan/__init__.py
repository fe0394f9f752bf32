"""Conversion of clouds into scenes, and scene files that can be saved, updated and planned in."""
