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
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable

HANG_SECONDS = 60
MEMORY_BYTES = 6 << 30


class FaultError(Exception):
    """Something that must not be."""


def hang(*_: object) -> NoReturn:
    """Stop what doesn't come back; the handler of the alarm signal."""
    raise TimeoutError(f"no answer within {HANG_SECONDS} s")


def bound(memory_bytes: int = MEMORY_BYTES) -> None:
    """Bound this process's memory, and have alarms raise an error."""
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    signal.signal(signal.SIGALRM, hang)


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
            signal.alarm(HANG_SECONDS)
            try:
                ends[run(random.Random(number), folder)] += 1
            except Exception as error:  # noqa: BLE001 - that is what is looked for
                frame = traceback.extract_tb(error.__traceback__)[-1]
                kind = f"{type(error).__name__} in {Path(frame.filename).name}, line {frame.lineno}"
                told = f"{kind}: --start {number} --cases 1\n{traceback.format_exc()}"
                failures.setdefault(kind, told)
            finally:
                signal.alarm(0)
            shutil.rmtree(folder, ignore_errors=True)
            number += 1
    for failure in failures.values():
        sys.stderr.write(f"{failure}\n")
    counts = ", ".join(f"{count} {sort}" for sort, count in sorted(ends.items()))
    print(f"{number - asked.start} cases: {counts}; {len(failures)} kinds of failure")  # noqa: T201
    return 1 if failures else 0
