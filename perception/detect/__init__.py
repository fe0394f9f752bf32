"""Detectors of the objects that tasks need; ``registry`` lists them, and is imported with its first use."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from perception.detect.registry import KINDS, detect_at, detect_each, detect_kinds, find_offered
    from perception.detect.shared.detection import Detection
    from perception.view import View

__all__ = ["KINDS", "detect", "detect_at", "detect_each", "detect_kinds", "find_offered"]


def detect(kind: str, view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[Detection]:
    """Find objects of a kind, best first.

    Args:
        kind: one of ``KINDS``, or another detector's name.
        view: the scan.
        hint: (3,) a point near the object, as an operator would click it [m].

    Raises:
        PerceptionError: the kind is unknown.
    """
    from perception.detect.registry import detect_kinds

    return detect_kinds((kind,), view, hint)


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module("perception.detect.registry"), name)
    raise AttributeError(f"module 'perception.detect' has no attribute {name!r}")
