"""Checks of what sensors and servos say: readings, servos, pelvis, and what reaches a driver."""
