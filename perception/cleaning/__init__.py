"""Point cloud preparation: crop, removal of strays and mixed pixels, warnings about unit and frame."""
