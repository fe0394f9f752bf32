"""Guard against other pages in the operator's browser: hosts, origins, and headers of every response."""

from __future__ import annotations

from collections.abc import Mapping

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from service.errors import shown
from service.trust import is_loopback

SAFE_METHODS = ("GET", "HEAD")
HEADERS: Mapping[str, str] = {
    "cache-control": "no-store",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}


class Guard:
    """Refuses requests that no page of this console made, before they reach it.

    A host other than this machine's names is one that somebody else's name server leads here; what changes something
    must come from a page of the same origin, which a browser states and no page can forge.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        problem = find_problem(headers, scope["type"], scope.get("method", ""))
        if problem:
            refusal = WebSocketClose(1008, problem) if scope["type"] == "websocket" else PlainTextResponse(problem, 403)
            await refusal(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                sent = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    sent.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_guarded)


def find_problem(headers: Mapping[str, str], kind: str, method: str) -> str:
    """Return why a request is refused; empty if it is not.

    Args:
        headers: of the request, with lower-case names.
        kind: ``http`` or ``websocket``.
        method: of an HTTP request.
    """
    host = headers.get("host", "")
    if not is_loopback(host.rpartition(":")[0] if _has_port(host) else host):
        return f"host {shown(host)} is not this machine; open the console by 127.0.0.1 or localhost"
    if kind == "http" and method in SAFE_METHODS:
        return ""
    origin = headers.get("origin", "")
    if origin not in (f"http://{host}", f"https://{host}"):
        return f"origin {shown(origin)} is no page of this console; expected http://{host}"
    return ""


def _has_port(host: str) -> bool:
    return ":" in host.rpartition("]")[2]
