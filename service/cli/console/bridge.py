"""The bridge of one page: orders come in over a WebSocket, answers and events go out."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Mapping
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from service.cli.console.order import Console
from service.cli.console.orders import ORDERS
from service.cli.console.sessions import COOKIE, OperatorSession
from service.cli.console.settings import page_version
from service.client import PlannerError
from service.errors import RequestError, ServiceError, shown, would_do

_LOG = logging.getLogger("scopt.console")
ENDED, OTHER_VERSION, FORGED = 4401, 4409, 4403
MEASURED = "measured"  # event of a pose that a later one replaces
SLOW_S = 1.0  # between two of them on a slow line
MOST_AT_ONCE = 16  # orders of one page that are worked on


class _RefusedError(Exception):
    """A page that may not give orders."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


async def serve_page(console: Console, websocket: WebSocket) -> None:
    """Answer the orders of a page until it goes.

    The page first sends ``{hello: {version, forgery, is_slow}}``; one on a slow line gets a measured pose a second.
    An order is ``{id, order, ...}``; each is answered by ``{id, result}`` or ``{id, error, code}``. What happens
    besides is ``{event, ...}``.
    """
    await websocket.accept()
    try:
        session, is_slow = await _receive_hello(console, websocket)
    except _RefusedError as refused:
        await websocket.send_json({"refused": str(refused)})
        await websocket.close(refused.code)
        return
    except (WebSocketDisconnect, ValueError):
        return
    queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
    session.add_page(queue)
    sender = asyncio.create_task(send_events(websocket, queue, SLOW_S if is_slow else 0.0))
    answers: set[asyncio.Task[None]] = set()
    try:
        while True:
            message = json.loads(await websocket.receive_text())
            if len(answers) >= MOST_AT_ONCE:
                queue.put_nowait({"id": _read_id(message), "error": "too many orders at once; wait for an answer"})
                continue
            task = asyncio.create_task(_answer(console, session, message, queue))
            answers.add(task)
            task.add_done_callback(answers.discard)
    except (WebSocketDisconnect, ValueError, RecursionError, KeyError):
        pass  # the page went, or sends what no page of this console sends
    finally:
        for task in (sender, *answers):
            task.cancel()
        await session.remove_page(queue)
        await asyncio.gather(sender, *answers, return_exceptions=True)


async def _receive_hello(console: Console, websocket: WebSocket) -> tuple[OperatorSession, bool]:
    message = json.loads(await websocket.receive_text())
    hello = message.get("hello") if isinstance(message, dict) else None
    if not isinstance(hello, dict):
        raise _RefusedError(FORGED, "expected hello with version and forgery first")
    if hello.get("version") != page_version():
        raise _RefusedError(OTHER_VERSION, "this page is of another version than the console; load it again")
    session = console.sessions.find(websocket.cookies.get(COOKIE))
    if session is None:
        raise _RefusedError(ENDED, "the session has ended; log in again")
    if hello.get("forgery") != session.forgery:
        raise _RefusedError(FORGED, "forgery: is not that of this session; load the page again")
    return session, hello.get("is_slow") is True


async def send_events(websocket: WebSocket, queue: asyncio.Queue[dict[str, Any]], period_s: float) -> None:
    """Send events and answers to a page as they come, and of measured poses the newest, one per ``period_s``."""
    due, latest = 0.0, None
    while True:
        try:
            async with asyncio.timeout(None if latest is None else max(0.0, due - time.monotonic())):
                message = await queue.get()
        except TimeoutError:
            await websocket.send_json(latest)
            due, latest = time.monotonic() + period_s, None
            continue
        if period_s > 0.0 and message.get("event") == MEASURED:
            latest = message
        else:
            await websocket.send_json(message)


async def _answer(
    console: Console, session: OperatorSession, message: Any, queue: asyncio.Queue[dict[str, Any]]
) -> None:
    number = _read_id(message)
    try:
        result = await _carry_out(console, session, message)
    except PlannerError as error:
        queue.put_nowait({"id": number, "error": "; ".join(error.problems), "code": error.code.name})
    except RequestError as error:
        queue.put_nowait({"id": number, "error": "; ".join(error.problems), "code": "INVALID_ARGUMENT"})
    except ServiceError as error:
        queue.put_nowait({"id": number, "error": str(error), "code": "FAILED_PRECONDITION"})
    except Exception:
        _LOG.exception("order failed")
        queue.put_nowait({"id": number, "error": "the console failed at this order; see its log", "code": "INTERNAL"})
    else:
        queue.put_nowait({"id": number, "result": result})


async def _carry_out(console: Console, session: OperatorSession, message: Mapping[str, Any]) -> Any:
    """Carry an order out and return its result, JSON-ready.

    Raises:
        RequestError: there is no such order, or its arguments do not fit.
    """
    if not isinstance(message, dict):
        raise RequestError(f"order: expected a mapping, got {shown(message)}")
    name = message.get("order")
    if not isinstance(name, str) or name not in ORDERS:
        raise RequestError(f"order: unknown order {shown(name)}; expected {would_do(str(name), ORDERS)}")
    arguments = {key: value for key, value in message.items() if key not in ("id", "order")}
    return await ORDERS[name].carry_out(console, session, arguments)


def _read_id(message: Any) -> Any:
    number = message.get("id") if isinstance(message, dict) else None
    return number if isinstance(number, int) else None
