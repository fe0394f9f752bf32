"""Preparation of a request for planning: robot at its start, obstacles, and pieces of the scan."""
