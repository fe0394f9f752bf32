"""Number of the formats that scopt writes: request data, results, certificates and the promises that they hash.

One number for all of them.  It rises with the first change after a release; what each number brought is in the tables
of ``service.request.versions`` (fields of requests), ``service.result.versions`` (keys of results),
``service.verify.hashes`` (promises) and ``service.replay.standing`` (checks), and in docs/result-format.md.
"""

from __future__ import annotations

RELEASES = {1: "0.2.0", 2: "0.3.0", 3: "0.4.0"}
"""First release that wrote each format."""

FORMAT = max(RELEASES)
