# SPDX-License-Identifier: Apache-2.0
"""Program of a Job for runs whose monitor left no termination message: makes it from the run's summary.

Where nobody knows the run's last pod, its folder is the one whose configuration was written last: a monitor
does so before its algorithm starts, and a run never has two pods at once.
"""

from __future__ import annotations

import json
import os
import re
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from slamhive.jobs.opening import read_bytes
from slamhive.jobs.program import arguments, parse, read_request, run_program
from slamhive.jobs.requests import ReadRequest
from slamhive.model.errors import DataError
from slamhive.monitor.pod.termination import termination_message

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_RUN = re.compile(r"runs/[0-9A-Za-z-]+")
_PATH = re.compile(r"runs/[^/]+/[^/]+/summary\.json")
_BYTES = 4 << 20


def main(argv: Sequence[str] | None = None) -> int:
    """Read the summary that the request names."""
    options = arguments("Read a run's summary.").parse_args(argv)
    return run_program(lambda: _work(options.root))


def _work(root: Path) -> str:
    path = parse(ReadRequest, read_request(root), "request").path
    pod = None
    if _RUN.fullmatch(path):
        pod = _last_pod(root / "results" / path)
        path = f"{path}/{pod}/summary.json"
    if not _PATH.fullmatch(path):
        raise DataError(f"request.path: {path!r} is not like runs/UID/POD/summary.json or runs/UID")
    text = read_bytes(root / "results", path, _BYTES)
    try:
        summary = json.loads(text)
    except (ValueError, RecursionError):
        summary = None
    if not isinstance(summary, dict):
        raise DataError(f"{path} is no JSON object")
    try:
        return termination_message(summary | ({"pod": pod} if pod else {})).decode()
    except (ValueError, RecursionError):
        raise DataError(
            f"{path} holds what JSON has no form for, such as a number that is not finite"
        ) from None


def _last_pod(folder: Path) -> str:
    """Return the name of a run's folder in which a monitor began last."""
    begun: dict[str, int] = {}
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):
                begun[entry.name] = os.lstat(folder / entry.name / "config.yaml").st_mtime_ns
    if not begun:
        raise DataError(f"runs/{folder.name} holds nothing that a monitor wrote")
    return max(begun, key=lambda name: begun[name])


if __name__ == "__main__":
    sys.exit(main())
