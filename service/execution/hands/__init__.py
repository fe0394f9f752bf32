"""Hands that press on a mechanism: how hard they may, and how they give way."""
