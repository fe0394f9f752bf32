"""Results to look at: one HTML file, a GLB, and OpenRAVE's environment and trajectory."""

from service.viewer.glb import write_glb
from service.viewer.html import write_viewer
from service.viewer.openrave import write_openrave
from service.viewer.placements import LinkPlacements, placements_of

__all__ = ["LinkPlacements", "placements_of", "write_glb", "write_openrave", "write_viewer"]
