"""``scopt token``: an access token of a server's client."""

from __future__ import annotations

from typing import Annotated

import typer

from service.cli.command import command


@command()
def token_command(
    name: Annotated[str, typer.Argument(help="Of the client.", metavar="NAME")],
    role: Annotated[
        list[str], typer.Option(help="plan, review, execute, command or admin; may be given again.", metavar="ROLE")
    ],
) -> None:
    """Make a token: it is printed once, with the lines that the server's --tokens file needs."""
    from service.errors import RequestError, would_do
    from service.trust import Role, make_token

    known = [known_role.value for known_role in Role]
    for name_of_role in role:
        if name_of_role not in known:
            raise RequestError(f"--role: unknown role {name_of_role!r}; expected {would_do(name_of_role, known)}")
    token, lines = make_token(name, [Role(name_of_role) for name_of_role in role])
    typer.echo(token)
    typer.echo(lines, err=True)
