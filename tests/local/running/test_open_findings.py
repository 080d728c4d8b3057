# SPDX-License-Identifier: Apache-2.0
"""Runs on recordings in which something is wrong: what isn't started, and what is said of those that fail."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from slamhive.data.doctor.findings import Finding, Severity
from slamhive.data.inspecting.known import FINDINGS, keep, known
from slamhive.data.inspecting.quick import quick_findings
from slamhive.data.store.datasets import materialise
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job, Runner
from slamhive.model.dataset import Dataset
from slamhive.model.results import Phase, Reason
from slamhive.plan import Plan, local_uid

from .sweeps import Notes, sweep_of

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "data" / "datalab"))

from spoiling import spoil

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.data.recordings.entries import DatasetEntry
    from slamhive.local.home.folder import Home
    from slamhive.local.running.workbench import Workbench

SYNTHETIC = {
    "sensors": ["Lidar", "Imu"],
    "durationSeconds": 7,
    "loops": 0.1,
    "lidar": {"rings": 4, "columns": 36},
}
LOST = "images.constant", Severity.WARNING, "sensors.lidar: half of its scans show nothing", "lidar"


@pytest.fixture(scope="module")
def in_tai(tmp_path_factory: pytest.TempPathFactory) -> DatasetEntry:
    """A dataset whose LiDAR is 37 s ahead of its IMU."""
    folder = tmp_path_factory.mktemp("tai")
    body = {"metadata": {"name": "tai"}, "spec": {"recording": {"synthetic": SYNTHETIC}}}
    clean = materialise(Dataset.model_validate(body), folder, folder)

    def change(topic: str, message: Any) -> Any:
        if topic != "/points":
            return message
        stamp = message.header.stamp
        return replace(message, header=replace(message.header, stamp=replace(stamp, sec=stamp.sec + 37)))

    return spoil(clean, folder / "spoiled", change)


def test_what_a_finding_makes_impossible_is_not_started(
    in_tai: DatasetEntry, bench: Workbench, run_sweep: Callable[..., Any]
) -> None:
    bench.workshop.add([in_tai.dataset], in_tai.root)
    sweep = sweep_of(["good"], template={"datasetRef": {"name": "tai"}, "retries": 2})
    _, notes = run_sweep(sweep)
    (record,) = notes.records
    assert (record.phase, record.reason, record.attempts) == (Phase.FAILED, Reason.PREPARATION_FAILED, 0)
    assert (
        "dataset 'tai': runs with lidar aren't started: sensors.lidar: its header stamps are 37 s"
        in record.message
    )
    assert "(clock.epoch; in its spec: repair: " in record.message
    assert not (bench.home.path / "runs/acts" / record.name / "run").exists()
    assert [one.code for one in known(in_tai, bench.home.path / FINDINGS) or []] == ["clock.epoch"]
    assert not [*(bench.home.path / "variants").glob("*/variant.json")]

    line = record.message.split("in its spec: ", 1)[1].rpartition(")")[0]
    spec = in_tai.dataset.spec.as_json() | yaml.safe_load(line)
    mended = Dataset.model_validate(in_tai.dataset.as_json() | {"spec": spec})
    bench.workshop.add([mended], in_tai.root)
    again = type(bench)(bench.home, bench.workshop, bench.archive)
    run = {"datasetRef": {"name": "tai"}, "sensors": "lidar", "input": {}}
    again.require_possible(run, bench.workshop.algorithm("actor").algorithm)


def test_a_crash_names_the_findings_of_its_input(bench: Workbench, run_acts: Callable[..., Any]) -> None:
    keep(bench.dataset("tiny"), [Finding(*LOST)], bench.home.path / FINDINGS, is_sample=False)
    _, notes = run_acts(["segfault", "crash", "good"])
    said = {record.spec["parameters"]["act"]: record for record in notes.records}
    behind = "its recording may be why: sensors.lidar: half of its scans show nothing (images.constant)"
    assert said["segfault"].message == f"ended by signal 11 (SIGSEGV); {behind}"
    assert said["crash"].message == f"exit code 1: cannot open the map; {behind}"
    assert said["good"].message is None
    assert said["good"].provenance.prepared.findings == ["images.constant"]


def test_results_on_it_are_marked(
    bench: Workbench,
    run_acts: Callable[..., Any],
    home: Home,
    run_command: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    run_acts(["good"])
    table = "".join(run_command("results", "table")[1:])
    assert ("†" in table, "findings" in table) == (False, False)
    keep(bench.dataset("tiny"), [Finding(*LOST)], home.path / FINDINGS, is_sample=False)
    again = type(bench)(home, bench.workshop, bench.archive)
    sweep = sweep_of(["good"])
    job = Job(sweep, local_uid(sweep), Plan(sweep, again.workshop))
    Runner(again, Notes(), parallelism=1, wish=RunChoice(rerun=True)).run([job])
    code, shown, said = run_command("results", "table")
    assert (code, shown.count("1 †")) == (0, 1)
    assert "† the recording has open findings (tiny: images.constant)" in said
    flat = run_command("results", "table", "--format", "csv")[1].splitlines()
    assert dict(zip(*csv.reader(flat), strict=True))["findings"] == "images.constant"
    rows = run_command("results", "export", "--columns", "dataset,prepared.findings")[1]
    assert rows.splitlines()[1] == 'tiny,"[""images.constant""]"'


def test_an_error_of_the_truth_prevents_nothing(bench: Workbench, run_acts: Callable[..., Any]) -> None:
    wrong = Finding("truth.jump", Severity.ERROR, "groundTruth: it jumps", "groundTruth")
    note = Finding("files.order", Severity.NOTE, "recording.files: in another order")
    keep(bench.dataset("tiny"), [wrong, note], bench.home.path / FINDINGS, is_sample=False)
    _, notes = run_acts(["good", "crash"])
    good, crash = sorted(notes.records, key=lambda record: record.index)
    assert (good.phase, good.provenance.prepared.findings) == (Phase.SUCCEEDED, ["truth.jump"])
    assert crash.message == "exit code 1: cannot open the map"


def test_a_sample_takes_no_whole_check_away(bench: Workbench, home: Home) -> None:
    entry, folder = bench.dataset("tiny"), home.path / FINDINGS
    keep(entry, [Finding(*LOST)], folder, is_sample=False)
    keep(entry, [], folder, is_sample=True)
    assert [one.code for one in known(entry, folder) or []] == ["images.constant"]
    keep(entry, [], folder, is_sample=False)
    assert known(entry, folder) == []


def test_commands_say_it_before_the_run(
    in_tai: DatasetEntry,
    home: Home,
    run_command: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    sweep = sweep_of(["good"], template={"datasetRef": {"name": "tai"}, "sensors": "lidar"}).as_json()
    file = in_tai.root / "sweep.yaml"
    file.write_text(yaml.safe_dump_all([in_tai.dataset.as_json(), sweep]))
    said = "lidar can't be run on tai, and isn't started: sensors.lidar: its header stamps are 37 s ahead"
    assert said not in run_command("validate", file)[2]
    keep(in_tai, quick_findings(in_tai), home.path / FINDINGS, is_sample=True)
    for command, code in (("validate", 0), ("plan", 0), ("run", 1)):
        found = run_command(command, file)
        assert (found[0], found[2].count(said)) == (code, 1), found
