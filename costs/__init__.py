"""Robots, kinematics, scenes, curves, and the terms measured on them."""
