"""Clouds and scene files: from a scan to a scene that can be saved, updated and planned in."""
