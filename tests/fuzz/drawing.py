# SPDX-License-Identifier: Apache-2.0
"""Draws cases from numbers, runs them within bounds of time and memory, and counts what came of them."""

from __future__ import annotations

import argparse
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CPU_SECONDS, WAITING_SECONDS = 60, 600
"""Of a case at most: computed, and by the clock, which counts what else the machine does."""
MEMORY_BYTES = 6 << 30


class FaultError(Exception):
    """Something that must not be."""


def hang(*_: object) -> NoReturn:
    """Stop what doesn't come back; the handler of both timers' signals."""
    raise TimeoutError(f"no answer within {CPU_SECONDS} s of CPU, {WAITING_SECONDS} s by the clock")


def bound(memory_bytes: int = MEMORY_BYTES) -> None:
    """Bound this process's memory, and have timers raise an error."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    signal.signal(signal.SIGALRM, hang)
    signal.signal(signal.SIGPROF, hang)


@contextmanager
def timed() -> Iterator[None]:
    """Bound the time of a case."""
    timers = {signal.ITIMER_PROF: CPU_SECONDS, signal.ITIMER_REAL: WAITING_SECONDS}
    for timer, seconds in timers.items():
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for timer in timers:
            signal.setitimer(timer, 0)


def require_sentence(text: str) -> None:
    """Check that some words can be shown to a user.

    Raises:
        FaultError: They can't.
    """
    if not text or not text.isprintable() or len(text) > 2000:
        raise FaultError(f"no sentence: {text!r}")


def run_cases(words: str, run: Callable[[random.Random, Path], str], memory_bytes: int = MEMORY_BYTES) -> int:
    """Run cases for a while, or a number of them, and say how many; the exit code.

    Args:
        words: What this is, for ``--help``.
        run: Runs the case that is drawn from a generator in an empty folder, and returns the sort of its end.
        memory_bytes: Address space that it may take.
    """
    parser = argparse.ArgumentParser(description=words)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--cases", type=int, default=None, help="so many, however long it takes")
    parser.add_argument(
        "--start", type=int, default=time.time_ns() % 2**32, help="number of the first one (default: another)"
    )
    asked = parser.parse_args()
    print(f"from --start {asked.start}", flush=True)  # noqa: T201
    bound(memory_bytes)
    ends: Counter[str] = Counter()
    failures: dict[str, str] = {}
    number, end = asked.start, time.monotonic() + asked.seconds
    with tempfile.TemporaryDirectory() as made:
        while number < asked.start + asked.cases if asked.cases is not None else time.monotonic() < end:
            folder = Path(made) / str(number)
            folder.mkdir()
            try:
                with timed():
                    ends[run(random.Random(number), folder)] += 1
            except Exception as error:  # noqa: BLE001 - that is what is looked for
                frame = traceback.extract_tb(error.__traceback__)[-1]
                kind = f"{type(error).__name__} in {Path(frame.filename).name}, line {frame.lineno}"
                told = f"{kind}: --start {number} --cases 1\n{traceback.format_exc()}"
                failures.setdefault(kind, told)
            shutil.rmtree(folder, ignore_errors=True)
            number += 1
    for failure in failures.values():
        sys.stderr.write(f"{failure}\n")
    counts = ", ".join(f"{count} {sort}" for sort, count in sorted(ends.items()))
    print(f"{number - asked.start} cases: {counts}; {len(failures)} kinds of failure")  # noqa: T201
    return 1 if failures else 0
