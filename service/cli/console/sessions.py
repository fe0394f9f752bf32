"""Sessions of operators: a cookie in the browser, and here their token, their connection and what they see."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from service.cli.console.posing import PoseSeat
from service.cli.console.robot import RobotSeat
from service.cli.console.settings import ConsoleSettings
from service.client import AsyncPlannerClient, Retry
from service.proto.planner.v1.planner_pb2 import PlanRecord

COOKIE = "scopt_console"
MOST_SESSIONS = 50
MOST_OPENED = 8  # plans whose pages a session keeps
MOST_WAITING = 1000  # events of a page that does not read them
IDLE_S = 12 * 3600.0


@dataclass
class OpenedPlan:
    """A plan as the page shows it; a review is of exactly this.

    Attributes:
        record: of the server.
        page: content of ``viewer.html``; None for a plan without files.
        releases: phase in which hands let go of an object, by object.
    """

    record: PlanRecord
    page: bytes | None
    releases: Mapping[str, str] = field(default_factory=dict)


@dataclass
class OperatorSession:
    """An operator at one or several pages.

    Attributes:
        key: content of the cookie.
        forgery: token that each page sends back, which pages of other origins cannot read.
        client: calls the server with the operator's own token.
        opened: plans that were opened, by id.
        hits: objects that were found, by number.
        jobs: plans that were asked for, by number, as the page draws them.
        robot: what the operator sees and has of the server's robot.
        pose: the pose that the operator leads.
        is_moving: whether a nudge or another direct move is under way.
    """

    key: str
    forgery: str
    client: AsyncPlannerClient
    opened: OrderedDict[str, OpenedPlan] = field(default_factory=OrderedDict)
    hits: dict[int, dict[str, Any]] = field(default_factory=dict)
    jobs: dict[int, dict[str, Any]] = field(default_factory=dict)
    tasks: dict[int, asyncio.Task[None]] = field(default_factory=dict)
    listeners: set[asyncio.Queue[dict[str, Any]]] = field(default_factory=set)
    last_used: float = field(default_factory=time.monotonic)
    robot: RobotSeat = field(init=False)
    pose: PoseSeat = field(init=False)
    is_moving: bool = False

    def __post_init__(self) -> None:
        self.robot = RobotSeat(self.client, self.tell)
        self.pose = PoseSeat(self.client, self.tell)

    def add_page(self, queue: asyncio.Queue[dict[str, Any]]) -> None:
        """Send events to another page, the present state first."""
        self.listeners.add(queue)
        queue.put_nowait({"event": "hello", "jobs": list(self.jobs.values())})
        queue.put_nowait(self.robot.describe())
        self.robot.attend()

    async def remove_page(self, queue: asyncio.Queue[dict[str, Any]]) -> None:
        """Forget a page that has gone; without any page the server sees that its operator has gone."""
        self.listeners.discard(queue)
        if not self.listeners:
            await self.pose.close()
            await self.robot.leave()

    def keep_opened(self, plan_id: str, opened: OpenedPlan) -> None:
        """Keep a plan as it is shown now, and forget the one opened longest ago."""
        self.opened[plan_id] = opened
        self.opened.move_to_end(plan_id)
        while len(self.opened) > MOST_OPENED:
            self.opened.popitem(last=False)

    def tell(self, event: Mapping[str, Any]) -> None:
        """Send an event to all pages; a page that reads none loses them."""
        for queue in self.listeners:
            if queue.qsize() < MOST_WAITING:
                queue.put_nowait(dict(event))

    async def close(self) -> None:
        """Stop the plans of the session, give control of the robot back, and close the connection."""
        for task in self.tasks.values():
            task.cancel()
        await asyncio.gather(*self.tasks.values(), return_exceptions=True)
        await self.pose.close()
        await self.robot.close()
        await self.client.close()


class Sessions:
    """All sessions of a console; the one that was idle longest ends when there are too many."""

    def __init__(self, settings: ConsoleSettings) -> None:
        self._settings = settings
        self._sessions: OrderedDict[str, OperatorSession] = OrderedDict()

    def find(self, key: str | None) -> OperatorSession | None:
        """Return the session of a cookie; None if it has ended."""
        session = self._sessions.get(key or "")
        if session is None or time.monotonic() - session.last_used > IDLE_S:
            return None
        session.last_used = time.monotonic()
        self._sessions.move_to_end(session.key)
        return session

    async def open(self, token: str | None) -> OperatorSession:
        """Begin a session of the holder of a token, or of an anonymous operator, and return it.

        Raises:
            RequestError: the token cannot be sent.
            PlannerError: the server refuses the token, or does not answer.
        """
        settings = self._settings
        client = AsyncPlannerClient(
            settings.target,
            tls_ca=settings.tls_ca,
            tls_cert=settings.tls_cert,
            tls_key=settings.tls_key,
            token=token,
            retry=Retry(attempts=1),
        )
        try:
            await check_token(client)
        except BaseException:
            await client.close()
            raise
        session = OperatorSession(secrets.token_urlsafe(32), secrets.token_urlsafe(32), client)
        self._sessions[session.key] = session
        while len(self._sessions) > MOST_SESSIONS:
            _, oldest = self._sessions.popitem(last=False)
            await oldest.close()
        return session

    async def end(self, session: OperatorSession) -> None:
        """End a session."""
        self._sessions.pop(session.key, None)
        await session.close()

    async def close(self) -> None:
        """End all sessions."""
        while self._sessions:
            await self.end(next(iter(self._sessions.values())))


async def check_token(client: AsyncPlannerClient) -> None:
    """Ask the server for its robots, which shows whether it knows the caller; a caller without the role is known.

    Raises:
        PlannerError: the server refuses the token, or does not answer.
    """
    from grpc import StatusCode

    from service.client import PlannerError

    try:
        await client.robots()
    except PlannerError as error:
        if error.code is not StatusCode.PERMISSION_DENIED:
            raise
