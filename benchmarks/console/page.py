"""The operator's page in a real browser: ``python -m benchmarks.console.page [--sessions N] [--pictures FOLDER]``.

A server with a simulated robot, its console and a headless Chromium (that of the tests) on this machine: bytes of an
update, time from a change at the robot to the page, the valve turned from its scan by a script, and sessions of random
clicks and keys. Times are of the wall clock; state the machine's load with them.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from service.client import PlannerClient
from service.proto.planner.v1 import execution_pb2 as wire
from service.request.file import parse_request

ROOT = Path(__file__).resolve().parents[2]
sys.path += [str(ROOT / "tests" / "support" / folder) for folder in (".", "servers")]

from browser import Browser, open_browser  # type: ignore[import-not-found]  # noqa: E402
from console_page import click, console_of, wait  # type: ignore[import-not-found]  # noqa: E402
from planner_server import planner_server  # type: ignore[import-not-found]  # noqa: E402

VIEWER = "window.__viewer"
FIXED = {"name": "atlas", "root": "fixed"}
ACTIONS = 15  # of a random session
# What a hand does at random: a button that is there, a key, or another choice of a list.
RANDOM_ACT = """((pick) => {
  const seen = (e) => !e.disabled && e.offsetParent !== null;
  const all = [...document.querySelectorAll('button, select, input[type=checkbox]')].filter(seen)
    .filter((e) => e.textContent !== 'Log out');
  const what = all[Math.floor(pick[0] * all.length)];
  if (pick[1] < 0.25) {
    const keys = ['ArrowUp', 'ArrowLeft', 'i', 'o', 'e', 'S', 'w', 'q'];
    const key = keys[Math.floor(pick[0] * keys.length)];
    for (const type of ['keydown', 'keyup']) window.dispatchEvent(new KeyboardEvent(type, { key, bubbles: true }));
    return key;
  }
  if (what.tagName === 'SELECT') {
    what.selectedIndex = Math.floor(pick[1] * what.options.length);
    what.dispatchEvent(new Event('change'));
  } else what.click();
  return what.textContent.slice(0, 30) || what.tagName;
})"""


class Robot:
    """What the server tells of its robot, by a client that only looks.

    Attributes:
        modes: every mode that it had.
        carried_out: hashes of all trajectories that it was given.
    """

    def __init__(self, target: str) -> None:
        self.modes: set[str] = set()
        self.carried_out: set[str] = set()
        self._client = PlannerClient(target)
        Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        for state in self._client.watch(rate_hz=1.0):
            if state.HasField("status"):
                self.modes.add(wire.ExecutionMode.Name(state.status.mode).removeprefix("EXECUTION_MODE_").lower())
            if state.HasField("plan") and state.plan.trajectory_sha256:
                self.carried_out.add(state.plan.trajectory_sha256)


@contextmanager
def open_seat(scans: Path) -> Iterator[tuple[str, str, Browser]]:
    """A server, its console and a browser; yields the server's address, the page's, and the browser."""
    with tempfile.TemporaryDirectory(prefix="scopt-bench-") as scratch:
        folder = Path(scratch)
        with (
            planner_server(folder / "data", "--robot", "sim") as server,
            console_of(server.address, scans) as url,
            open_browser(folder / "profile", (1280, 800)) as browser,
        ):
            yield server.address, url, browser


def measure_change_to_pixel(target: str, browser: Browser, samples: int) -> list[float]:
    """Return the times from another client's take-over to the page that shows it [ms]."""
    times = []
    with PlannerClient(target) as other:
        for k in range(samples):
            name = f"bench {k}"
            browser.run(
                "window.__shown = new Promise((done) => { const at = document.querySelector('.robot-strip .holder'); "
                f"const look = () => at.textContent.includes('{name}') && requestAnimationFrame(() => "
                "done(performance.timeOrigin + performance.now())); "
                "new MutationObserver(look).observe(at, { childList: true, characterData: true, subtree: true }); })"
            )
            begun = time.time()
            other.take_control(name, takes_over=True)
            times.append(float(browser.run("window.__shown")) - 1e3 * begun)
            time.sleep(0.2)
    return times


def measure_bytes(browser: Browser, event: str) -> list[int]:
    """Return the sizes of the updates of a kind that the page has got."""
    frames = [
        e["params"]["response"]["payloadData"]
        for e in browser.events
        if e.get("method") == "Network.webSocketFrameReceived"
    ]
    return [len(frame) for frame in frames if f'"event":"{event}"' in frame.replace(" ", "")[:40]]


def turn_valve(browser: Browser, url: str, look: Callable[[str], None]) -> tuple[float, int]:
    """Turn the valve of the shipped scan through the page; return seconds until it turns, and clicks until accepted."""
    browser.open(url)
    wait(browser, f"{VIEWER}.state === 'open'")
    begun = time.monotonic()
    browser.run("localStorage.setItem('scopt-console-scan', 'valve_scan.pcd')")
    click(browser, ".tabs button", "valve")
    wait(browser, f"{VIEWER}.hasScan && !{VIEWER}.busy")
    look("scan")
    x, y = browser.run(f"{VIEWER}.project([0.68, 0.24, 1.1])")
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    wait(browser, "document.querySelector('.moving input') !== null")
    look("fit")
    click(browser, ".panel .yes", "Plan")
    wait(browser, "document.querySelector('.judge .yes') !== null")
    click(browser, ".judge .yes", "Accept")
    wait(browser, "document.querySelector('.panel .said').textContent.startsWith('accepted')")
    look("plan")
    click(browser, ".robot-strip button", "Take control", until=f"{VIEWER}.robot.has_control")
    browser.run(
        "[...document.querySelectorAll('.placed')].find((e) => e.textContent.includes('simulated'))"
        ".querySelector('input').click()"
    )
    click(browser, ".buttons .yes", "Execute", until=f"['running', 'loading'].includes({VIEWER}.robot.mode)")
    wait(browser, f"{VIEWER}.robot.phase === 'turn' || ['done', 'fallen', 'aborted'].includes({VIEWER}.robot.mode)")
    seconds = time.monotonic() - begun
    for k in range(4):
        look(f"drive{k}")
        time.sleep(1.5)
    wait(browser, f"['done', 'fallen', 'aborted'].includes({VIEWER}.robot.mode)")
    look("end")
    return seconds, 3  # the object, Plan, Accept


def act_at_random(browser: Browser, url: str, seed: int) -> int:
    """A session of random clicks and keys; returns how many there were."""
    rng = random.Random(seed)
    browser.open(url, is_drawn=False)
    wait(browser, f"{VIEWER}.state === 'open'")
    for _ in range(ACTIONS):
        browser.run(f"{RANDOM_ACT}({json.dumps([rng.random(), rng.random()])})")
        time.sleep(0.15)
    assert browser.complaints() == [], browser.complaints()
    return ACTIONS


def make_small_plan(target: str, folder: Path) -> None:
    """Make an accepted plan that random clicks may carry out."""
    request = {"robot": FIXED, "goal": {"joints": {"l_arm_elx": 1.2}}}
    with PlannerClient(target) as client:
        made = client.plan(parse_request(request), out=folder)
        client.review(client.get_plan(made.plan_id).record, accept=True, comment="for random clicks")


def main() -> int:
    """Print the tables; 1 if a random session had the robot do what it must not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=20, help="of random clicks and keys")
    parser.add_argument("--samples", type=int, default=20, help="of changes at the robot")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the valve's drive")
    parser.add_argument("--without-valve", action="store_true", help="leave the valve out, which takes a minute")
    options = parser.parse_args()
    with open_seat(ROOT / "examples" / "data") as (target, url, browser):
        robot = Robot(target)

        def look(name: str) -> None:
            if options.pictures is not None:
                browser.settle()
                browser.picture(options.pictures / f"{name}.png")

        rows: list[list[Any]] = []
        shown = set[str]()
        if not options.without_valve:
            seconds, clicks = turn_valve(browser, url, look)
            rows.append(
                ["valve from its scan to its turn [s]", f"{seconds:.1f}", f"{clicks} clicks to an approved plan"]
            )
            shown |= set(browser.run(f"{VIEWER}.previewed"))
            sizes = measure_bytes(browser, "measured")
            rows.append(
                ["bytes of a measured pose", f"{np.median(sizes):.0f}", f"worst {max(sizes)}, {len(sizes)} of them"]
            )
        browser.open(url, is_drawn=False)
        wait(browser, f"{VIEWER}.robot !== null")
        times = measure_change_to_pixel(target, browser, options.samples)
        rows.append(
            ["change at the robot to the page [ms]", f"{np.median(times):.0f}", f"p95 {np.percentile(times, 95):.0f}"]
        )
        with tempfile.TemporaryDirectory() as folder:
            make_small_plan(target, Path(folder) / "out")
        acts = 0
        for seed in range(options.sessions):
            acts += act_at_random(browser, url, seed)
            shown |= set(browser.run(f"{VIEWER}.previewed"))
        unseen = robot.carried_out - shown
        rows.append(["random sessions", f"{options.sessions}", f"{acts} clicks and keys"])
        rows.append(["falls", str(int("fallen" in robot.modes)), ""])
        rows.append(["motions carried out", str(len(robot.carried_out)), f"{len(unseen)} not previewed"])
        print_table("The operator's page", ("", "", ""), rows)
    return int("fallen" in robot.modes or bool(unseen))


if __name__ == "__main__":
    sys.exit(main())
