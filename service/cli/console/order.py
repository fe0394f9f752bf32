"""An order of the page: its arguments, what carries it out, and what all pages share."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic.dataclasses import dataclass as checked

from service.cli.console.sessions import OperatorSession, Sessions
from service.cli.console.settings import ConsoleSettings
from service.request.fields import SECTION, Section
from service.request.file import parse_section

T = TypeVar("T")


class Console:
    """What all pages of a console share."""

    def __init__(self, settings: ConsoleSettings) -> None:
        self.settings = settings
        self.sessions = Sessions(settings)


@checked(config=SECTION)
class Nothing(Section):
    """Arguments of orders that have none."""


@dataclass(frozen=True)
class PageOrder(Generic[T]):
    """An order with its arguments and what carries it out; the result is JSON-ready."""

    arguments: type[T]
    act: Callable[[Console, OperatorSession, T], Awaitable[Any]]

    async def carry_out(self, console: Console, session: OperatorSession, arguments: Mapping[str, Any]) -> Any:
        """Check the arguments and carry the order out.

        Raises:
            RequestError: an argument is missing, unknown or wrong.
            PlannerError: the server refuses, or does not answer.
        """
        return await self.act(console, session, parse_section(self.arguments, arguments))
