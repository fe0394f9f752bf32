"""The operator's page in a real browser: ``python -m benchmarks.console.page [--part NAME] [--samples N]``.

Each part starts a server with a simulated robot, its console and a headless Chromium (that of the tests): ``pose``,
bytes of an update; ``watch``, time from a change at the robot to the page; ``valve``, ``door``, ``button``, moved from
their scans by a script; ``sessions`` of random clicks and keys. Times are of the wall clock.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from benchmarks.tables import print_table
from perception import write_pcd
from perception.simulate import Pose, Room, Scanner, scan
from perception.simulate.scenes.fixtures import Panel
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
STANDING = {"robot": {"name": "atlas"}, "goal": {"joints": {"l_arm_elx": 1.2}}}
Row = list[Any]
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
  if (!what) return '';
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


@dataclass
class Seat:
    """A server with a robot, its console and a browser.

    Attributes:
        target, url: addresses of the server and of the page.
        browser: with the page or without it.
        pictures: folder for pictures; None for none.
        seconds: after which no further random session begins.
        seed: of the first random session.
        failures: parts in which the robot did what it must not.
    """

    target: str
    url: str
    browser: Browser
    pictures: Path | None
    seconds: float = 600.0
    seed: int = 0
    failures: list[str] = field(default_factory=list)

    def look(self, name: str) -> None:
        """Take a picture, if there is a folder for it."""
        if self.pictures is not None:
            self.browser.settle()
            self.browser.picture(self.pictures / f"{name}.png")


@contextmanager
def open_seat(pictures: Path | None) -> Iterator[Seat]:
    """A server, its console and a browser, ended afterwards."""
    with tempfile.TemporaryDirectory(prefix="scopt-bench-") as scratch:
        folder = Path(scratch)
        scans = folder / "scans"
        shutil.copytree(ROOT / "examples" / "data", scans, ignore=shutil.ignore_patterns("*.json"))
        write_panel_scan(scans)
        with (
            planner_server(folder / "data", "--robot", "sim") as server,
            console_of(server.address, scans) as url,
            open_browser(folder / "profile", (1280, 800)) as browser,
        ):
            yield Seat(server.address, url, browser, pictures)


def measure_change_to_pixel(target: str, browser: Browser, samples: int) -> list[float]:
    """Return the times from another client's take-over to the page that shows it [ms]."""
    times = []
    with PlannerClient(target) as other:
        for k in range(samples):
            name = f"bench {k}"
            browser.run(  # its value is not the promise, which would be awaited here
                "window.__shown = new Promise((done) => { const at = document.querySelector('.robot-strip .holder'); "
                f"const look = () => at.textContent.includes('{name}') && requestAnimationFrame(() => "
                "done(performance.timeOrigin + performance.now())); "
                "new MutationObserver(look).observe(at, { childList: true, characterData: true, subtree: true }); }); "
                "true"
            )
            begun = time.time()
            other.take_control(name, takes_over=True)
            times.append(float(browser.run("window.__shown")) - 1e3 * begun)
            time.sleep(0.2)
    return times


def measure_bytes(browser: Browser, event: str) -> list[int]:
    """Return the sizes of the updates of a kind that the page has got."""
    browser.run("1")  # events are read with an answer
    frames = [
        e["params"]["response"]["payloadData"]
        for e in browser.events
        if e.get("method") == "Network.webSocketFrameReceived"
    ]
    return [len(frame) for frame in frames if f'"event":"{event}"' in frame.replace(" ", "")[:40]]


@dataclass(frozen=True)
class Drive:
    """One task, from its scan to its end, through the page.

    Attributes:
        task: its tab.
        scan: file.
        at: point that the operator clicks on, in the world [m].
        working: in the name of the phase in which the robot moves the object.
    """

    task: str
    scan: str
    at: tuple[float, float, float]
    working: str


VALVE = Drive("valve", "valve_scan.pcd", (0.68, 0.24, 1.1), "turn")  # the rim
DOOR = Drive("door", "door_scan.pcd", (0.72, -0.36, 1.02), "open")  # the lever
BUTTON = Drive("button", "panel_scan.pcd", (0.62, 0.2, 1.16), "press: move")
PANEL = Panel((0.645, 0.2, 1.1))  # the button that is clicked on is the upper one of two


def write_panel_scan(folder: Path) -> None:
    """Write the scan of a panel with two buttons on a wall, seen from the robot's head."""
    room = Room(wall_x=PANEL.centre[0] + PANEL.depth)
    head = Pose((0.12, 0.0, 1.6), pitch=0.3)
    cloud = scan([*room.meshes([]), *PANEL.build().meshes], head, Scanner(n_lines=84), seed=7)
    near = cloud.points[np.linalg.norm(cloud.points, axis=1) < 4.0]
    write_pcd(folder / BUTTON.scan, np.round(near, 4), head.viewpoint)


def drive_task(seat: Seat, drive: Drive) -> tuple[dict[str, float], int, str]:
    """Carry out a task through the page.

    Returns:
        Seconds from one thing that the operator sees to the next, until the robot moves the object; clicks until the
        plan is accepted; and the mode at the end.
    """
    marks: dict[str, float] = {}

    def mark(name: str) -> None:
        marks[name] = time.monotonic() - begun - sum(marks.values())

    browser = seat.browser
    browser.open(seat.url)
    wait(browser, f"{VIEWER}.state === 'open'")
    begun, clicks = time.monotonic(), 0
    browser.run(f"localStorage.setItem('scopt-console-scan', '{drive.scan}')")
    click(browser, ".tabs button", drive.task)
    wait(browser, f"{VIEWER}.hasScan && !{VIEWER}.busy")
    mark("scan")
    seat.look(f"{drive.task}-scan")
    x, y = browser.run(f"{VIEWER}.project({list(drive.at)})")
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    wait(browser, "document.querySelector('.moving input') !== null")
    clicks += 1
    mark("fit")
    seat.look(f"{drive.task}-fit")
    for selector, text, name in ((".panel .yes", "Plan", "plan asked for"), (".judge .yes", "Accept", "plan opened")):
        wait(browser, f"document.querySelector('{selector}') !== null")
        click(browser, selector, text)
        clicks += 1
        mark(name)
    wait(browser, "document.querySelector('.panel .said').textContent.startsWith('accepted')")
    mark("accepted")
    seat.look(f"{drive.task}-plan")
    click(browser, ".robot-strip button", "Take control", until=f"{VIEWER}.robot.has_control")
    browser.run(
        "[...document.querySelectorAll('.placed')].find((e) => e.textContent.includes('simulated'))"
        ".querySelector('input').click()"
    )
    click(browser, ".buttons .yes", "Execute", until=f"['running', 'loading'].includes({VIEWER}.robot.mode)")
    mark("execution asked for")
    wait(browser, f"{VIEWER}.robot.mode !== 'loading'")
    mark("verified again")
    ended = f"['done', 'fallen', 'aborted'].includes({VIEWER}.robot.mode)"
    wait(browser, f"{VIEWER}.robot.phase.includes('{drive.working}') || {ended}")
    mark("moved there")
    seat.look(f"{drive.task}-drive")
    wait(browser, ended)
    seat.look(f"{drive.task}-end")
    return marks, clicks, str(browser.run(f"{VIEWER}.robot.mode"))


def act_at_random(browser: Browser, url: str, seed: int) -> int:
    """A session of random clicks and keys; returns how many there were."""
    rng = random.Random(seed)
    browser.open(url, is_drawn=False)
    wait(browser, f"{VIEWER}.state === 'open'")
    for _ in range(ACTIONS):
        browser.run(f"{RANDOM_ACT}({json.dumps([rng.random(), rng.random()])})")
        time.sleep(0.15)
    wait(browser, "[...document.querySelectorAll('button')].some((e) => !e.disabled && e.offsetParent !== null)")
    assert browser.complaints() == [], browser.complaints()
    return ACTIONS


def make_small_plan(target: str, folder: Path) -> None:
    """Make an accepted plan that random clicks may carry out."""
    request = {"robot": FIXED, "goal": {"joints": {"l_arm_elx": 1.2}}}
    with PlannerClient(target) as client:
        made = client.plan(parse_request(request), out=folder)
        client.review(client.get_plan(made.plan_id).record, accept=True, comment="for random clicks")


def measure_pose(seat: Seat, n_samples: int) -> list[Row]:
    """Sizes of the poses that a page gets while its robot moves."""
    seat.browser.open(seat.url, is_drawn=False)
    wait(seat.browser, f"{VIEWER}.robot !== null")
    with PlannerClient(seat.target) as client, tempfile.TemporaryDirectory() as folder:
        made = client.plan(parse_request(STANDING), out=Path(folder) / "out")
        taken = client.take_control("bench", takes_over=True)
        states = client.watch(lease=taken.lease)
        revision = next(states).revision
        sha256 = made.result.trajectory.sha256
        client.execute(made.plan_id, sha256, lease=taken.lease, revision=revision, is_placed=True)
        for state in states:
            if wire.ExecutionMode.Name(state.status.mode) == "EXECUTION_MODE_DONE":
                break
        states.close()
    sizes = measure_bytes(seat.browser, "measured")
    worst = f"worst {max(sizes, default=0)}, {len(sizes)} of them"
    return [["bytes of a measured pose of Atlas", f"{np.median(sizes):.0f}" if sizes else "-", worst]]


def measure_watch(seat: Seat, n_samples: int) -> list[Row]:
    """Times from a change at the robot to the page."""
    seat.browser.open(seat.url, is_drawn=False)
    wait(seat.browser, f"{VIEWER}.robot !== null")
    times = measure_change_to_pixel(seat.target, seat.browser, n_samples)
    return [["change at the robot to the page [ms]", f"{np.median(times):.0f}", f"p95 {np.percentile(times, 95):.0f}"]]


def measure_drive(drive: Drive, seat: Seat, n_samples: int) -> list[Row]:
    """A task from its scan to its end."""
    marks, clicks, mode = drive_task(seat, drive)
    if mode != "done":
        seat.failures.append(drive.task)
    return [
        [
            f"{drive.task}, from its scan to where the object moves [s]",
            f"{sum(marks.values()):.1f}",
            f"{clicks} clicks to an approved plan",
        ],
        ["of these", "", ", ".join(f"{name} {seconds:.1f}" for name, seconds in marks.items())],
        ["its end", mode, ""],
    ]


def measure_sessions(seat: Seat, n_samples: int) -> list[Row]:
    """Sessions of random clicks and keys, and what the robot did meanwhile."""
    robot, shown, acts = Robot(seat.target), set[str](), 0
    with tempfile.TemporaryDirectory() as folder:
        make_small_plan(seat.target, Path(folder) / "out")
    end, n_sessions = time.monotonic() + seat.seconds, 0
    while n_sessions < n_samples and time.monotonic() < end:
        acts += act_at_random(seat.browser, seat.url, seat.seed + n_sessions)
        shown |= set(seat.browser.run(f"{VIEWER}.previewed"))
        n_sessions += 1
    unseen = robot.carried_out - shown
    if "fallen" in robot.modes or unseen:
        seat.failures.append("sessions")
    return [
        ["random sessions", f"{n_sessions}", f"{acts} clicks and keys, from seed {seat.seed}"],
        ["falls", str(int("fallen" in robot.modes)), ""],
        ["motions carried out", str(len(robot.carried_out)), f"{len(unseen)} not previewed"],
    ]


PARTS: dict[str, tuple[Callable[[Seat, int], list[Row]], int]] = {
    "pose": (measure_pose, 1), "watch": (measure_watch, 20),
    **{drive.task: (partial(measure_drive, drive), 1) for drive in (VALVE, DOOR, BUTTON)},
    "sessions": (measure_sessions, 20),
}  # fmt: skip


def main() -> int:
    """Print the table of each part; 1 if the robot did what it must not, or left a task undone."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=list(PARTS), help="by default all; repeatable")
    parser.add_argument("--samples", type=int, help="of changes, or of sessions")
    parser.add_argument("--seconds", type=float, default=600.0, help="after which no further session begins")
    parser.add_argument("--seed", type=int, default=0, help="of the first session")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the tasks")
    options = parser.parse_args()
    failures: list[str] = []
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
    for name in options.part or PARTS:
        measure, usual = PARTS[name]
        with open_seat(options.pictures) as seat:
            seat.seconds, seat.seed = options.seconds, options.seed
            print_table(f"The operator's page: {name}", ("", "", ""), measure(seat, options.samples or usual))
            sys.stdout.flush()
            failures += seat.failures
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
