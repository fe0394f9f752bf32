"""Floor of a scan: its levels, their extents, and their convex pieces."""
