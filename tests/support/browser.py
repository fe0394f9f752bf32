"""A headless Chromium driven over the DevTools pipe: open a page, run expressions, press keys, take pictures."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import os
import select
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless --no-sandbox --remote-debugging-pipe --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --use-angle=swiftshader --enable-unsafe-swiftshader --hide-scrollbars "
    "--window-size=1280,800"
)
# Without a graphics card the shaders of a page are compiled at its first drawing, which takes seconds.
UNDRAWN = """for (const name of ["Arrays", "ArraysInstanced", "Elements", "ElementsInstanced", "RangeElements"])
  WebGL2RenderingContext.prototype["draw" + name] = () => {};"""


def find_chromium() -> str | None:
    """Path of a Chromium or Chrome on this machine."""
    return next((found for found in map(shutil.which, NAMES) if found), None)


class Browser:
    """One tab; DevTools messages go through the pipe on file descriptors 3 and 4, so that no port is opened."""

    def __init__(self, program: str, profile: Path, patience_s: float = 300.0) -> None:
        to_child, self._out = os.pipe()
        self._in, from_child = os.pipe()
        command = f"exec {shlex.quote(program)} {FLAGS} --user-data-dir={shlex.quote(str(profile))} about:blank"
        self._process = subprocess.Popen(
            ["bash", "-c", f"{command} 3<&{to_child} 4>&{from_child}"],
            pass_fds=(to_child, from_child),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_child)
        os.close(from_child)
        self._patience_s = patience_s
        self._ids = itertools.count(1)
        self._buffer = b""
        self._is_drawn = True
        self.events: list[dict[str, Any]] = []
        targets = self._call("Target.getTargets", session=None)["targetInfos"]
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        self._session = self._call("Target.attachToTarget", session=None, targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        # A camera that glides is drawn many times on its way.
        still = {"name": "prefers-reduced-motion", "value": "reduce"}
        self.call("Emulation.setEmulatedMedia", features=[still])

    def _read(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._in], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise TimeoutError("the browser did not answer")
            chunk = os.read(self._in, 1 << 20)
            if not chunk:
                raise ConnectionError("the browser ended")
            self._buffer += chunk
        line, self._buffer = self._buffer.split(b"\0", 1)
        return dict(json.loads(line))

    def _call(self, method: str, session: str | None, **params: Any) -> dict[str, Any]:
        number = next(self._ids)
        message: dict[str, Any] = {"id": number, "method": method, "params": params}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + self._patience_s
        while True:
            answer = self._read(deadline)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])
            self.events.append(answer)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A DevTools command to the tab."""
        return self._call(method, self._session, **params)

    def open(self, url: str, is_drawn: bool = True) -> None:
        """Load a page and wait until its viewer is ready; one that is only read need not be drawn."""
        self.call("Page.navigate", url="about:blank")
        if is_drawn != self._is_drawn:
            self._set_drawn(is_drawn)
        self.events.clear()
        self.call("Page.navigate", url=url)
        deadline = time.monotonic() + self._patience_s
        while not self.run("document.readyState === 'complete' && (window.__viewer?.ready ?? false)"):
            if time.monotonic() > deadline:
                raise TimeoutError(f"no viewer at {url}: {self.complaints()}")
            time.sleep(0.05)

    def turn(self, url: str) -> None:
        """Give the page that is open another hash, as a user does who edits its address; open and draw another page.

        A page compiles its shaders whenever it is opened, which costs seconds.
        """
        page, _, fragment = url.partition("#")
        if not self._is_drawn or self.run("location.href.split('#')[0]") != page:
            self.open(url)
        else:
            # The page listens first, so that it has followed when this listener is called.
            self.run(
                "new Promise((done) => { addEventListener('hashchange', () => done(true), { once: true });"
                f"if (location.hash === {json.dumps('#' + fragment)}) dispatchEvent(new HashChangeEvent('hashchange'));"
                f"else location.hash = {json.dumps(fragment)}; }})"
            )
        self.settle()

    def _set_drawn(self, is_drawn: bool) -> None:
        """Let the pages that are opened from now on draw their scene, or leave it out."""
        if is_drawn:
            self.call("Page.removeScriptToEvaluateOnNewDocument", identifier=self._undrawn)
        else:
            script = self.call("Page.addScriptToEvaluateOnNewDocument", source=UNDRAWN)
            self._undrawn: str = script["identifier"]
        self._is_drawn = is_drawn

    def run(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"]["exception"].get("description", "exception"))
        return result["result"].get("value")

    def key(self, key: str) -> None:
        """Press and release a key."""
        text = {"text": key} if len(key) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=key)

    def settle(self) -> None:
        """Wait until the page has drawn what it was asked for and all camera moves have ended."""
        self.run(
            "new Promise((done) => { const look = () => "
            "window.__viewer.busy ? setTimeout(look, 30) : requestAnimationFrame(() => done(true)); look(); })"
        )

    def size(self, width: int, height: int) -> None:
        """Set the page's size in pixels."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def picture(self, path: Path | None = None) -> np.ndarray:
        """The page as (H, W, 3) bytes; also written to ``path``."""
        assert self._is_drawn, "the page was opened without being drawn"
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        with Image.open(io.BytesIO(data)) as image:
            return np.asarray(image.convert("RGB")).copy()

    def complaints(self) -> list[str]:
        """Errors, exceptions and policy violations the page reported since it was opened."""
        self.run("1")
        found = []
        for event in self.events:
            params = event.get("params", {})
            if event.get("method") == "Runtime.exceptionThrown":
                found.append(str(params["exceptionDetails"]))
            elif event.get("method") == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
                found.append(str(params["args"]))
            elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] == "error":
                found.append(params["entry"]["text"])
        return found

    def requests(self) -> list[str]:
        """Addresses the page asked for since it was opened."""
        return [
            event["params"]["request"]["url"] for event in self.events if event["method"] == "Network.requestWillBeSent"
        ]

    def close(self) -> None:
        """End the browser and all its processes."""
        with contextlib.suppress(Exception):
            self._call("Browser.close", session=None)
        for end in (self._out, self._in):
            os.close(end)
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


@contextlib.contextmanager
def open_browser(profile: Path, size: tuple[int, int] | None = None) -> Iterator[Browser]:
    """A browser with a window of a size, closed in the end; the test is skipped where there is none."""
    program = find_chromium()
    if program is None:
        pytest.skip("no chromium on this machine")
    browser = Browser(program, profile)
    try:
        if size is not None:
            browser.size(*size)
        yield browser
    finally:
        browser.close()
