"""A page of the console without a browser: its connection, what it shows, and the orders that it sends."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from http.cookiejar import CookieJar
from types import TracebackType
from typing import Any
from urllib.request import HTTPCookieProcessor, Request, build_opener

from websockets.sync.client import ClientConnection, connect

LONGEST_S = 120.0  # of an answer
Message = dict[str, Any]


@dataclass
class Seat:
    """A page, connected as the browser's page is.

    Attributes:
        url: of the console.
        robot: the newest event of the robot's state.
        rows: of the inbox.
        plan: the plan that is open, and ``ticked`` its boxes.
        pose: the pose that is led; empty without one.
        shown: hashes of the motions that it has shown.
    """

    url: str
    robot: Message = field(default_factory=dict)
    rows: list[Message] = field(default_factory=list)
    plan: Message = field(default_factory=dict)
    ticked: set[str] = field(default_factory=set)
    pose: Message = field(default_factory=dict)
    shown: set[str] = field(default_factory=set)
    _socket: ClientConnection | None = None
    _number: int = 0
    _answered: int = 0  # revision of the newest answer, which may come before its state

    def __enter__(self) -> Seat:
        jar, origin = CookieJar(), self.url.rstrip("/")
        opener = build_opener(HTTPCookieProcessor(jar))
        said = json.load(opener.open(Request(f"{origin}/session", b"", {"origin": origin}), timeout=LONGEST_S))
        cookie = "; ".join(f"{one.name}={one.value}" for one in jar)
        self._socket = connect(
            origin.replace("http", "ws", 1) + "/orders",
            additional_headers={"cookie": cookie, "origin": origin},
            open_timeout=LONGEST_S,
            max_size=None,
        )
        self._socket.send(json.dumps({"hello": {"version": said["version"], "forgery": said["forgery"]}}))
        self.hear(0.1)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._socket is not None:
            self._socket.close()

    @property
    def revision(self) -> int:
        """Revision that the operator sees."""
        return max(self._answered, int(self.robot.get("revision", 0)))

    @property
    def may_order(self) -> bool:
        """Whether this page has control, and nothing is left to acknowledge."""
        return bool(self.robot.get("has_control")) and not self.robot.get("surprises")

    def hear(self, seconds: float) -> None:
        """Take the events that come within a time [s]."""
        assert self._socket is not None
        end = time.monotonic() + seconds
        while True:
            try:
                message = json.loads(self._socket.recv(timeout=max(0.0, end - time.monotonic())))
            except TimeoutError:
                return
            self._take(message)

    def order(self, name: str, **values: Any) -> Message:
        """Give an order, and return its answer: ``result``, or ``error`` with a sentence."""
        assert self._socket is not None
        self._number += 1
        self._socket.send(json.dumps({**values, "id": self._number, "order": name}))
        end = time.monotonic() + LONGEST_S
        while True:
            message: Message = json.loads(self._socket.recv(timeout=max(0.01, end - time.monotonic())))
            if message.get("id") == self._number:
                break
            self._take(message)
        result = message.get("result")
        if isinstance(result, dict) and isinstance(result.get("revision"), int):
            self._answered = max(self._answered, result["revision"])
        return message

    def _take(self, message: Message) -> None:
        match message.get("event"):
            case "robot":
                self.robot = message
            case "measured":
                self.robot.update({key: value for key, value in message.items() if key != "event"})
            case "pose" if self.pose and message.get("session") == self.pose.get("session"):
                self.pose = {} if "problem" in message else {**self.pose, **message}
