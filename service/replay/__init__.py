"""Verification of recorded results against their requests, and of trajectories of other planners (``exchange``)."""
