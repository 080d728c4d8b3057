# SPDX-License-Identifier: Apache-2.0
"""Edit to answer: seconds from saving an algorithm's file to its first figure beside the one before.

By `slamhive run`, by `slamhive run --watch`, and by hand: the adapter on the same prepared recording in the
same environment, then evo_ape. All three run the same algorithm once on 10 s of LiDAR; the first round, which
makes dataset and environment, is not counted.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench_evaluator import peer_python

if TYPE_CHECKING:
    from collections.abc import Iterator

EDITS = 5
COMMAND = (sys.executable, "-c", "from slamhive.cli.main import main; main()")
MANIFEST = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: short}
spec:
  recording:
    synthetic: {sensors: [Lidar], durationSeconds: 10, loops: 0.3, lidar: {rings: 8, columns: 120}}
---
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: day}
spec:
  template: {spec: {algorithmRef: {name: mine}, datasetRef: {name: short}}}
"""


class Desk:
    """A home with an algorithm of one's own, and a sweep of one run that has been run.

    Args:
        folder: an empty folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.home = folder / "home"
        self.environment = os.environ | {"SLAMHIVE_HOME": str(self.home)}
        (folder / "day.yaml").write_text(MANIFEST)
        self._call("algorithm", "new", "mine", "--from", "lidar-python")
        self._call("run", "day.yaml")
        self.edits = 0

    def edit(self) -> float:
        """Save the algorithm with another comment in it; return the time."""
        self.edits += 1
        with (self.folder / "mine" / "odometry.py").open("a") as file:
            file.write(f"# edit {self.edits}\n")
        return time.perf_counter()

    def _call(self, *words: str) -> None:
        subprocess.run(
            [*COMMAND, *words], cwd=self.folder, env=self.environment, check=True, capture_output=True
        )

    @contextmanager
    def running(self, *options: str) -> Iterator[subprocess.Popen[str]]:
        """Run the sweep, its lines of JSON to be read from standard output."""
        command = [*COMMAND, "run", "day.yaml", "--log-format", "json", *options]
        with subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as process:
            try:
                yield process
            finally:
                process.terminate()


def compared(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Read on until a run has ended that has a figure from before an edit; return what is said of it."""
    for line in process.stdout or ():
        told: dict[str, Any] = json.loads(line)
        if told["event"] == "run" and told["ateBefore"] is not None:
            return told
    raise SystemExit("no run was compared with the one before the edit")


def by_command(desk: Desk) -> tuple[float, float]:
    """Return the seconds from an edit to its figure by `slamhive run`, and those of the program in them."""
    began = desk.edit()
    with desk.running() as process:
        told = compared(process)
        return time.perf_counter() - began, told["wallSeconds"]


def by_watching(desk: Desk) -> list[tuple[float, float]]:
    """Return the same of some edits while `slamhive run --watch` is there."""
    took = []
    with desk.running("--watch") as process:
        for line in process.stdout or ():
            if json.loads(line)["event"] == "end":
                break
        for _ in range(EDITS):
            began = desk.edit()
            told = compared(process)
            took.append((time.perf_counter() - began, told["wallSeconds"]))
    return took


def by_hand(desk: Desk, evo: Path) -> float:
    """Return the seconds from an edit to evo_ape's figure by two commands in a script."""
    before = next(desk.home.glob("runs/day/*/run/config.yaml")).parent
    scratch = desk.folder / "by-hand"
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    shutil.copy(before / "config.yaml", scratch)
    (scratch / "dataset").symlink_to((before / "dataset").resolve())
    (scratch / "output").mkdir()
    python = next(desk.home.glob("environments/*/bin/python"))
    truth = next(desk.home.glob("datasets/short-*/groundtruth.txt"))
    began = desk.edit()
    environment = desk.environment | {"SLAMHIVE_RUN": str(scratch), "SLAMHIVE_SEED": "1"}
    adapter = [python, desk.folder / "mine" / "adapter.py"]
    subprocess.run(adapter, cwd=scratch, env=environment, check=True, capture_output=True)
    estimate = scratch / "output" / "trajectory.txt"
    ape = [str(word) for word in (evo.with_name("evo_ape"), "tum", truth, estimate, "-a")]
    subprocess.run(ape, check=True, capture_output=True)
    return time.perf_counter() - began


def report(what: str, took: list[tuple[float, float]], hand: str) -> None:
    """Print the median beside that by hand."""
    seconds = statistics.median(one for one, _ in took)
    alone = statistics.median(one for _, one in took)
    print(f"{what} · {seconds:.1f} s, of them {alone:.1f} s the algorithm · {hand}", flush=True)


def main() -> int:
    """Print the seconds of each way, edits of all ways in turn."""
    peer = peer_python()
    with tempfile.TemporaryDirectory() as name:
        desk = Desk(Path(name))
        fresh, hand = [], []
        for _ in range(EDITS):
            fresh.append(by_command(desk))
            if peer is not None:
                hand.append(by_hand(desk, peer))
        beside = "evo not installable"
        if hand:
            beside = f"by hand {statistics.median(hand):.1f} s (adapter.py, evo_ape)"
        report("from an edit to its first compared figure, slamhive run", fresh, beside)
        report("the same with slamhive run --watch", by_watching(desk), beside)
    return 0


if __name__ == "__main__":
    sys.exit(main())
