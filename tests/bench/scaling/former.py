# SPDX-License-Identifier: Apache-2.0
"""Cost of a run with an earlier commit's operator, by that commit's own benchmark, beside today's."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import operating

if TYPE_CHECKING:
    from collections.abc import Mapping

COMMIT = "098dbc7d"
RUNS = 2000
REPOSITORY = Path(__file__).parents[3]
_WRITES = ("create", "patch", "delete")
_OBJECTS = ("mappingruns.slamhive.io", "mappingruns.slamhive.io/status", "jobs.batch")


def beside(commit: str, runs: int, archive: str, today: Mapping[str, Any]) -> None:
    """Run the benchmark of an earlier commit, and print its figures beside today's.

    Args:
        commit: which.
        runs: how many it does, at most RUNS.
        archive: the kind of archive.
        today: the figures of this benchmark, as they are written down.
    """
    with tempfile.TemporaryDirectory() as folder:
        tree, out = Path(folder) / "tree", Path(folder) / "out"
        git = ["git", "-C", str(REPOSITORY), "worktree"]
        made = subprocess.run(
            [*git, "add", "--detach", tree, commit], check=False, capture_output=True, text=True
        )
        if made.returncode:
            print(f"beside commit {commit} · it is not here: {made.stderr.strip().splitlines()[-1]}")
            return
        try:
            program = tree / "tests/bench/scale.py"
            command = [sys.executable, program, str(min(runs, RUNS)), "--archive", archive, "--peers", "0"]
            places = os.pathsep.join(str(tree / place) for place in ("operator", "evaluator"))
            said = subprocess.run(
                [*command, "--out", out],
                check=False,
                env=os.environ | {"PYTHONPATH": places},
                cwd=tree,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            found = out / archive / "scale.json"
            if not found.exists():
                raise SystemExit(f"the benchmark of commit {commit} failed: {said.stderr[-2000:]}")
            former = json.loads(found.read_text())
        finally:
            subprocess.run([*git, "remove", "--force", tree], check=True)
        former["memory"] = peak(out / archive)
    _tell(commit, former, today)


def _tell(commit: str, former: Mapping[str, Any], today: Mapping[str, Any]) -> None:
    for what, goal, then, now in (
        (
            "CPU of the operator a run, ms",
            0.65,
            1000 * _mean(former, "operator"),
            1000 * _mean(today, "operator"),
        ),
        (
            "CPU of API server and etcd a run, ms",
            None,
            1000 * _mean(former, "server"),
            1000 * _mean(today, "server"),
        ),
        ("MiB of the operator at most", 0.65, former["memory"], today["memory"]),
        ("writes a run", 0.6, writes(former), writes(today)),
    ):
        wanted = "" if goal is None else f", goal {goal:g}"
        operating.report(
            f"{what}, beside commit {commit}", f"{now:.3g}", f"{then:.3g}: {now / then:.2f}{wanted}"
        )


def peak(folder: Path) -> float:
    """Return the most memory that an operator had by the samples in a folder, MiB."""
    with (folder / "samples.csv").open(encoding="utf-8", newline="") as file:
        return max(float(row["operator_mib"]) for row in csv.DictReader(file))


def writes(figures: Mapping[str, Any]) -> float:
    """Return the number of requests a run that made, changed or deleted it or its Jobs."""
    calls = Counter(figures["calls"])
    runs = int(calls[f"create {_OBJECTS[0]}"])
    return sum(calls[f"{verb} {kind}"] for verb in _WRITES for kind in _OBJECTS) / runs


def _mean(figures: Mapping[str, Any], name: str) -> float:
    parts = figures["parts"].values()
    return sum(part[name] * part["runs"] for part in parts) / sum(part["runs"] for part in parts)
