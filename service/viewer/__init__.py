"""Results to look at: one HTML file, a GLB, and OpenRAVE's environment and trajectory."""

from service.viewer.glb import write_glb
from service.viewer.html import write_viewer
from service.viewer.openrave import write_openrave
from service.viewer.placements import LinkPlacements, drawn_frames, placements_of

__all__ = ["LinkPlacements", "drawn_frames", "placements_of", "write_glb", "write_openrave", "write_viewer"]
