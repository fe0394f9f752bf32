"""A detector and its needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from perception.detect.shared.detection import Detection


@dataclass(frozen=True)
class Detector:
    """Detector of one kind and its needs.

    Attributes:
        find: function of view and hint, and with ``needs_faces`` of the view's flat faces or with ``needs_index`` of
            the index of its rays; returns detections.
        needs_faces: whether it uses the flat faces, which are found once for all such detectors.
        needs_index: whether it uses the index of the view's rays, made once for all such detectors.
        offered_as: of a kind for tasks only, the kind that a request names instead; None for those that it may name.
    """

    find: Callable[..., list[Detection]]
    needs_faces: bool = False
    needs_index: bool = False
    offered_as: str | None = None
