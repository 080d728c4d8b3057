# SPDX-License-Identifier: Apache-2.0
"""`python -m slamhive.monitor --spec FILE`: run one algorithm and tell what it used.

The summary is printed too: whoever started us needs no file that the algorithm can write.

Exit codes: 0, summary.json says how the run ended; 1, no summary could be written; 2, wrong specification.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from slamhive.monitor.measuring.processes import forbid_inspection, read_file
from slamhive.monitor.spec import SpecError, SupervisorSpec
from slamhive.monitor.supervisor import Supervisor

_USAGE = "usage: python -m slamhive.monitor --spec FILE"


def main(arguments: list[str]) -> int:
    """Supervise the run a file describes and return the exit code."""
    forbid_inspection()
    if arguments in (["-h"], ["--help"]):
        sys.stdout.write(f"{_USAGE}\n{__doc__}")
        return 0
    if len(arguments) != 2 or arguments[0] != "--spec":
        sys.stderr.write(f"{_USAGE}\n")
        return 2
    try:
        spec = SupervisorSpec.from_json(read_file(arguments[1]))
    except (SpecError, OSError) as error:
        sys.stderr.write(f"{arguments[1]}: {error.strerror if isinstance(error, OSError) else error}\n")
        return 2
    try:
        summary = Supervisor(spec).run()
        with suppress(BrokenPipeError):
            sys.stdout.write(summary.to_json())
            sys.stdout.flush()
    except OSError as error:
        sys.stderr.write(f"the run can't be supervised: {error.strerror}: {error.filename}\n")
        return 1
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # skips the interpreter's clean-up, 3 ms a run
