"""Results to look at: one HTML file, a GLB, and OpenRAVE's environment and trajectory."""

from service.viewer.html import write_viewer
from service.viewer.placements import LinkPlacements, placements_of

__all__ = ["LinkPlacements", "placements_of", "write_viewer"]
