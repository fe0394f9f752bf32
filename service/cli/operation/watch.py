"""``scopt watch``: what the robot of a server does, once or until Ctrl-C."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command import command
from service.cli.options import Json, ServerOptions
from service.cli.run import consoles, print_json

if TYPE_CHECKING:
    from service.proto.planner.v1.execution_pb2 import WatchResponse


@command()
def watch_command(
    server: ServerOptions,
    once: Annotated[bool, typer.Option("--once", help="Print the state once.")] = False,
    rate: Annotated[float, typer.Option(help="Greatest number of states a second.", min=0.01, max=50.0)] = 2.0,
    as_json: Json = False,
) -> None:
    """Show what the robot of a server does: mode, phase, clock, reasons, who has control.

    With --once --json the whole state is printed, poses and forces too.
    """
    from service.cli.connect import connect

    stdout, stderr = consoles()
    with connect(server, stderr, attempts=1) as client:
        states = client.watch(rate_hz=rate)
        try:
            for state in states:
                if as_json:
                    print_json(state_to_json(state))
                else:
                    stdout.print(describe_state(state), markup=False, soft_wrap=True)
                if once or as_json:
                    return
        except KeyboardInterrupt:
            return
        finally:
            states.close()


def read_mode(state: WatchResponse) -> str:
    """Return the mode of a robot, such as ``running``."""
    from service.proto.planner.v1.execution_pb2 import ExecutionMode

    return ExecutionMode.Name(state.status.mode).removeprefix("EXECUTION_MODE_").lower()


def describe_state(state: WatchResponse) -> str:
    """Return one line on a robot's state."""
    holder = f"{state.control.name} {state.control.station}".strip() or "nobody"
    parts = [f"{state.revision:4d}  {read_mode(state):9}"]
    if state.plan.plan_id:
        clock = f"{state.pose.clock_s:.2f} of {state.plan.duration_s:.2f} s"
        parts.append(f"{state.status.phase or 'no phase'}, {clock}, plan {state.plan.plan_id}")
    parts.append(f"control: {holder}")
    parts += [text for text in (state.status.reason, *state.status.findings) if text]
    return "  ".join(parts)


def state_to_json(state: WatchResponse) -> dict[str, Any]:
    """Return a robot's state as JSON data."""
    from google.protobuf.json_format import MessageToDict

    data = MessageToDict(state, preserving_proto_field_name=True, always_print_fields_with_no_presence=True)
    data["status"]["mode"] = read_mode(state)
    data["revision"] = state.revision
    del data["is_snapshot"]
    return data
