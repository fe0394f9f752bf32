"""Pictures of a robot's cameras over HTTP, for this machine: ``GET /NAME.png``, marks in the header ``X-Marks``."""

from __future__ import annotations

import json
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

from service.errors import ExecutionError, RequestError
from service.simulation.pictures import CameraPicture

MARKS = "X-Marks"
Take = Callable[[str], CameraPicture]


class PictureServer:
    """A server of pictures in a thread of its own.

    Args:
        port: of this machine; 0 takes any free one.
        make: called in that thread; returns what takes a picture by a camera's name. That raises KeyError for an
            unknown name, and ExecutionError where there is nothing to see.

    Raises:
        RequestError: the port is in use.
    """

    def __init__(self, port: int, make: Callable[[], Take]) -> None:
        taker: list[Take] = []

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:  # named by the library
                try:
                    picture = taker[0](self.path.strip("/").removesuffix(".png"))
                except KeyError:
                    self.send_error(404, "there is no such camera")
                except ExecutionError as error:
                    self.send_error(503, str(error))
                else:
                    self.send_response(200)
                    self.send_header("Content-Type", "image/png")
                    self.send_header("Content-Length", str(len(picture.png)))
                    self.send_header(MARKS, json.dumps(picture.marks))
                    self.end_headers()
                    self.wfile.write(picture.png)

            def log_message(self, format: str, *args: object) -> None:
                pass

        try:
            self._server = HTTPServer(("127.0.0.1", port), Handler)
        except OSError as error:
            raise RequestError(f"--robot sim: pictures {port}: {error.strerror}; expected a free port") from None

        def serve() -> None:
            taker.append(make())
            self._server.serve_forever()

        self.port = int(self._server.server_address[1])
        Thread(target=serve, name="pictures", daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
