"""Targets: errors of poses against what they should be, and the checks made of them."""
