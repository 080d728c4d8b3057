# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamhive.data.inspecting.inspection import inspect
from slamhive.data.recordings.entries import DatasetEntry
from slamhive.data.store.groundtruth import ground_truth, write_ground_truth
from slamhive_eval import read_tum

START = 1_600_000_000


@pytest.fixture
def recorded(tmp_path: Path, bag_writer: Any, bag_entry: Any) -> Any:
    """Make a dataset of an IMU whose ground truth has a row of NaN every so many."""

    def make(every: int) -> DatasetEntry:
        with bag_writer(tmp_path / "walk.bag") as bag:
            for k in range(100):
                stamp = round((START + k / 10) * 1e9)
                bag.imu("/imu", stamp, "imu", np.zeros(3), np.array([0.0, 0.0, 9.81]))
        rows = [
            f"{START + k / 10} {'nan' if every and k % every == 1 else k / 10} 0 0 0 0 0 1"
            for k in range(100)
        ]
        (tmp_path / "truth.txt").write_text("\n".join(rows) + "\n")
        entry = bag_entry(tmp_path / "walk.bag", {"imu": ("Imu", "/imu")})
        values = entry.dataset.as_json()
        values["spec"]["groundTruth"] = {"file": "truth.txt", "format": "Tum", "frame": "body"}
        return DatasetEntry(type(entry.dataset).model_validate(values), tmp_path)

    return make


def test_rows_of_nan_are_counted_and_no_evaluator_gets_them(recorded: Any, tmp_path: Path) -> None:
    entry = recorded(every=5)
    report = inspect(entry)
    (finding,) = [one for one in report.findings if one.code == "truth.nan"]
    assert (finding.count, finding.value, finding.severity) == (20, 0.2, "note")
    assert finding.message.startswith("groundTruth: 20 of 100 rows hold NaN and were left out")
    assert report.errors == []
    assert report.ground_truth.count == 80
    given = tmp_path / "given.txt"
    write_ground_truth(entry, ground_truth(entry), given)
    assert "nan" not in given.read_text()
    assert len(read_tum(given)) == 80


def test_of_whole_ground_truth_nothing_is_said(recorded: Any) -> None:
    assert not [one for one in inspect(recorded(every=0)).findings if one.code == "truth.nan"]


def test_ground_truth_of_nan_alone_is_an_error(recorded: Any) -> None:
    entry = recorded(every=0)
    text = (entry.root / "truth.txt").read_text()
    (entry.root / "truth.txt").write_text(text.replace(" 0 0 0 0 0 1", " nan 0 0 0 0 1"))
    (error,) = inspect(entry).errors
    assert "all 100 rows hold NaN" in error
