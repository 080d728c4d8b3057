# SPDX-License-Identifier: Apache-2.0
"""A home with a small dataset and an algorithm that does what its parameter says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from slamhive.archive import Archive
from slamhive.data.store import materialise
from slamhive.local.catalog import Workshop
from slamhive.local.home import Home
from slamhive.local.runner import Job, Runner
from slamhive.local.workbench import Workbench
from slamhive.model.loading import load_file, parse, to_object
from slamhive.model.sweep import Sweep
from slamhive.plan import Plan, local_uid

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from slamhive.model.results import Phase, RunRecord

DATASET = """
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: tiny}
spec:
  recording:
    synthetic:
      {seed: 5, sensors: [Lidar], durationSeconds: 10, loops: 0.2, lidar: {rings: 4, columns: 36}}
"""

ALGORITHM = """
apiVersion: slamhive.io/v1alpha1
kind: Algorithm
metadata: {name: actor}
spec:
  local: {adapter: adapter.py, requirements: requirements.txt, python: ">=3.11"}
  modes: [{name: lidar}]
  parameters:
    act: {type: String, default: good}
    number: {type: Integer, default: 0, minimum: 0}
  assets: [{name: truth.txt, path: truth.txt}]
  output: {frame: body, stamp: ScanStart}
  deterministic: "Yes"
"""

ADAPTER = '''
"""Acts as the parameter "act" says; the good act copies the ground truth it was given as an asset."""
import os, re, shutil, signal, subprocess, sys, time
run = os.environ["SLAMHIVE_RUN"]
text = open(f"{run}/config.yaml").read()
act = re.search(r"^  act: (\\S+)$", text, re.M).group(1)
out = f"{run}/output/trajectory.txt"
lines = open(f"{run}/assets/truth.txt").read().splitlines(keepends=True)

def sleeper():
    return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)

if act == "good":
    shutil.copyfile(f"{run}/assets/truth.txt", out)
elif act == "slow":
    time.sleep(2)
    shutil.copyfile(f"{run}/assets/truth.txt", out)
elif act == "crash":
    print("something about the map"); sys.exit("cannot open the map")
elif act == "segfault":
    os.kill(os.getpid(), signal.SIGSEGV)
elif act == "hang":
    signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)
elif act == "memory":
    hog = []
    while True: hog.append(bytearray(20_000_000)); time.sleep(0.01)
elif act == "forks":
    sleeper(); sleeper(); shutil.copyfile(f"{run}/assets/truth.txt", out)
elif act == "nothing":
    pass
elif act == "empty":
    open(out, "w").close()
elif act == "nan":
    open(out, "w").writelines(lines[:5] + ["1.0 nan 0 0 0 0 0 1\\n"])
elif act == "unsorted":
    open(out, "w").writelines(reversed(lines[:500]))
elif act == "words":
    open(out, "w").write("I was never trained\\n")
elif act == "link":
    os.symlink("/etc/passwd", out)
elif act == "half":
    open(out, "w").writelines(lines[: len(lines) * 14 // 25])
elif act == "elsewhere":
    pairs = (line.split(None, 1) for line in lines[:100])
    open(out, "w").writelines(f"{float(stamp) + 1e6:.6f} {rest}" for stamp, rest in pairs)
elif act == "log":
    for _ in range(60_000): print("x" * 1000)
    shutil.copyfile(f"{run}/assets/truth.txt", out)
elif act == "poison":
    open(f"{run}/output/metrics.json", "w").write("{" * 100_000)
    shutil.copyfile(f"{run}/assets/truth.txt", out)
elif act == "configuration":
    assert not os.access(f"{run}/config.yaml", os.W_OK) or os.getuid() == 0
    assert "groundtruth" not in os.listdir(f"{run}/dataset")
    assert set(os.sched_getaffinity(0)) and os.environ["SLAMHIVE_SEED"]
    shutil.copyfile(f"{run}/assets/truth.txt", out)
'''


@pytest.fixture(scope="session")
def environments(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of environments that all homes share, as making one takes seconds."""
    return tmp_path_factory.mktemp("environments")


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of datasets in which the small recording has been made."""
    folder = tmp_path_factory.mktemp("datasets")
    dataset = to_object(parse(DATASET, "tiny")[0])
    materialise(dataset, folder, folder)  # type: ignore[arg-type]
    return folder


@pytest.fixture
def home(tmp_path: Path, environments: Path, tiny: Path) -> Home:
    """A home of its own for each test, with the small dataset and the actor."""
    folder = tmp_path / "home"
    actor = folder / "algorithms" / "actor"
    actor.mkdir(parents=True)
    (folder / "environments").symlink_to(environments)
    (folder / "datasets").symlink_to(tiny)
    (actor / "algorithm.yaml").write_text(ALGORITHM)
    (actor / "adapter.py").write_text(ADAPTER)
    (actor / "requirements.txt").write_text("")
    truth = next(tiny.glob("tiny-*/groundtruth.txt")).read_text()
    (actor / "truth.txt").write_text("".join(line + "\n" for line in truth.splitlines() if line[0] != "#"))
    (folder / "tiny.yaml").write_text(DATASET)
    return Home.at(folder)


@pytest.fixture
def workshop(home: Home) -> Workshop:
    """The catalog of the home."""
    found = Workshop()
    found.add(load_file(home.path / "algorithms/actor/algorithm.yaml"), home.path / "algorithms/actor")
    found.add(load_file(home.path / "tiny.yaml"), home.path)
    return found


@pytest.fixture
def bench(home: Home, workshop: Workshop) -> Iterator[Workbench]:
    """A workbench on the home."""
    with Archive.open(home.archive_url) as archive:
        yield Workbench(home, workshop, archive)


class Notes:
    """A watcher that remembers what it was told."""

    def __init__(self) -> None:
        self.phases: list[tuple[int, Phase]] = []
        self.records: list[RunRecord] = []

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        self.phases.append((index, phase))

    def finished(self, job: Job, record: RunRecord) -> None:
        self.records.append(record)

    def tick(self, jobs: Sequence[Job]) -> None:
        pass


def sweep_of(acts: Sequence[str], name: str = "acts", **fields: object) -> Sweep:
    """Return a sweep over acts."""
    template = {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}}
    template |= fields.pop("template", {})  # type: ignore[arg-type]
    return Sweep.model_validate(
        {
            "metadata": {"name": name},
            "spec": {
                "template": {"spec": template},
                "matrix": [{"path": "parameters.act", "values": list(acts)}],
                **fields,
            },
        }
    )


@pytest.fixture
def run_acts(bench: Workbench) -> Callable[..., tuple[Job, Notes]]:
    """Runs a sweep over acts, and returns the job and what was told of it."""

    def run(acts: Sequence[str], *, rerun: bool = False, **fields: object) -> tuple[Job, Notes]:
        sweep = sweep_of(acts, **fields)  # type: ignore[arg-type]
        job = Job(sweep, local_uid(sweep), Plan(sweep, bench.workshop))
        notes = Notes()
        Runner(bench, notes, parallelism=2, rerun=rerun).run([job])
        return job, notes

    return run
