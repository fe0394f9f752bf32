"""Objects that hands take: their shape and mass, grippers, and grasps."""
