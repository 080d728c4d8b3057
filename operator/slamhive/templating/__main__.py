# SPDX-License-Identifier: Apache-2.0
"""`python -m slamhive.templating`: renders what standard input asks for, bounded by the kernel.

Before each file its number is written to standard error, so that whoever sees this process killed knows
which one it was at.
"""

from __future__ import annotations

import json
import math
import resource
import signal
import sys

from slamhive.contract.files import memory_bounded
from slamhive.model.templates import TemplateMistake
from slamhive.templating.process import MEMORY_BYTES, MEMORY_TEXT
from slamhive.templating.rendering import OutOfTime, Renderer


def main() -> int:
    """Render, and write the texts or what is wrong as JSON; return the exit code."""
    request = json.loads(sys.stdin.buffer.read())
    answer: dict[str, object] = {"texts": (texts := [])}
    _bound_time(request["seconds"])
    index = 0
    with memory_bounded(MEMORY_BYTES):
        try:
            told, run, files = request["told"], request["run"], request["files"]
            renderer = Renderer(told, run, files, request["time"], MEMORY_TEXT)
            for index, template in enumerate(request["templates"]):
                sys.stderr.write(f"{index}\n")
                sys.stderr.flush()
                texts.append(renderer.text(template))
        except TemplateMistake as mistake:
            answer = {"file": index, "problem": str(mistake)}
    sys.stdout.buffer.write(json.dumps(answer, ensure_ascii=False).encode("utf-8", "surrogatepass"))
    sys.stdout.flush()
    return 0


def _bound_time(seconds: float) -> None:
    """Have an exception raised when the time is used up, and the process killed a second or two later."""

    def end(_signal: int, _frame: object) -> None:
        raise OutOfTime

    used = resource.getrusage(resource.RUSAGE_SELF)
    signal.signal(signal.SIGPROF, end)
    # It comes again: an exception in a destructor, which Python drops, is not the last.
    signal.setitimer(signal.ITIMER_PROF, seconds, 0.5)
    hard = math.ceil(used.ru_utime + used.ru_stime + seconds) + 1
    _, known = resource.getrlimit(resource.RLIMIT_CPU)
    hard = hard if known == resource.RLIM_INFINITY else min(hard, known)
    resource.setrlimit(resource.RLIMIT_CPU, (hard, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    sys.exit(main())
