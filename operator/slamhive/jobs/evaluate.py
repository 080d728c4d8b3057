# SPDX-License-Identifier: Apache-2.0
"""Program of the evaluator's Job: measures finished runs, or lays out their folders for another evaluator.

``python3 -P -m slamhive.jobs.evaluate [--links]``. Results go to ``output/results.jsonl``, which is whole
when it exists, and to stdout as lines of `slamhive.jobs.lines`, each as soon as it is there.
"""

from __future__ import annotations

import json
import os
import sys
from typing import TYPE_CHECKING, Any

from slamhive.contract.environment import THREAD_VARIABLES
from slamhive.jobs.lines import encode
from slamhive.jobs.program import arguments, parse, read_request, run_program, write_aside

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from slamhive.jobs.requests import EvaluateRequest

RESULTS = "results.jsonl"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure the runs of the request."""
    parser = arguments("Measure finished runs.")
    parser.add_argument("--links", action="store_true", help="lay out run folders for another evaluator")
    parser.add_argument("--processes", type=int, help="runs measured at a time (default: processors)")
    parser.add_argument("--memory", type=int, help="bytes that they may take (default: the container's)")
    options = parser.parse_args(argv)
    # All processors are busy with runs; numpy reads these when it is imported.
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    if options.links:
        return run_program(lambda: _link(options.root))
    return run_program(lambda: _evaluate(options.root, options.processes, options.memory))


def _request(root: Path) -> EvaluateRequest:
    from slamhive.jobs.requests import EvaluateRequest  # noqa: PLC0415 - imports numpy

    return parse(EvaluateRequest, read_request(root), "request")


def _evaluate(root: Path, processes: int | None, memory: int | None) -> str:
    from slamhive.jobs.batch import Bench, measure_all, read_truths  # noqa: PLC0415 - imports numpy

    request = _request(root)
    runs = request.runs
    truths = read_truths(root / "groundtruth", _datasets(runs))
    bench = Bench(root / "results", request.settings, request.evaluation, truths)
    failures = 0

    def fill(aside: Path) -> None:
        nonlocal failures
        with aside.open("w", encoding="ascii") as file:
            for number, line in enumerate(measure_all(bench, runs, processes, memory)):
                failures += "error" in line
                file.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")
                sys.stdout.write(encode(number, len(runs), line))
                sys.stdout.flush()

    write_aside(root / "output" / RESULTS, fill)
    return json.dumps({"v": 1, "runs": len(runs), "failed": failures})


def _datasets(runs: Sequence[dict[str, Any]]) -> list[str]:
    """Return the datasets named, but not what is no name: that is told run by run."""
    names = [run.get("dataset") for run in runs]
    return [name for name in names if isinstance(name, str) and "/" not in name]


def _link(root: Path) -> str:
    """Make ``runs/NAME`` lead to each run's folder."""
    from slamhive.jobs.requests import RunItem  # noqa: PLC0415 - imports numpy

    folder = root / "runs"
    folder.mkdir(exist_ok=True)
    request = _request(root)
    for item in request.runs:
        run = parse(RunItem, item, f"run {item.get('name')}")
        link = folder / run.name
        link.unlink(missing_ok=True)
        link.symlink_to(f"../results/{run.folder}")
    return json.dumps({"v": 1, "runs": len(request.runs)})


if __name__ == "__main__":
    sys.exit(main())
