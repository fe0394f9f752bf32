"""Film strips of results."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from browser import find_chromium
from PIL import Image
from viewer_results import make_result

from service.viewer import write_viewer

TOOL = Path(__file__).parents[2] / "tools" / "gallery.py"


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    spec = importlib.util.spec_from_file_location("gallery", TOOL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_folder(folder: Path, **changes: object) -> Path:
    folder.mkdir()
    result, placements = make_result()
    result.update(changes)
    (folder / "result.json").write_text(json.dumps(result))
    if not changes:
        write_viewer(result, placements, folder / "viewer.html")
    return folder


def test_without_a_browser_it_says_so_in_one_line(
    gallery: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(sys, "argv", ["gallery.py"])
    assert gallery.main() == 1
    said = capsys.readouterr().err
    assert said.startswith("the gallery needs a browser: none of chromium, ")
    assert said.count("\n") == 1


def test_at_a_border_of_phases_the_later_one_is_named(gallery: ModuleType) -> None:
    result, _ = make_result()
    assert [gallery.find_phase(result, time) for time in (0.0, 2.9, 3.0, 6.0, 7.0)] == ["reach"] * 2 + ["turn"] * 2 + [
        ""
    ]


def test_a_strip_shows_the_motion_at_even_times(
    gallery: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if find_chromium() is None:
        pytest.skip("no chromium on this machine")
    moved, still = write_folder(tmp_path / "moved"), write_folder(tmp_path / "still", trajectory=None)
    monkeypatch.setattr(sys, "argv", ["gallery.py", str(moved), str(still), "--frames", "2", "--out", str(tmp_path)])
    assert gallery.main() == 1
    assert "still: no motion to show (CERTIFIED)" in capsys.readouterr().err
    assert not (tmp_path / "still.png").exists()
    with Image.open(tmp_path / "moved.png") as image:
        strip = np.asarray(image.convert("RGB")).astype(int)
    (width, height), bar = gallery.FRAME, gallery.BAR
    assert strip.shape == (height + 2 * bar, 2 * width, 3)
    frames = [strip[bar : bar + height, k * width + 2 : (k + 1) * width] for k in range(2)]
    teal = [np.count_nonzero((f[..., 1] > f[..., 0] + 40) & (f[..., 2] > f[..., 0] + 30)) for f in frames]
    assert min(teal) > 50  # the left hand and foot are in both
    assert np.count_nonzero(np.abs(frames[0] - frames[1]).max(axis=2) > 30) > 500
