# SPDX-License-Identifier: Apache-2.0
"""`python -m slamhive.sampling`: answers questions for proposals, a line of JSON each.

The kernel bounds it. Its standard output is the answers' alone: what a library prints goes to standard error.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
import warnings

from slamhive.monitor.measuring.bounded import limit
from slamhive.sampling.limits import CPU_SECONDS, MEMORY_BYTES
from slamhive.sampling.suggesting import suggest


def main() -> int:
    """Answer until nothing more is asked; return the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who asks
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    limit(CPU_SECONDS, MEMORY_BYTES)
    for line in sys.stdin.buffer:
        limit(CPU_SECONDS)
        answer: dict[str, object]
        try:
            answer = {"found": suggest(json.loads(line))}
        except MemoryError:
            answer = {"problem": f"it takes more than {MEMORY_BYTES >> 20} MiB of memory"}
        except Exception as error:  # noqa: BLE001 - told to who asked
            last = traceback.extract_tb(error.__traceback__)[-1]
            answer = {"problem": f"{type(error).__name__}: {error} ({last.name}, line {last.lineno})"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
