"""Options that several commands share."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup, TyperOption

from service.request.choices import SensorModel

CONFIG_VARIABLE = "SCOPT_CONFIG"
CONFIG = Path("~/.config/scopt/config.yaml")
Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]


@dataclass(frozen=True)
class CloudOptions:
    """Cloud files and how to read them."""

    files: Annotated[list[Path], typer.Argument(help="Point cloud files; several are merged.", metavar="CLOUD")]
    unit: Annotated[
        list[str] | None,
        typer.Option(help="Of the files' lengths: m (as by default), cm, mm, km, in, ft.", metavar="UNIT"),
    ] = None
    transforms: Annotated[
        list[str] | None,
        typer.Option(
            "--transform",
            help="Pose of the points in the world: 'X Y Z YAW PITCH ROLL' (radians), 'X Y Z QW QX QY QZ' or 16 "
            "numbers; once, or for each file.",
            metavar="NUMBERS",
        ),
    ] = None
    sensor: Annotated[
        list[str] | None, typer.Option(help="Where rays started, if the files do not say.", metavar="'X Y Z'")
    ] = None
    apply_viewpoint: Annotated[
        bool, typer.Option("--apply-viewpoint", help="The points are in the sensor's frame.")
    ] = False
    level: Annotated[
        bool, typer.Option("--level", help="Turn the cloud z up and put its floor at 0, after any transform.")
    ] = False
    sensor_model: Annotated[
        SensorModel,
        typer.Option(help="Kind of sensor, for its noise; auto: by the files, or estimated."),
    ] = "auto"
    sensor_sigma: Annotated[
        float,
        typer.Option(help="Standard deviation of where rays started, in metres.", min=0.0, max=1.0),
    ] = 0.0
    topic: Annotated[str | None, typer.Option(help="Of a bag with clouds on several topics.")] = None
    message: Annotated[
        str, typer.Option(help="Of a bag: number of the message, -1 for the last, or all.", metavar="NUMBER")
    ] = "0"
    reach_m: Annotated[float, typer.Option("--reach", help="Horizontal radius kept, in metres.", min=0.1, max=50.0)] = (
        3.0
    )
    top_m: Annotated[float, typer.Option("--top", help="Height up to which points are kept, in metres.")] = 3.0
    bottom_m: Annotated[float, typer.Option("--bottom", help="Height from which on points are kept, in metres.")] = -0.5
    robot: Annotated[
        str | None, typer.Option(help="Robot whose own points are left out: a bundled one, or a URDF.")
    ] = None
    posture: Annotated[
        Path | None, typer.Option(help="That robot's posture by name, or a file with its start (as in a request).")
    ] = None
    seed: Annotated[int, typer.Option(help="Of all random choices.", min=0)] = 0

    def __post_init__(self) -> None:
        """Raise ``typer.BadParameter`` for options that exclude each other or are repeated."""
        if self.posture is not None and self.robot is None:
            raise typer.BadParameter("--posture needs --robot")
        for option, values in (("--unit", self.unit), ("--sensor", self.sensor)):
            if values is not None and len(values) > 1:
                raise typer.BadParameter(
                    f"{option} is given {len(values)} times; it holds for all clouds, give it once"
                )

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        return [*self.files, *(Path(path) for path in (self.posture, self.robot) if path is not None)]

    def to_settings(self) -> dict[str, Any]:
        """Return the settings for ``parse_cloud_options``."""
        return {
            **asdict(self),
            "files": tuple(self.files),
            "unit": (self.unit or ["m"])[0],
            "transforms": tuple(self.transforms or ()),
            "sensor": self.sensor[0] if self.sensor else None,
        }


def read_defaults(program: TyperGroup) -> dict[str, Any]:
    """Return the defaults of options by command and parameter that the user's configuration file gives.

    The file ``$SCOPT_CONFIG``, else ``CONFIG`` if there is one, has a section for each command, with its long options
    without dashes: ``plan: {seed: 3, quiet: true}``, ``task: {run: {out: plans}}``.

    Raises:
        typer.BadParameter: the file cannot be used: not there, no mapping, an unknown command or option.
    """
    stated = os.environ.get(CONFIG_VARIABLE)
    path = (Path(stated) if stated else CONFIG).expanduser()
    if not stated and not path.is_file():
        return {}
    from service.errors import RequestError
    from service.request.plain_file import read_text, read_yaml

    try:
        data = read_yaml(read_text(path))
    except RequestError as error:
        raise typer.BadParameter(f"{path}: {error}") from None
    return _map_defaults(program, data, str(path))


def _map_defaults(command: Any, data: object, where: str) -> dict[str, Any]:
    """Return a section of the configuration with the names of parameters in place of those of options."""
    from service.errors import shown, would_do

    if not isinstance(data, Mapping):
        raise typer.BadParameter(f"{where}: expected a mapping of commands and options, got {shown(data)}")
    if isinstance(command, TyperGroup):
        commands = command.commands
        for name in data:
            if name not in commands:
                raise typer.BadParameter(f"{where}: unknown command {shown(name)}; expected {would_do(name, commands)}")
        return {name: _map_defaults(commands[name], own, f"{where}: {name}") for name, own in data.items()}
    options = {
        option.removeprefix("--"): parameter.name
        for parameter in command.params
        for option in (*parameter.opts, *parameter.secondary_opts)
        if isinstance(parameter, TyperOption) and option.startswith("--")
    }
    for name in data:
        if name not in options:
            raise typer.BadParameter(f"{where}: unknown option {shown(name)}; expected {would_do(name, list(options))}")
    return {str(options[name]): value for name, value in data.items()}


@dataclass(frozen=True)
class PlanningOptions:
    """What every command that plans on this machine takes, beside its request."""

    seed: Annotated[
        int | None, typer.Option(help="Seed of all random draws, instead of the request's.", min=0, max=2**32 - 1)
    ] = None
    time_limit: Annotated[
        float | None,
        typer.Option(help="Wall time in seconds, instead of the request's limit.", min=0.01, max=3600.0),
    ] = None
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print every check and every start that was tried.")
    ] = False
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress, and the verdict's line alone.")] = (
        False
    )

    def __post_init__(self) -> None:
        """Raise ``typer.BadParameter`` for options that exclude each other."""
        if self.verbose and self.quiet:
            raise typer.BadParameter("--verbose and --quiet exclude each other")

    @property
    def overrides(self) -> dict[str, Any]:
        """Fields of a request's ``options`` that are given here."""
        given = {"seed": self.seed, "time_limit_s": self.time_limit}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class ServerOptions:
    """Server of a client command, and the client's credentials."""

    target: Annotated[
        str, typer.Option(help="Server: HOST:PORT or unix:PATH.", envvar="SCOPT_TARGET", show_default=False)
    ]
    tls_ca: Annotated[Path | None, typer.Option(help="Authority of the server's certificate (PEM); turns TLS on.")] = (
        None
    )
    tls_cert: Annotated[
        Path | None, typer.Option(help="Certificate of this client (PEM), if the server requires one.")
    ] = None
    tls_key: Annotated[Path | None, typer.Option(help="Private key of that certificate (PEM).")] = None
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token; by default the variable SCOPT_TOKEN.")
    ] = None
