"""Forces of ground and hands: regions of equilibrium, loads, and inverse dynamics."""
