"""Viewer files of a result: an HTML page, a GLB, and OpenRAVE's environment and trajectory."""

from service.viewer.glb import write_glb
from service.viewer.hand_contacts import trace_hand_contacts
from service.viewer.html import write_viewer
from service.viewer.objects import add_objects
from service.viewer.openrave import write_openrave
from service.viewer.placements import LinkPlacements, list_drawn_frames, place_links
from service.viewer.pose_graph import make_pose_graph, place_poses

__all__ = [
    "LinkPlacements",
    "add_objects",
    "list_drawn_frames",
    "make_pose_graph",
    "place_links",
    "place_poses",
    "trace_hand_contacts",
    "write_glb",
    "write_openrave",
    "write_viewer",
]
