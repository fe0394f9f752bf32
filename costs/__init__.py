"""The world a motion is measured on: robots, kinematics, scenes, curves and the terms."""
