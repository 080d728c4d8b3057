# SPDX-License-Identifier: Apache-2.0
"""Hit rate of estimates on recorded runs, and what an estimate of 80,000 runs costs.

Recorded runs are put back into the state before they ran: what is asked is left out of what is known, and
everything that is as near. So the distance is the one that is told of: one run of several is left out ("the
same settings"), all runs of a setting ("other settings on the dataset"), of an algorithm on a dataset ("other
datasets"), of an algorithm in a sensor mode. Sums are those of what was left out together, and of all runs
of a sweep at once, from the sweeps before it.

The runs: the 81 of the original SLAM Hive's paper where they are at hand, and those of homes whose paths are
given, or else sweeps that it makes itself with bundled algorithms on short generated recordings.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

from slamhive.analysis.design import Known, Nearness, Quantity, Setting, design
from slamhive.analysis.predicting import COVERED, CostInterval, predict
from slamhive.archive import Archive
from slamhive.bridges.slamhive1 import find_runs, read_run
from slamhive.local.running.costs import NOW, Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PAPER = Path(__file__).parents[3] / "shared" / "data" / "icra2023" / "runs"
COMMAND = (sys.executable, "-c", "from slamhive.cli.main import main; main()")
RUNS = 80_000
SECONDS, MEGABYTES = 5, 400
FRAMES = {"mh-01-easy": 3682, "mh-02-easy": 3040, "mh-03-medium": 2700, "rgbd-dataset-freiburg2-desk": 2965}
"""Images of one camera in the recordings of the paper."""
RATES = {"rgbd-dataset-freiburg2-desk": 30.0}
QUANTITIES = (Quantity.CPU, Quantity.WALL, Quantity.MEMORY, Quantity.DISK)
DATASETS = {"short": (10, 8, 120), "longer": (20, 8, 120), "dense": (10, 16, 240), "longest": (30, 16, 120)}
SWEEPS: dict[str, dict[str, list[Any]]] = {
    "first": {
        "algorithm": ["kiss-icp", "genz-icp"],
        "dataset": ["short", "longer"],
        "parameters.maxRange": [30, 100],
    },
    "second": {
        "algorithm": ["kiss-icp"],
        "dataset": ["dense", "longest"],
        "parameters.maxRange": [30, 60],
        "parameters.voxelSize": [0.5, 1],
    },
    "third": {
        "algorithm": ["genz-icp"],
        "dataset": ["dense", "longest"],
        "input.frameRate": [10, 5],
        "parameters.maxRange": [30, 100],
    },
    "fourth": {"algorithm": ["mad-icp"], "dataset": list(DATASETS)},
}


class Recorded(NamedTuple):
    """A finished run, and the sweep that it belongs to."""

    known: Known
    sweep: str


class Left(NamedTuple):
    """Choice of the runs that are left out together to test estimates from known runs of one nearness."""

    nearness: Nearness
    of: Callable[[Setting], Any]
    needs: Callable[[Setting], Any]


def _exact(setting: Setting) -> Any:
    return (
        *setting.unit,
        setting.dataset,
        *sorted((key, str(value)) for key, value in setting.changed.items()),
    )


LEFT = (
    Left(Nearness.SETTING, id, _exact),
    Left(Nearness.PAIR, _exact, lambda one: (*one.unit, one.dataset)),
    Left(Nearness.ALGORITHM, lambda one: (*one.unit, one.dataset), lambda one: one.unit),
    Left(Nearness.MODE, lambda one: one.unit, lambda one: one.algorithm),
)


class Hits:
    """Counts of intervals that held."""

    def __init__(self) -> None:
        self._held: dict[Any, list[float]] = defaultdict(list)
        self._wide: dict[Any, list[float]] = defaultdict(list)

    def note(self, key: Any, low: float, value: float, high: float) -> None:
        """Note an interval and what came out."""
        self._held[key].append(float(low <= value <= high))
        self._wide[key].append(high / low)

    def report(self, title: str) -> None:
        """Print the rates, and what they are over all."""
        for key, held in self._held.items():
            wide = float(np.median(self._wide[key])) ** 0.5
            rate = float(np.mean(held))
            print(
                f"{title}: {', '.join(map(str, key))} · {rate:.0%} of {len(held)} within, ×/÷ {wide:.2f} · "
                f"{COVERED:.0%}"
            )
        if everything := [one for held in self._held.values() for one in held]:
            print(f"{title}: all · {np.mean(everything):.0%} of {len(everything)} within · {COVERED:.0%}")


def replay(title: str, runs: Sequence[Recorded]) -> None:
    """Leave out what was recorded, predict it, and print how often it lay within its interval."""
    single, sums = Hits(), Hits()
    for left in LEFT:
        for group in _groups(runs, left):
            _predict(group, left.nearness, single, sums)
    single.report(f"{title}, one run")
    sums.report(f"{title}, sums of what was left out together")
    sweeps = list(dict.fromkeys(one.sweep for one in runs))[::-1]
    whole = Hits()
    for place, sweep in enumerate(sweeps):
        for others in ({*sweeps[:place]}, {*sweeps} - {sweep}):
            known = [one.known for one in runs if one.sweep in others]
            _sweep([one.known for one in runs if one.sweep == sweep], known, whole)
    whole.report(f"{title}, sums of whole sweeps")


def _groups(runs: Sequence[Recorded], left: Left) -> list[tuple[list[Known], list[Known]]]:
    """Return the runs left out together and those known then, where something as near is left."""
    together: dict[Any, list[Known]] = defaultdict(list)
    near: dict[Any, set[Any]] = defaultdict(set)
    for one in runs:
        setting = one.known.setting
        together[left.of(setting)].append(one.known)
        near[left.needs(setting)].add(left.of(setting))
    return [
        (out, [one.known for one in runs if left.of(one.known.setting) != key])
        for key, out in together.items()
        if len(near[left.needs(out[0].setting)]) > 1
    ]


def _planned(one: Known) -> Setting:
    """Return the setting that is asked for: it would run later than all that is known."""
    return one.setting._replace(occasion=None if one.setting.occasion is None else NOW)


def _predict(group: tuple[list[Known], list[Known]], nearness: Nearness, single: Hits, sums: Hits) -> None:
    out, known = group
    asked = [_planned(one) for one in out]
    rows = design(known, asked)
    if any(near is not nearness for near in rows.nearness):
        return
    for quantity in QUANTITIES:
        found = predict(quantity, known, asked, rows)
        costs = [one.costs.get(quantity) for one in out]
        if found is None or None in costs:
            continue
        actual = [float(cost or 0.0) for cost in costs]
        low, high = found.each()
        for place, cost in enumerate(actual):
            single.note((quantity, nearness), float(low[place]), cost, float(high[place]))
        if len(out) > 1 and quantity is not Quantity.MEMORY:
            told = CostInterval.of(found.total(np.ones(len(out))))
            sums.note((quantity, nearness), told.low, sum(actual), told.high)


def _sweep(out: Sequence[Known], known: Sequence[Known], whole: Hits) -> None:
    rows = design(known, [_planned(one) for one in out])
    counted = [one for one, near in zip(out, rows.nearness, strict=True) if near is not Nearness.NOTHING]
    if not known or not counted:
        return
    asked = [_planned(one) for one in counted]
    rows = design(known, asked)
    for quantity in QUANTITIES:
        found = predict(quantity, known, asked, rows)
        costs = [one.costs.get(quantity) for one in counted]
        if found is None or None in costs:
            continue
        draws = found.largest() if quantity is Quantity.MEMORY else found.total(np.ones(len(asked)))
        told, actual = CostInterval.of(draws), [float(cost or 0.0) for cost in costs]
        value = max(actual) if quantity is Quantity.MEMORY else sum(actual)
        whole.note((quantity,), told.low, value, told.high)


def of_paper(folder: Path) -> list[Recorded]:
    """Return the runs of the original SLAM Hive's paper."""
    found = []
    for place in find_runs(folder):
        run = read_run(place)
        record = run.record(0)
        usage, data = record.usage, run.dataset
        if usage is None:
            continue
        costs = {Quantity.CPU: usage.cpu.seconds, Quantity.WALL: usage.wall_seconds}
        costs |= {Quantity.MEMORY: usage.memory.peak_bytes, Quantity.DISK: _size(place / "traj.txt")}
        frames = FRAMES.get(data)
        setting = Setting(
            run.algorithm,
            str(run.sensors),
            "Realtime",
            data,
            frames=frames,
            seconds=frames / RATES.get(data, 20.0) if frames else None,
            changed={f"parameters.{key}": value for key, value in run.parameters.items()},
        )
        known = Known(setting, {name: float(cost) for name, cost in costs.items() if cost})
        found.append(Recorded(known, f"{run.algorithm} {run.sensors}"))
    return found


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def of_home(home: Path) -> list[Recorded]:
    """Return the finished runs of a home."""
    with Archive.open(f"sqlite:///{home / 'archive.sqlite'}", read_only=True) as archive:
        catalog = [sorted({one.name for one in archive.catalog(kind)}) for kind in ("Algorithm", "Dataset")]
        costs = archive.costs(*catalog)
        sweeps = {run.uid: run.sweep or "" for run in archive.runs()}
    knowledge = Knowledge.of(costs)
    known = knowledge.known(folders=True)
    return [Recorded(one, sweeps[cost.uid]) for one, cost in zip(known, knowledge.costs, strict=True)]


def _make(folder: Path) -> Path:
    """Run sweeps of bundled algorithms on generated recordings, and return the home."""
    documents: list[dict[str, Any]] = []
    for name, (length, rings, columns) in DATASETS.items():
        lidar = {"rings": rings, "columns": columns}
        made = {"sensors": ["Lidar"], "durationSeconds": length, "loops": 0.03 * length, "lidar": lidar}
        documents.append(_object("Dataset", name, {"recording": {"synthetic": made}}))
    for name, axes in SWEEPS.items():
        matrix = [{"path": path, "values": values} for path, values in axes.items()]
        spec = {"template": {"spec": {}}, "matrix": matrix, "repetitions": 2}
        documents.append(_object("Sweep", name, spec))
    (folder / "sweeps.yaml").write_text(yaml.safe_dump_all(documents))
    environment = os.environ | {"SLAMHIVE_HOME": str(folder / "home")}
    subprocess.run(
        [*COMMAND, "run", str(folder / "sweeps.yaml"), "-j", "1"],
        env=environment,
        check=True,
        capture_output=True,
    )
    return folder / "home"


def _object(kind: str, name: str, spec: dict[str, Any]) -> dict[str, Any]:
    return {"apiVersion": "slamhive.io/v1alpha1", "kind": kind, "metadata": {"name": name}, "spec": spec}


def _large(folder: Path) -> None:
    """Print what an estimate of 80,000 runs over an archive of 80,000 runs costs."""
    from bench_dashboard import ALGORITHMS, make_record

    home = folder / "large"
    home.mkdir()
    with Archive.open(f"sqlite:///{home / 'archive.sqlite'}") as archive:
        archive.put_runs(map(make_record, range(RUNS)))
    matrix = [
        {"path": "dataset", "values": [f"sequence-{number:02d}" for number in range(10)]},
        {"path": "input.frameRate", "values": [5, 10, 20, 2]},
        {"path": "algorithm", "values": list(ALGORITHMS)},
        {"path": "parameters.p0", "values": [500, 1000, 1500, 2000, 3000]},
        {"path": "parameters.p1", "values": [1000, 2000, 3000, 4000, 5000]},
        {"path": "parameters.p2", "values": [1500, 3000]},
    ]
    spec = {"template": {"spec": {"sensors": "mono"}}, "matrix": matrix, "repetitions": 5}
    (folder / "large.yaml").write_text(yaml.safe_dump(_object("Sweep", "large", spec)))
    began = time.perf_counter()
    environment = os.environ | {"SLAMHIVE_HOME": str(home)}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [*COMMAND, "plan", str(folder / "large.yaml"), "--estimate"]
    subprocess.run(command, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    over = ", TOO MUCH" if spent > SECONDS else ""
    wall = time.perf_counter() - began
    print(f"estimate of 80,000 runs from 80,000 · {spent:.1f} CPU s ({wall:.0f} s) · limit {SECONDS} s{over}")
    peak = after.ru_maxrss / 1024
    over = ", TOO MUCH" if peak > MEGABYTES else ""
    print(f"its memory, the largest child's · {peak:.0f} MB · limit {MEGABYTES} MB{over}", flush=True)


def main() -> None:
    """Print the hit rates and what a large estimate costs."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        _large(folder)
        if PAPER.is_dir():
            replay("paper", of_paper(PAPER))
        homes = [Path(text) for text in sys.argv[1:]] or [_make(folder)]
        for home in homes:
            replay(home.name if sys.argv[1:] else "own sweeps", of_home(home))


if __name__ == "__main__":
    main()
