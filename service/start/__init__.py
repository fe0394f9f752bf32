"""Start of the robot: configuration, carried bodies, overlaps, and ground below its soles."""
