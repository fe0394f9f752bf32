"""Measurements of perception: pieces and detections on recorded and simulated scans."""
