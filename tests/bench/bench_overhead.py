# SPDX-License-Identifier: Apache-2.0
"""Benchmark of what slamhive adds to a run: one-second programs through the command, and in a shell loop.

The program is the tests' actor: it sleeps for a second and writes a trajectory, which `slamhive run` also
prepares a recording for, supervises, measures, evaluates and keeps.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

ACTOR = Path(__file__).parents[1] / "actor"
RUNS = 20
ROUNDS = 2
LIMIT_SECONDS = 0.3
SWEEP = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: NAME}
spec:
  template: {spec: {algorithmRef: {name: actor}, datasetRef: {name: tiny}, parameters: {act: ACT}}}
  repetitions: COUNT
"""


class Took(NamedTuple):
    """Wall time and CPU time of a command, s."""

    wall: float
    cpu: float


def make_home(home: Path) -> None:
    """Put the actor and its small recording into a home."""
    actor, datasets = home / "algorithms" / "actor", home / "datasets"
    shutil.copytree(ACTOR, actor)
    (datasets / "tiny").mkdir(parents=True)
    shutil.move(actor / "tiny.yaml", datasets / "tiny" / "dataset.yaml")
    dataset = load_file(datasets / "tiny" / "dataset.yaml")[0]
    if not isinstance(dataset, Dataset):
        raise TypeError(dataset.kind)
    truth = (materialise(dataset, datasets, datasets).root / "groundtruth.txt").read_text()
    poses = [line for line in truth.splitlines(keepends=True) if not line.startswith("#")]
    (actor / "truth.txt").write_text("".join(poses))


def timed(command: list[str], **options: Any) -> Took:
    """Run a command and return what it took, everything that it started included."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    result = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    elapsed, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if result.returncode:
        raise SystemExit(result.stderr)
    return Took(elapsed, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def slamhive_run(home: Path, name: str, act: str, count: int) -> Took:
    """Run a sweep through the command."""
    sweep = home / f"{name}.yaml"
    sweep.write_text(SWEEP.replace("NAME", name).replace("ACT", act).replace("COUNT", str(count)))
    command = [str(Path(sys.executable).with_name("slamhive")), "run", "-j", "1", "--rerun", str(sweep)]
    return timed(command, env=os.environ | {"SLAMHIVE_HOME": str(home)})


def shell_loop(home: Path, count: int) -> Took:
    """Run the same program as often in a shell loop."""
    folder = next((home / "runs" / "round-0").iterdir())
    supervised = json.loads((folder / "supervisor.json").read_text())
    argv = " ".join(f"'{word}'" for word in supervised["argv"])
    loop = f"i=0; while [ $i -lt {count} ]; do {argv} || exit 1; i=$((i+1)); done"
    return timed(["sh", "-c", loop], env=supervised["env"], cwd=supervised["cwd"])


def main() -> None:
    """Print the least overhead of a few rounds: what it takes, whatever else the machine did meanwhile."""
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        make_home(home)
        slamhive_run(home, "first", "good", 1)
        ours, plain = [], []
        for number in range(ROUNDS):
            ours.append(slamhive_run(home, f"round-{number}", "second", RUNS))
            plain.append(shell_loop(home, RUNS))
        wall, loop = min(took.wall for took in ours), min(took.wall for took in plain)
        cpu, alone = min(took.cpu for took in ours), min(took.cpu for took in plain)
        print(
            f"added to each of {RUNS} one-second runs · {(wall - loop) / RUNS:.3f} s · "
            f"limit {LIMIT_SECONDS} s (slamhive run {wall:.1f} s, shell loop {loop:.1f} s)"
        )
        print(
            f"CPU time added to each of {RUNS} one-second runs · {(cpu - alone) / RUNS:.3f} s · "
            f"{alone / RUNS:.3f} s without; doesn't depend on what else the machine does"
        )


if __name__ == "__main__":
    main()
