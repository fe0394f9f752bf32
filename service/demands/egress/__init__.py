"""Demands of getting out of a vehicle."""
