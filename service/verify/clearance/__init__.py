"""Clearance of all pairs: pairs, broad phase, poses, search, and the checks made of it, in this order of imports."""
