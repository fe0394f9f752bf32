"""The program ``scopt-client`` of the client's distribution: plans, their list, and verification by a server."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from service.client.blocking import PlannerClient
from service.client.errors import PlannerError
from service.errors import ServiceError
from service.proto.planner.v1.planner_pb2 import PlanState, StandingState
from service.proto.planner.v1.result_pb2 import Verdict
from service.request.file import load_request

CERTIFIED, NO_CERTIFICATE, REFUSED, UNAVAILABLE = 0, 4, 3, 69  # exit codes, as those of scopt
UNREACHABLE = ("UNAVAILABLE", "DEADLINE_EXCEEDED")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit code.  Errors are one line each."""
    given = _make_parser().parse_args(arguments)
    try:
        with PlannerClient(given.target, token=os.environ.get("SCOPT_TOKEN"), tls_ca=given.tls_ca) as client:
            code: int = given.run(client, given)
            return code
    except PlannerError as error:
        for line in error.problems:
            print(line, file=sys.stderr)
        return UNAVAILABLE if error.code.name in UNREACHABLE else REFUSED
    except (ServiceError, OSError) as error:
        for line in str(error).splitlines():
            print(line, file=sys.stderr)
        return REFUSED


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="scopt-client", description="Plans of a scopt planning server.")
    parser.add_argument("--target", default=os.environ.get("SCOPT_TARGET", "localhost:50051"), help="HOST:PORT")
    parser.add_argument("--tls-ca", help="file of the certificate authority (PEM)")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    plan = commands.add_parser("plan", help="plan a request file")
    plan.add_argument("request", type=Path)
    plan.add_argument("--out", type=Path, help="folder for the result's files")
    plan.add_argument("--request-id", help="the same id means the same plan")
    plan.set_defaults(run=_plan)
    plans = commands.add_parser("plans", help="list stored plans, newest first")
    plans.add_argument("--limit", type=int, default=50)
    plans.set_defaults(run=_list_plans)
    verify = commands.add_parser("verify", help="verify a stored plan or a result folder again")
    verify.add_argument("plan", help="id of a plan, or a folder")
    verify.set_defaults(run=_verify)
    return parser


def _plan(client: PlannerClient, given: argparse.Namespace) -> int:
    finished = client.plan(load_request(given.request), request_id=given.request_id, out=given.out)
    verdict = Verdict.Name(finished.result.verdict).removeprefix("VERDICT_")
    print(finished.plan_id, verdict, *finished.result.explanation)
    return CERTIFIED if verdict == "CERTIFIED" else NO_CERTIFICATE


def _list_plans(client: PlannerClient, given: argparse.Namespace) -> int:
    for plan in client.list_plans(limit=given.limit):
        state = PlanState.Name(plan.state).removeprefix("PLAN_STATE_")
        verdict = Verdict.Name(plan.verdict).removeprefix("VERDICT_") if plan.verdict else "-"
        print(plan.plan_id, plan.task, state, verdict, plan.created.ToJsonString())
    return 0


def _verify(client: PlannerClient, given: argparse.Namespace) -> int:
    reply = client.verify(Path(given.plan) if Path(given.plan).is_dir() else given.plan)
    state = StandingState.Name(reply.standing.state).removeprefix("STANDING_STATE_")
    print(given.plan, state)
    return CERTIFIED if state == "HOLDS" else NO_CERTIFICATE


if __name__ == "__main__":
    sys.exit(main())
