"""Detectors of the objects that tasks need; ``registry`` lists them."""

from perception.detect.registry import KINDS, detect, detect_at, detect_each, detect_kinds, find_offered

__all__ = ["KINDS", "detect", "detect_at", "detect_each", "detect_kinds", "find_offered"]
