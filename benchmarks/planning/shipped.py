"""The bundled example requests."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "requests"


def shipped_requests() -> list[Path]:
    """Return the bundled requests."""
    return sorted(FOLDER.glob("*.yaml"))
