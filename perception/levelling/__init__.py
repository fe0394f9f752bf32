"""Levelling: which way is up in a cloud, and the transform that makes its floor z = 0."""
