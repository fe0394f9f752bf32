"""Settings of a console, and the version that its pages must have."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from service.cli.console.cameras import CameraSource
from service.viewer.html import DIST

PROGRAM = "console"


@dataclass(frozen=True)
class ConsoleSettings:
    """Settings of a console.

    Attributes:
        target: the planning server, ``HOST:PORT`` or ``unix:PATH``.
        tls_ca, tls_cert, tls_key: TLS files for the connection to it, as for any client.
        scans: folders whose cloud files the page offers.
        cameras: whose pictures stand beside the view.
    """

    target: str
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    scans: tuple[Path, ...] = (Path(),)
    cameras: tuple[CameraSource, ...] = ()


@cache
def page_version() -> str:
    """Return the version of the page: a hash of its program and its styles."""
    digest = hashlib.sha256()
    for name in (f"{PROGRAM}.js", f"{PROGRAM}.css", "viewer.css"):
        digest.update((DIST / name).read_bytes())
    return digest.hexdigest()[:16]
