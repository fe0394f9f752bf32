"""Parts that detectors of several kinds use: detections, bars fitted to rays, flat faces, slender things."""
