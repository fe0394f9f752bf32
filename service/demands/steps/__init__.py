"""Demands of a list of steps."""
