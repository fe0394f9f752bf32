"""Render one film strip per task: pictures of the viewer page at even times, side by side in a PNG.

Plans a valve turn and a door from the shipped scans, a given door with a push bar and a reach; or takes result folders.

    python tools/gallery.py                           # out/gallery/valve.png, door.png, push_bar.png, reach.png
    python tools/gallery.py out/valve --frames 8      # out/gallery/valve.png of a result folder
    python tools/gallery.py out/valve --simulated     # of the page that `scopt simulate out/valve` wrote
    python tools/gallery.py --width 1400 --out docs/gallery    # small ones, for docs/gallery.md
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from service.planner import plan
from service.request.file import load_request, parse_request
from service.result.output import write_result

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless --no-sandbox --disable-gpu --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader "
    "--disable-quic --no-first-run --hide-scrollbars --virtual-time-budget=5000"
)
VIEW = "theme=light&bars=0&without=shapeless,ghosts"
FRAME = (520, 680)
"""Width and height of a picture [px]."""
BAR = 34
"""Height of a line of text [px]."""

PUSH_BAR = {
    "robot": {"name": "atlas"},
    "start": {"posture": "reach_ready"},
    "scene": {
        "obstacles": [
            {"name": f"{side} wall", "type": "box", "size": [0.12, 1.2, 2.4], "position": [0.69, y, 1.2]}
            for side, y in (("left", 1.09), ("right", -1.09))
        ]
    },
    "task": {
        "door": {
            "opens": "push",
            "open_deg": 40,
            "leaf": {"hinge": [0.75, -0.45, 0.01], "edge": [0.75, 0.45, 0.01]},
            "handle": {"kind": "push_bar", "centre": [0.63, 0.0, 1.02]},
        }
    },
}


def main() -> int:
    """Render the strips; 1 if no browser is installed or a task was not planned."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("folders", nargs="*", type=Path, help="result folders; without any, one request per task")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "gallery", help="folder of the pictures")
    parser.add_argument("--frames", type=int, default=6, help="pictures per strip")
    parser.add_argument("--simulated", action="store_true", help="pictures of simulation.html instead of viewer.html")
    parser.add_argument("--width", type=int, help="width of the strips [px]; then they are WebP files")
    options = parser.parse_args()
    page = "simulation.html" if options.simulated else "viewer.html"
    browser = next((found for found in map(shutil.which, BROWSERS) if found), None)
    if browser is None:
        print(f"the gallery needs a browser: none of {', '.join(BROWSERS)} is installed", file=sys.stderr)
        return 1
    options.out.mkdir(parents=True, exist_ok=True)
    status = 0
    with tempfile.TemporaryDirectory() as scratch:
        named = ((folder.resolve().name, folder) for folder in options.folders)
        for name, folder in named if options.folders else plan_tasks(Path(scratch)):
            result = read_result(folder)
            if not (result.get("trajectory") or {}).get("times"):
                print(f"{name}: no motion to show ({result['verdict']})", file=sys.stderr)
                status = 1
                continue
            strip = render_strip(browser, folder, name, options.frames, Path(scratch), page)
            path = save_strip(strip, options.out / name, options.width)
            print(f"{path}  {result['verdict']}")
    return status


def save_strip(strip: Image.Image, path: Path, width: int | None) -> Path:
    """Save a picture as PNG, or with a width [px] as a smaller WebP; return the path with its suffix."""
    if width is None:
        path = path.with_suffix(".png")
        strip.save(path)
        return path
    path = path.with_suffix(".webp")
    strip.resize((width, round(width * strip.height / strip.width)), Image.Resampling.LANCZOS).save(path, quality=80)
    return path


def read_result(folder: Path) -> dict[str, Any]:
    """Return the parsed ``result.json`` of a result folder."""
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


def plan_tasks(scratch: Path) -> Iterator[tuple[str, Path]]:
    """Plan one request per task; yield its name and result folder."""
    requests = {
        "valve": load_request(ROOT / "examples" / "requests" / "valve.yaml"),
        "door": load_request(ROOT / "examples" / "requests" / "door.yaml"),
        "push_bar": parse_request(PUSH_BAR),
        "reach": load_request(ROOT / "examples" / "requests" / "pose_goal.yaml"),
    }
    for name, request in requests.items():
        folder = scratch / name
        write_result(plan(request), folder)
        yield name, folder


def render_strip(
    browser: str, folder: Path, name: str, n_frames: int, scratch: Path, page: str = "viewer.html"
) -> Image.Image:
    """Return pictures of a result's page at even times, with their times and phases below and a title above."""
    result = read_result(folder)
    times = result["trajectory"]["times"]
    width, height = FRAME
    strip = Image.new("RGB", (n_frames * width, height + 2 * BAR), "white")
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(18)
    title = f"{result['robot']['name']} · {name} · {result['verdict']}"
    draw.text((12, 7), title, "black", font)
    for column, time in enumerate(np.linspace(times[0], times[-1], n_frames)):
        strip.paste(take_picture(browser, folder / page, float(time), scratch), (column * width, BAR))
        draw.text((column * width + 12, height + BAR + 7), f"{time:.2f} s  {find_phase(result, time)}", "black", font)
        draw.line([(column * width, BAR), (column * width, height + 2 * BAR)], "#c8cfd9", 2)
    return strip


def take_picture(browser: str, page: Path, time: float, scratch: Path) -> Image.Image:
    """Return the picture of a page at a time [s].

    Raises:
        RuntimeError: the browser made no picture.
    """
    path = scratch / "frame.png"
    path.unlink(missing_ok=True)
    url = f"{page.resolve().as_uri()}#t={time:.4f}&{VIEW}"
    size = f"--window-size={FRAME[0]},{FRAME[1]}"
    command = [browser, *FLAGS.split(), size, f"--user-data-dir={scratch / 'profile'}", f"--screenshot={path}", url]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if not path.exists():
        raise RuntimeError(f"{browser} made no picture of {page}: {done.stderr.strip().splitlines()[-1:]}")
    with Image.open(path) as picture:
        return picture.convert("RGB").crop((0, 0, *FRAME))


def find_phase(result: Mapping[str, Any], time: float) -> str:
    """Return the name of the phase at a time [s], at a border that of the later one; empty if there is none."""
    times = result["trajectory"]["times"]
    names = [
        phase["name"]
        for phase in result["phases"]
        if times[phase["first"]] - 1e-9 <= time <= times[phase["last"]] + 1e-9
    ]
    return names[-1] if names else ""


if __name__ == "__main__":
    sys.exit(main())
