"""Put small errors into the code, one at a time, and list those that no fast test notices.

``python -m benchmarks.mutants [GROUP ...] [--count N] [--seed N | --fresh] [--minutes M]``. The lines that each fast
test runs are recorded once (``recording``). A mutant is made in a copy of the project and given to the tests that run
its line, the quickest first, in a fork of a process that has everything imported (``judge``). ``equivalent.txt`` lists
mutants that change nothing, with the reason. Tools of this kind (mutmut, cosmic-ray) start anew for each mutant, which
takes longer here than the tests.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

from benchmarks.mutants.judge import CRASH, TIMED_OUT
from benchmarks.mutants.mutations import Mutant, list_mutants
from benchmarks.mutants.recording import Recording, record
from benchmarks.tables import print_table

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("SCOPT_DATA", ROOT.parent / "shared" / "data"))
EQUIVALENT = Path(__file__).parent / "equivalent.txt"
# Folders of each group.
GROUPS: dict[str, tuple[str, ...]] = {
    "scopt": ("scopt",),
    "costs": ("costs",),
    "verify": ("service/verify",),
    "planner": ("service/tasks", "service/body", "service/demands"),
    "timing": ("service/motion",),
    "trust": ("service/trust",),
    "store": ("service/store",),
}
# Processor time of the tests of a mutant, which may never end: this much, and a multiple of what they took once.
LEAST_S, SLOWER = 10.0, 5.0
NOT_COPIED = (".*", "__pycache__", "node_modules", "*.egg-info", "out", "site")


@dataclass
class Tally:
    """What became of a group's mutants.

    ``equivalent`` ones change nothing and are not tried; for ``untried`` ones the time was too short.
    """

    killed: int = 0
    timed_out: int = 0
    equivalent: int = 0
    untried: int = 0
    survivors: list[str] = field(default_factory=list)

    @property
    def tried(self) -> int:
        """Number of mutants that were given to tests."""
        return self.killed + self.timed_out + len(self.survivors)

    @property
    def share(self) -> str:
        """Share of mutants that tests noticed."""
        return f"{100 * (self.killed + self.timed_out) / self.tried:.0f} %" if self.tried else "-"


class Copy:
    """Copy of a project in which one file at a time is wrong, and a process that judges what its tests notice.

    Attributes:
        broken: tests that fail without any mutant, and are left out.
    """

    def __init__(self, project: Path, root: Path) -> None:
        self.project, self.root = project, root
        self.broken: set[str] = set()
        self._sound: set[str] = set()  # tests that have passed without any mutant
        self._changes = 0
        shutil.copytree(project, root, ignore=shutil.ignore_patterns(*NOT_COPIED), dirs_exist_ok=True)

    @contextmanager
    def open(self, modules: Sequence[str] = ()) -> Iterator[Self]:
        """Start the process, with some modules imported, for as long as the body runs."""
        command = [sys.executable, "-m", "benchmarks.mutants.judge"]
        paths = os.pathsep.join(map(str, (self.root, ROOT)))
        environment = {**os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "SCOPT_DATA": str(DATA)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        pipe = subprocess.PIPE
        with subprocess.Popen(command, cwd=self.root, env=environment, stdin=pipe, stdout=pipe, text=True) as process:
            self._process = process
            helpers = sorted(folder for folder in (self.root / "tests" / "support").rglob("*") if folder.is_dir())
            self._ask({"modules": list(modules), "paths": [str(self.root / "tests" / "support"), *map(str, helpers)]})
            yield self

    def judge(self, mutant: Mutant, tests: Sequence[tuple[str, float]], least_s: float = LEAST_S) -> str:
        """Return the first test that notices a mutant, or how it ended otherwise; an empty text if none does.

        Args:
            mutant: of a file of the project.
            tests: with the seconds that each takes; those that fail anyway notice nothing.
            least_s: processor time that they may take at least.
        """
        old = (self.project / mutant.path).read_bytes()
        order = {"path": mutant.path, "old": old.decode()}
        self._write(mutant.path, mutant.apply(old))
        try:
            while True:
                names = [name for name, _ in tests if name not in self.broken]
                if not names:
                    return ""
                cpu_s = least_s + SLOWER * sum(seconds for _, seconds in tests)
                limited = {**order, "tests": names, "cpu_s": cpu_s}
                failure = self._ask(limited) or self._ask({**limited, "is_fresh": True})
                if failure in ("", CRASH, TIMED_OUT) or failure in self._sound:
                    return failure
                self._write(mutant.path, old)
                alone = {**limited, "tests": [failure]}
                is_sound = self._ask(alone) == self._ask({**alone, "is_fresh": True}) == ""
                (self._sound if is_sound else self.broken).add(failure)
                self._write(mutant.path, mutant.apply(old))
        finally:
            self._write(mutant.path, old)

    def _ask(self, order: Mapping[str, Any]) -> str:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        return str(json.loads(self._process.stdout.readline()))

    def _write(self, path: str, text: bytes) -> None:
        """Write a file as if at another time than before, or its bytecode would be taken for that of the new text."""
        file = self.root / path
        file.write_bytes(text)
        self._changes += 1
        os.utime(file, (self._changes, self._changes))


def read_equivalents(file: Path = EQUIVALENT) -> dict[tuple[str, str], str]:
    """Return the reasons of the mutants that change nothing, by path and by the changed line as it was and becomes."""
    entries = [entry.split("\n") for entry in file.read_text().strip().split("\n\n") if not entry.startswith("#")]
    return {(path, f"{old}\n{new}"): reason for path, old, new, reason in (map(str.strip, entry) for entry in entries)}


def find_reason(mutant: Mutant, known: Mapping[tuple[str, str], str], root: Path = ROOT) -> str | None:
    """Return why a mutant changes nothing; None if it is not known to."""
    source = (root / mutant.path).read_bytes()
    number = source[: mutant.start].count(b"\n")
    old, new = (text.decode().splitlines()[number].strip() for text in (source, mutant.apply(source)))
    return known.get((mutant.path, f"{old}\n{new}"))


def draw_mutants(paths: tuple[str, ...], count: int, seed: int, root: Path = ROOT) -> list[Mutant]:
    """Return a sample of the mutants of all files in some folders, the same for the same seed."""
    files = sorted(file for path in paths for file in (root / path).rglob("*.py"))
    mutants = [each for file in files for each in list_mutants(str(file.relative_to(root)), file.read_bytes())]
    return random.Random(seed).sample(mutants, min(count, len(mutants)))


def try_group(copy: Copy, recording: Recording, name: str, count: int, seed: int, end: float) -> Tally:
    """Give a sample of a group's mutants to the tests that run them, until ``end`` of the monotonic clock."""
    tally = Tally()
    known = read_equivalents()
    for mutant in draw_mutants(GROUPS[name], count, seed):
        if time.monotonic() > end:
            tally.untried += 1
            continue
        if (reason := find_reason(mutant, known)) is not None:
            tally.equivalent += 1
            print(f"{mutant}: changes nothing: {reason}", flush=True)
            continue
        tests = recording.find_tests(mutant.path, mutant.line)
        failure = copy.judge(mutant, tests)
        if failure == TIMED_OUT:
            tally.timed_out += 1
        elif failure:
            tally.killed += 1
        else:
            tally.survivors.append(f"{mutant} ({len(tests)} tests run it)")
        print(f"{mutant}: {failure or 'SURVIVED'}", flush=True)
    return tally


def main() -> None:
    """Try the groups one after another and print the share that is noticed, and all survivors."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)}; default all")
    parser.add_argument("--count", type=int, default=300, help="mutants of each group")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--fresh", action="store_true", help="a sample that nobody has seen")
    parser.add_argument("--tests", nargs="+", default=["tests"], help="files and folders of tests")
    parser.add_argument("--minutes", type=float, default=60.0, help="for all groups together")
    options = parser.parse_args()
    if unknown := set(options.groups) - set(GROUPS):
        parser.error(f"unknown group {sorted(unknown)[0]!r}; expected {', '.join(GROUPS)}")
    seed = random.SystemRandom().randrange(10**6) if options.fresh else options.seed
    names, began = options.groups or list(GROUPS), time.monotonic()
    tallies = {}
    with TemporaryDirectory(prefix="mutants-") as folder:
        copy = Copy(ROOT, Path(folder))
        recording = record(copy.root, ROOT / "out" / "mutants", tuple(options.tests))
        with copy.open(recording.modules):
            for number, name in enumerate(names, start=1):
                end = began + 60.0 * options.minutes * number / len(names)
                tallies[name] = try_group(copy, recording, name, options.count, seed, end)
    header = ["group", "tried", "noticed", "of them timed out", "survived", "change nothing", "not tried"]
    columns = [(t.tried, t.share, t.timed_out, len(t.survivors), t.equivalent, t.untried) for t in tallies.values()]
    rows = [[name, *map(str, column)] for name, column in zip(tallies, columns, strict=True)]
    print_table(f"Mutants (seed {seed})", header, rows)
    for tally in tallies.values():
        print(*tally.survivors, sep="\n")
    if copy.broken:
        print(f"left out, since they fail without any mutant: {', '.join(sorted(copy.broken))}")


if __name__ == "__main__":
    main()
