"""The robot at its start: configuration, carried bodies, overlaps, and the ground below its soles."""
