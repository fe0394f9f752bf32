"""The console in a process of its own, and the pointer on its page."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from browser import Browser

WAIT_S, AGAIN_S = 240.0, 5.0


@contextmanager
def console_of(target: str, folder: Path) -> Iterator[str]:
    """``scopt console`` in a process of its own; the address of its page."""
    program = [sys.executable, "-c", "from service.cli.app import main; main()", "console"]
    process = subprocess.Popen(
        [*program, "--target", target, "--listen", "127.0.0.1:0", "--scans", str(folder)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        said = process.stdout.readline()
        assert said.startswith("console at "), said
        yield said.removeprefix("console at ").strip()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def wait(browser: Browser, expression: str) -> None:
    end = time.monotonic() + WAIT_S
    while not browser.run(expression):
        assert time.monotonic() < end, f"{expression}: {browser.run('document.body.innerText')[:2000]}"
        time.sleep(0.05)


def click(browser: Browser, selector: str, text: str, until: str | None = None) -> None:
    """Click on the one element of a selector that has this text, with the pointer.

    With ``until``, again every few seconds until an expression holds: what moves under the pointer is missed.
    """
    find = f"[...document.querySelectorAll({json.dumps(selector)})].find((e) => e.textContent === {json.dumps(text)})"
    wait(browser, f"!!{find} && !{find}.disabled")
    end = time.monotonic() + WAIT_S
    while True:
        x, y = browser.run(
            f"(() => {{ const e = {find}; e.scrollIntoView({{block: 'center'}}); const r = e.getBoundingClientRect(); "
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
        again = time.monotonic() + AGAIN_S
        while until is not None and not browser.run(until) and time.monotonic() < again:
            time.sleep(0.05)
        if until is None or browser.run(until):
            return
        assert time.monotonic() < end, f"{until}: {browser.run('document.body.innerText')[:2000]}"
