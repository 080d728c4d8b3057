# SPDX-License-Identifier: Apache-2.0
"""``slamhive view``: what is written is loaded by Rerun itself."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from slamhive.archive import Archive
from slamhive.data.recordings.rosmessages import BagWriter
from slamhive.model.extras import how_to_install
from slamhive.model.results import Outcome, Phase, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

COUNT, START = 20, 1_600_000_000


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home with a run of a camera: its path, ground truth, usage and prepared recording."""
    home = tmp_path / "home"
    variant, folder = home / "variants" / "v", home / "runs" / "study" / "study-0"
    for one in (variant, folder / "run" / "output", home / "groundtruth"):
        one.mkdir(parents=True)
    with BagWriter(variant / "recording.bag") as bag:
        for k in range(COUNT):
            pixels = np.full((48, 64, 3), (0, 0, 10 * k), dtype=np.uint8)
            bag.image("/left", (START + k) * 10**9, "left", "rgb8", pixels)
    (folder / "run" / "dataset").symlink_to(variant)
    sensors = {"left": {"topic": "/left"}}
    recording = {"format": "Rosbag1", "path": "dataset/recording.bag"}
    configuration = {"mode": "mono", "dataset": {"recording": recording}, "sensors": sensors}
    (folder / "run" / "config.yaml").write_text(yaml.safe_dump(configuration))
    truth = "".join(f"{START + k} {k} {k % 3} 0 0 0 0 1\n" for k in range(COUNT))
    (home / "groundtruth" / "hall.txt").write_text(truth)
    estimate = "".join(f"{START + k} {k + 0.5} {k % 3} 0 0 0 0 1\n" for k in range(COUNT))
    (folder / "run" / "output" / "trajectory.txt").write_text(estimate)
    (folder / "usage.csv").write_text("time_seconds,cpu_cores,resident_bytes\n0,1.0,1048576\n1,2.0,2097152\n")
    values = {"alignment": "none", "transform": np.eye(4).tolist(), "ate": {"rmse": 0.5}}
    spec = {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "hall"}, "parameters": {"x": 1}}
    record = RunRecord(
        uid="uid-0",
        name="study-0",
        sweep="study",
        spec=spec,
        phase=Phase.SUCCEEDED,
        folder=str(folder),
        results=[Result(evaluation="none", outcome=Outcome.TRACKED, coverage=1.0, values=values)],
    )
    with Archive.open(f"sqlite:///{home}/archive.sqlite") as archive:
        archive.put_runs([record, record.replace(uid="uid-1", name="gone", folder=None)])
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_rerun_loads_truth_estimate_error_images_and_usage(
    rerun: Callable[..., str], place: Path, run_command: Any
) -> None:
    code, out, err = run_command("view", "study-0", "--save", "run.rrd")
    assert (code, err) == (0, "")
    assert "Next:  rerun run.rrd" in out
    rerun("verify", "run.rrd")
    printed = rerun("print", "-vvv", "run.rrd")
    for name in (
        "/world/truth",
        "/world/estimate/pose",
        "/error_metres",
        "/camera",
        "/usage/cpu_cores",
        "/run",
    ):
        assert name in printed, printed[:2000]
    assert "study-0" in printed


def test_what_is_missing_is_said(rerun: Callable[..., str], place: Path, run_command: Any) -> None:
    (place / "home" / "variants" / "v" / "recording.bag").unlink()
    (place / "home" / "groundtruth" / "hall.txt").unlink()
    code, _, err = run_command("view", "uid-0", "--save", "run.rrd")
    assert code == 0
    assert "its prepared recording is gone" in err
    assert "the ground truth of this dataset is not at hand" in err
    assert rerun("verify", "run.rrd") is not None


def test_a_run_leads_to_no_file_of_its_own_choice(
    rerun: Callable[..., str], place: Path, run_command: Any
) -> None:
    link = place / "home" / "runs" / "study" / "study-0" / "run" / "dataset"
    (place / "home" / "variants" / "v").rename(place / "elsewhere")
    link.unlink()
    link.symlink_to(place / "elsewhere")
    assert "its prepared recording is gone" in run_command("view", "uid-0", "--save", "run.rrd")[2]


def test_a_run_without_files_is_refused(rerun: Callable[..., str], place: Path, run_command: Any) -> None:
    code, _, err = run_command("view", "gone", "--save", "run.rrd")
    assert (code, err.strip()) == (2, "error: run gone: its files are not here, so there is nothing to show")
    assert not (place / "run.rrd").exists()


def test_a_missing_library_and_wrong_words_are_named(
    place: Path, run_command: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    code, _, err = run_command("view", "study-0")
    assert (code, len(err.splitlines())) == (2, 1)
    assert f"of the extra rerun: {how_to_install('rerun')}" in err
    (place / "there.rrd").touch()
    assert (
        "is there already; nothing is overwritten" in run_command("view", "study-0", "--save", "there.rrd")[2]
    )
    assert "its folder is not there" in run_command("view", "study-0", "--save", "no/run.rrd")[2]
    assert "did you mean 'study-0'" in run_command("view", "study-1")[2]
