"""A scan as a page: points coloured by piece, pieces, detections with their residuals, free space in slices."""

from service.scene_view.payload import payload_of, render_scene

__all__ = ["payload_of", "render_scene"]
