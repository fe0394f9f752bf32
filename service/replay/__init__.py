"""Verification of a recorded result against its request."""
