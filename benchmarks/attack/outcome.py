"""An attack and its outcome."""

from __future__ import annotations

import enum
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

IDLE = 10.0  # times its processor time that an attack may take on the clock
MOST_S = 90  # of processor time that an attack may take; nothing here asks for more than 20 s of planning


class Answer(enum.Enum):
    """Answer to false data, or to honest data that looks false."""

    REFUSED = "refused"
    """An error that names what is wrong."""
    REPORTED = "reported"
    """A verdict other than CERTIFIED, or CERTIFIED with a note that names the false data."""
    TRUE = "true"
    """Correctly CERTIFIED: a harmless edit, or a claim that independent code confirms."""
    BELIEVED = "BELIEVED"
    """CERTIFIED although the data are false."""
    ALARM = "FALSE ALARM"
    """A harmless edit was not certified."""
    CRASHED = "CRASHED"
    """An unexpected error, or a process that died."""


FAILED = (Answer.BELIEVED, Answer.ALARM, Answer.CRASHED)


@dataclass(frozen=True)
class Attack:
    """One attack.

    Attributes:
        kind: row of the table.
        name: of the attack.
        run: carries it out in a given folder; returns the answer and one sentence.
        is_short: whether the short version has it.
        most_s: processor time that it may take [s].
    """

    kind: str
    name: str
    run: Callable[[Path], tuple[Answer, str]]
    is_short: bool = True
    most_s: int = MOST_S

    @property
    def label(self) -> str:
        """Kind and name, unique among all attacks."""
        return f"{self.kind}: {self.name}"


@dataclass(frozen=True)
class Outcome:
    """Outcome of an attack in one sentence, and its processor time."""

    kind: str
    name: str
    answer: Answer
    text: str
    cpu_s: float = 0.0

    @property
    def has_failed(self) -> bool:
        """Whether scopt believed false data, refused honest data or crashed."""
        return self.answer in FAILED


def carry_out(attack: Attack) -> Outcome:
    """Run an attack in a new folder; an unexpected error counts as a crash."""
    began = time.process_time()
    with tempfile.TemporaryDirectory(prefix="attack-") as scratch:
        try:
            with _no_longer_than(attack.most_s):
                answer, text = attack.run(Path(scratch))
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            line = " ".join(str(error).split())[:200]
            text = f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {line}"
            answer = Answer.CRASHED
    return Outcome(attack.kind, attack.name, answer, text, time.process_time() - began)


@contextmanager
def _no_longer_than(seconds: int) -> Iterator[None]:
    """Raise ``TimeoutError`` in the body once the processor time is up, or ten times that on the clock."""

    def ring(number: int, frame: object) -> None:
        raise TimeoutError(f"no answer within {seconds} s")

    timers = ((signal.SIGPROF, signal.ITIMER_PROF, 1.0), (signal.SIGALRM, signal.ITIMER_REAL, IDLE))
    before = {number: signal.signal(number, ring) for number, _, _ in timers}
    for _, timer, factor in timers:
        signal.setitimer(timer, factor * seconds)
    try:
        yield
    finally:
        for _, timer, _ in timers:
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
