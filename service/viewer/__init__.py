"""Viewer files of a result: an HTML page, a GLB, and OpenRAVE's environment and trajectory."""

from service.viewer.glb import write_glb
from service.viewer.html import write_viewer
from service.viewer.openrave import write_openrave
from service.viewer.placements import LinkPlacements, list_drawn_frames, place_links

__all__ = ["LinkPlacements", "list_drawn_frames", "place_links", "write_glb", "write_openrave", "write_viewer"]
