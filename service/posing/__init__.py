"""Poses that are led by hand: each event gives a pose that the verifier has checked, and what stops it."""
