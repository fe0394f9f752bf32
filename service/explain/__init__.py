"""Reasons why no motion is found: global ones, and locally conflicting constraints."""
