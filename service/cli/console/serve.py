"""Start of a console's web server, and its run until a signal."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from service.cli.console.settings import ConsoleSettings
from service.errors import RequestError, shown
from service.trust import is_loopback

MOST_MESSAGE_BYTES = 2**20  # of a page


def run_console(settings: ConsoleSettings, listen: str, on_ready: Callable[[str], None]) -> None:
    """Serve the console's page until a signal to stop.

    Args:
        listen: ``HOST:PORT`` of this machine; port 0 takes a free one.
        on_ready: called with the page's address as soon as it can be opened.

    Raises:
        RequestError: the address cannot be used, or the extra ``console`` is not installed.
    """
    host, port = parse_listen(listen)
    try:
        import uvicorn

        from service.cli.console.app import make_app
    except ImportError as error:
        raise RequestError(f"the console needs {error.name}; run pip install 'scopt[console]'") from None
    try:
        taken = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        raise RequestError(
            f"--listen {listen}: {error.strerror or error}; expected a free port of this machine"
        ) from None
    config = uvicorn.Config(
        make_app(settings), log_level="warning", access_log=False, server_header=False,
        ws_max_size=MOST_MESSAGE_BYTES, ws="websockets-sansio", timeout_graceful_shutdown=2,
    )  # fmt: skip
    shown_host = f"[{host}]" if ":" in host else host
    on_ready(f"http://{shown_host}:{taken.getsockname()[1]}/")
    with taken:
        asyncio.run(uvicorn.Server(config).serve(sockets=[taken]))


def parse_listen(listen: str) -> tuple[str, int]:
    """Return host and port of an address.

    Raises:
        RequestError: it is no address of this machine.
    """
    host, _, port = listen.rpartition(":")
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise RequestError(f"--listen {shown(listen)}: expected HOST:PORT, such as 127.0.0.1:8080")
    if not is_loopback(host):
        text = "the page has no TLS of its own and is for this machine; expected 127.0.0.1, and ssh -L from elsewhere"
        raise RequestError(f"--listen {listen}: {text}")
    return host, int(port)
