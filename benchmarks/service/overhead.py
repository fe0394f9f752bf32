"""Overhead of a request: the client's wall time minus the planner's own, one request after the other."""

from __future__ import annotations

from pathlib import Path

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, ms, percentile, spread
from benchmarks.service.load import Load, generating
from benchmarks.service.servers import started

TARGET_S = 3e-3
WARM_UP = 20


def measure(options: Options, folder: Path) -> list[Figure]:
    """Measure the overhead on plans of 50 ms."""
    n = WARM_UP + options.count(400, 30)
    with started(folder, workers=1) as server:
        request = asks.plan_request(asks.ELBOW).SerializeToString()
        with generating(Load(server.address, request, "overhead", clients=1, requests=n)) as load:
            calls = load.result()[WARM_UP:]
    planned = [call.planned_s for call in calls if call.verdict == "CERTIFIED"]
    beyond = [call.took - call.planned_s for call in calls if call.verdict == "CERTIFIED"]
    median = percentile(beyond, 50)
    return [
        Figure(
            f"overhead of the service on a plan of {ms(percentile(planned, 50))} ({len(beyond)} plans)",
            f"median <= {ms(TARGET_S)}",
            spread(beyond),
            median <= TARGET_S,
        )
    ]
