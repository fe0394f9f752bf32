"""Closed meshes: read, checked, split by CoACD into convex parts, and located in a scan; scans split alike."""
