# SPDX-License-Identifier: Apache-2.0
"""What slamhive adds to a run: one-second programs through the command, and the same in a shell loop.

The program is the tests' actor: it sleeps for a second and writes a trajectory, which `slamhive run` also
prepares a recording for, supervises, measures, evaluates and keeps.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from slamhive.data.store import materialise
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


def slamhive_run(home: Path, name: str, act: str, count: int) -> float:
    """Run a sweep with nothing beside it and return how long the command took, s."""
    sweep = home / f"{name}.yaml"
    sweep.write_text(SWEEP.replace("NAME", name).replace("ACT", act).replace("COUNT", str(count)))
    command = [Path(sys.executable).with_name("slamhive"), "run", "-j", "1", "--rerun", sweep]
    started = time.perf_counter()
    subprocess.run(
        command, check=True, env=os.environ | {"SLAMHIVE_HOME": str(home)}, stdout=subprocess.DEVNULL
    )
    return time.perf_counter() - started


def shell_loop(home: Path, count: int) -> float:
    """Run the same program as often in a shell loop, and return how long that took, s."""
    folder = next((home / "runs" / "round-0").iterdir())
    supervised = json.loads((folder / "supervisor.json").read_text())
    argv = " ".join(f"'{word}'" for word in supervised["argv"])
    loop = f"i=0; while [ $i -lt {count} ]; do {argv} || exit 1; i=$((i+1)); done"
    started = time.perf_counter()
    subprocess.run(["sh", "-c", loop], check=True, env=supervised["env"], cwd=supervised["cwd"])
    return time.perf_counter() - started


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
        overhead = (min(ours) - min(plain)) / RUNS
        print(
            f"added to each of {RUNS} one-second runs · {overhead:.3f} s · "
            f"limit {LIMIT_SECONDS} s (shell loop {min(plain):.1f} s, slamhive run {min(ours):.1f} s)"
        )


if __name__ == "__main__":
    main()
