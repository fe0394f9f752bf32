"""Modules shared by several detectors: detections, bars fitted to rays, flat faces, slender clusters."""
