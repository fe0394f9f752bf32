"""The web application: the page, log-in, viewer pages of plans, and the bridge of orders."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from grpc import StatusCode
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from service.cli.console.bridge import serve_page
from service.cli.console.guard import Guard
from service.cli.console.order import Console
from service.cli.console.sessions import COOKIE, OperatorSession
from service.cli.console.settings import PROGRAM, ConsoleSettings, page_version
from service.client import PlannerError
from service.errors import RequestError
from service.viewer.html import render_page

MOST_LOGIN_BYTES = 10_000
# A viewer page runs its own program, and can reach neither this console nor its cookie.
VIEWER_POLICY = "sandbox allow-scripts allow-downloads; frame-ancestors 'self'"


def make_app(settings: ConsoleSettings) -> Starlette:
    """Return the application of a console."""
    console = Console(settings)
    page = render_page({"version": page_version(), "server": settings.target}, "scopt console", PROGRAM, is_live=True)

    async def show_page(request: Request) -> Response:
        return HTMLResponse(page, headers={"content-security-policy": "frame-ancestors 'none'"})

    async def tell_session(request: Request) -> Response:
        """Who the browser's operator is; begins an anonymous session where the server knows no tokens."""
        session = console.sessions.find(request.cookies.get(COOKIE))
        if session is not None:
            return _welcome(session, is_new=False)
        try:
            return _welcome(await console.sessions.open(None), is_new=True)
        except PlannerError as error:
            return _refuse(error)

    async def log_in(request: Request) -> Response:
        body = await request.body()
        try:
            token = json.loads(body[:MOST_LOGIN_BYTES])["token"].strip()
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return _say("token: expected the line that `scopt token` printed", 400)
        try:
            return _welcome(await console.sessions.open(token), is_new=True)
        except RequestError as error:
            return _say(str(error), 400)
        except PlannerError as error:
            return _refuse(error)

    async def log_out(request: Request) -> Response:
        session = console.sessions.find(request.cookies.get(COOKIE))
        if session is not None:
            await console.sessions.end(session)
        response = JSONResponse({})
        response.delete_cookie(COOKIE, samesite="strict", httponly=True)
        return response

    async def show_viewer(request: Request) -> Response:
        session = console.sessions.find(request.cookies.get(COOKIE))
        opened = None if session is None else session.opened.get(request.path_params["plan_id"])
        if opened is None or opened.page is None:
            return PlainTextResponse("This plan is not open, or has no page; open it in the console.", 404)
        return HTMLResponse(opened.page, headers={"content-security-policy": VIEWER_POLICY})

    async def bridge(websocket: WebSocket) -> None:
        await serve_page(console, websocket)

    @asynccontextmanager
    async def live(app: Starlette) -> AsyncIterator[None]:
        yield
        await console.sessions.close()

    routes = [
        Route("/", show_page),
        # By POST, so that no page of another origin can begin sessions until the operator's own has to end.
        Route("/session", tell_session, methods=["POST"]),
        Route("/login", log_in, methods=["POST"]),
        Route("/logout", log_out, methods=["POST"]),
        Route("/plans/{plan_id}/viewer.html", show_viewer),
        WebSocketRoute("/orders", bridge),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard)], lifespan=live)


def _welcome(session: OperatorSession, is_new: bool) -> Response:
    response = JSONResponse({"forgery": session.forgery, "version": page_version()})
    if is_new:
        response.set_cookie(COOKIE, session.key, httponly=True, samesite="strict")
    return response


def _refuse(error: PlannerError) -> Response:
    return JSONResponse(
        {"error": error.problems[0], "code": error.code.name}, 503 if error.code is StatusCode.UNAVAILABLE else 403
    )


def _say(text: str, status: int) -> Response:
    return JSONResponse({"error": text, "code": "INVALID_ARGUMENT"}, status)
