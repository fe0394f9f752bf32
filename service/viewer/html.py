"""Viewer files: one HTML page with program, style and data, which works offline."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from costs.robot import VisualMesh
from service.scan.json_data import to_json_data
from service.viewer.files import replace_file
from service.viewer.payload import make_payload
from service.viewer.placements import LinkPlacements
from service.viewer.pose_graph import make_pose_graph

DIST = Path(__file__).parent / "page" / "dist"
"""Output of ``npm run build`` in ``page``."""


def write_viewer(
    result: Mapping[str, Any],
    placements: LinkPlacements,
    path: Path,
    poses: LinkPlacements | None = None,
    visuals: Sequence[VisualMesh] = (),
    hand_contacts: Sequence[Sequence[Mapping[str, Any]]] = (),
) -> None:
    """Write a self-contained viewer of a result.

    Args:
        result: a parsed ``result.json`` (docs/result-format.md).
        placements: poses of the links of ``result["bodies"]`` at each sample of the trajectory.
        path: file to write.
        poses: links at the poses of ``result["pose_graph"]`` (``place_poses``); without them no graph is shown.
        visuals: meshes that the robot's links look like; the page then shows them and hides the collision hulls.
        hand_contacts: those of each phase (``trace_hand_contacts``).

    Raises:
        ValueError: see ``make_payload`` and ``make_pose_graph``.
    """
    payload = make_payload(result, placements, visuals, hand_contacts)
    if poses is not None:
        payload["pose_graph"] = make_pose_graph(result["pose_graph"], poses)
    replace_file(path, render_viewer(payload).encode("utf-8"))


def render_viewer(payload: Mapping[str, Any]) -> str:
    """Return the page for the payload of a result."""
    title = " · ".join(str(part) for part in (payload["robot"], payload["task"], payload["verdict"]) if part)
    return render_page(payload, title, "viewer")


def render_page(payload: Mapping[str, Any], title: str, program: str, is_live: bool = False) -> str:
    """Return a page with one of the programs in ``DIST`` and its data.

    The content security policy allows only that program and style, by hash: no name in the data can run as code.

    Args:
        is_live: whether the page talks to the server that it comes from, shows its pages, and has styles of its own.
    """
    script, style = (DIST / f"{program}.js").read_text("utf-8"), (DIST / "viewer.css").read_text("utf-8")
    if is_live:
        style += (DIST / f"{program}.css").read_text("utf-8")
    # "<" is the one character that could end the data's script element early.
    data = json.dumps(to_json_data(payload), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    policy = (
        f"default-src 'none'; script-src '{_source_hash(script)}'; style-src '{_source_hash(style)}'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
        + ("; connect-src 'self'; frame-src 'self'" if is_live else "")
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
