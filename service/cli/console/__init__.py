"""The operator's console: a page, and the bridge between it and a planning server, which it calls as any client."""

from service.cli.console.cameras import parse_camera
from service.cli.console.serve import parse_listen, run_console
from service.cli.console.settings import ConsoleSettings

__all__ = ["ConsoleSettings", "parse_camera", "parse_listen", "run_console"]
