"""The viewer file: one HTML page that holds program, style and data, and asks the network for nothing."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.viewer.files import replace_file
from service.viewer.payload import json_safe, make_payload
from service.viewer.placements import LinkPlacements

DIST = Path(__file__).parent / "page" / "dist"
"""What ``npm run build`` made of the sources in ``page/src``."""


def write_viewer(result: Mapping[str, Any], placements: LinkPlacements, path: Path) -> None:
    """Write a self-contained viewer of a result.

    Args:
        result: a parsed ``result.json`` (docs/result-format.md).
        placements: where the links of ``result["bodies"]`` are at each sample of the trajectory.
        path: file to write; it is replaced in one step.

    Raises:
        ValueError: see ``make_payload``.
    """
    replace_file(path, render_viewer(make_payload(result, placements)).encode("utf-8"))


def render_viewer(payload: Mapping[str, Any]) -> str:
    """The page around the payload of a result."""
    title = " · ".join(str(part) for part in (payload["robot"], payload["task"], payload["verdict"]) if part)
    return render_page(payload, title, "viewer")


def render_page(payload: Mapping[str, Any], title: str, program: str) -> str:
    """One of the programs in ``DIST``, with its data.

    The policy names program and style by hash and allows nothing else, so that a hostile name in the data cannot run.
    """
    script, style = (DIST / f"{program}.js").read_text("utf-8"), (DIST / "viewer.css").read_text("utf-8")
    # "<" is the one character that could end the data's script element early.
    data = json.dumps(json_safe(payload), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    policy = (
        f"default-src 'none'; script-src '{_source_hash(script)}'; style-src '{_source_hash(style)}'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{html.escape(title)}</title>\n<link rel="icon" href="data:,">\n'
        f"<style>{style}</style>\n</head>\n<body>\n"
        f'<script type="application/json" id="payload">{data}</script>\n'
        f"<script>{script}</script>\n</body>\n</html>\n"
    )


def _source_hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
