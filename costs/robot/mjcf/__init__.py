"""Robots given as models of MuJoCo (MJCF), read by MuJoCo itself and rewritten as URDF."""
