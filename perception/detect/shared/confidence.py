"""How evidence becomes a confidence: products of shares that rise from nothing to certainty."""

from __future__ import annotations

import numpy as np


def rising(value: float, low: float, high: float) -> float:
    """0 up to ``low``, 1 from ``high`` on, smooth between."""
    x = float(np.clip((value - low) / (high - low), 0.0, 1.0))
    return x * x * (3.0 - 2.0 * x)
