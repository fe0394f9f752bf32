"""Detection of cordless drills."""
