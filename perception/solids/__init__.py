"""Closed meshes: read, checked, split by CoACD into convex parts, and found in a scan; clouds made into such meshes."""
