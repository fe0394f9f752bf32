"""Demands of opening a door."""
