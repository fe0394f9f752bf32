"""Meshes: reading, checks, convex decomposition by CoACD (also of scans), and pose search in a scan."""
