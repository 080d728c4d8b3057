# SPDX-License-Identifier: Apache-2.0
"""``results export --to rerun``: layers that Rerun itself reads as one recording a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from slamhive.archive import Archive
from slamhive.model.results import Outcome, Phase, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

COUNT, START = 20, 1_600_000_000
EXPORT = ("results", "export", "--to", "rerun", "-o", "layers")


def write(path: Path, offset: float) -> None:
    """Write a path of 20 m that is some metres to the side."""
    lines = (f"{START + k} {k} {k % 3 + offset} 0 0 0 0 1\n" for k in range(COUNT))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(lines))


def record(home: Path, number: int, dataset: str, offset: float | None, **changes: Any) -> RunRecord:
    """Return a run with its files; without an offset it has failed and left none."""
    folder = home / "runs" / "study" / f"study-{number}"
    results = []
    if offset is not None:
        write(folder / "run" / "output" / "trajectory.txt", offset)
        usage = "time_seconds,cpu_cores,resident_bytes\n0,1.0,1048576\n1,2.0,2097152\n"
        (folder / "usage.csv").write_text(usage)
        for name, error in (("none", offset), ("se3", 0.0)):
            transform = np.eye(4)
            transform[1, 3] = error - offset
            values = {"alignment": name, "transform": transform.tolist(), "ate": {"rmse": error}}
            results.append(Result(evaluation=name, outcome=Outcome.TRACKED, coverage=1.0, values=values))
    fields: dict[str, Any] = {
        "uid": f"uid/{number}",
        "name": f"study-{number}",
        "sweep": "study",
        "spec": {"algorithmRef": {"name": "a"}, "datasetRef": {"name": dataset}, "parameters": {"x": number}},
        "phase": Phase.FAILED if offset is None else Phase.SUCCEEDED,
        "folder": None if offset is None else str(folder),
        "results": results,
    }
    return RunRecord(**fields | changes)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home with two runs of a dataset, one of another, and one that failed."""
    home = tmp_path / "home"
    write(home / "groundtruth" / "hall.txt", 0.0)
    write(home / "groundtruth" / "yard.txt", 0.0)
    runs = [("hall", 0.5), ("hall", 0.25), ("yard", 0.125), ("hall", None)]
    keep(home, *(record(home, number, *one) for number, one in enumerate(runs)))
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    monkeypatch.chdir(tmp_path)
    return home


def keep(home: Path, *records: RunRecord) -> None:
    with Archive.open(f"sqlite:///{home}/archive.sqlite") as archive:
        archive.put_runs(records)


def files(place: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in place.iterdir()}


def test_one_viewer_shows_truth_all_runs_and_errors_over_time(
    rerun: Callable[..., str], home: Path, run_command: Any
) -> None:
    code, out, err = run_command(*EXPORT)
    assert (code, "4 runs written, 0 there already" in out) == (0, True), err
    assert "Next:  rerun layers/DATASET/*.rrd" in out
    assert "1 run: its files are not here" in err
    hall, yard = sorted((home.parent / "layers").iterdir())
    layers = sorted(path for path in hall.iterdir() if path.suffix == ".rrd")
    names = [path.stem.rpartition("-")[0] or path.stem for path in layers]
    assert names == ["groundtruth", "layout", "study-0", "study-1", "study-3"]
    rerun("verify", *layers)
    rerun("merge", *layers, "-o", "all.rrd")

    from rerun.chunk import RrdReader

    (recording,) = RrdReader("all.rrd").recordings()
    (other,) = RrdReader(next(yard.glob("study-*.rrd"))).recordings()
    assert recording.recording_id != other.recording_id
    values: dict[str, Any] = {}
    for chunk in RrdReader("all.rrd").stream():
        batch = chunk.to_record_batch()
        columns = zip(batch.schema.names, batch.columns, strict=True)
        values.setdefault(chunk.entity_path, {}).update({name: one.to_pylist() for name, one in columns})
    for number, error in enumerate((0.5, 0.25)):
        stem = layers[number + 2].stem
        scalars = np.ravel(values[f"/error_metres/{stem}"]["Scalars:scalars"])
        assert scalars == pytest.approx(np.full(COUNT, error))
        assert len(values[f"/world/{stem}/pose"]["Points3D:positions"]) == COUNT
        assert values[f"/usage/cpu_cores/{stem}"]["Scalars:scalars"] == [[1.0], [2.0]]
    assert f"/world/{layers[0].stem}" in values
    assert f"/run/{layers[4].stem}" in values


def test_only_what_is_new_is_written(rerun: Callable[..., str], home: Path, run_command: Any) -> None:
    run_command(*EXPORT)
    hall, _ = sorted((home.parent / "layers").iterdir())
    before = files(hall)
    assert "0 runs written, 4 there already" in run_command(*EXPORT)[1]
    assert files(hall) == before
    # Errors of another evaluation, which the run that failed has not.
    assert "3 runs written, 0 there already" in run_command(*EXPORT, "--evaluation", "se3")[1]
    run_command(*EXPORT)
    write(home / "groundtruth" / "hall.txt", 0.125)
    assert "2 runs written, 2 there already" in run_command(*EXPORT)[1]
    after = files(hall)
    assert len(after) == len(before)
    assert sum(name not in before for name in after) == 1  # the other ground truth
    keep(home, record(home, 4, "hall", 1.0))
    assert "1 run written, 4 there already" in run_command(*EXPORT)[1]
    assert {name for name, content in after.items() if files(hall)[name] != content} == {"slamhive.json"}
