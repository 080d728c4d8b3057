# SPDX-License-Identifier: Apache-2.0
"""Manifests that `dataset check --repair` writes: each finding's repair, its reason, and what contradicts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import yaml
from spoiling import spoil

from slamhive.data.doctor.findings import Finding, Severity, sensor_repair
from slamhive.data.inspecting.remedies import repaired_manifest
from slamhive.model.dataset import Dataset

if TYPE_CHECKING:
    from pathlib import Path

    from slamhive.data.recordings.entries import DatasetEntry


SWEEP = """
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: both}
spec:
  template: {spec: {algorithmRef: {name: kiss-icp}, sensors: lidar}}
  matrix:
    - {path: datasetRef.name, values: [lidar, lidar-repaired]}
"""


def found(code: str, severity: Severity = Severity.ERROR, **repair: Any) -> Finding:
    return Finding(code, severity, f"sensors.lidar: {code}", "lidar", repair=sensor_repair("lidar", **repair))


def under(dataset: Dataset, **repair: Any) -> Dataset:
    """Return a dataset that is repaired already."""
    values = dataset.as_json()
    values["spec"]["repair"] = {"sensors": {"lidar": repair}}
    return Dataset.model_validate(values)


def lidar_of(text: str) -> dict[str, Any]:
    repaired: dict[str, Any] = yaml.safe_load(text)["spec"]["repair"]["sensors"]["lidar"]
    return repaired


def test_a_fault_is_found_repaired_and_gone(
    lidar_entry: DatasetEntry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> None:
    def ahead(topic: str, message: Any) -> Any:
        if topic == "/points":
            message.header.stamp.sec += 37
        return message

    faulty = spoil(lidar_entry, tmp_path / "bad", ahead)
    manifest = tmp_path / "bad" / "bad.yaml"
    manifest.write_text(yaml.safe_dump(faulty.dataset.as_json()))
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    assert run_command("dataset", "add", manifest)[0] == 0
    (tmp_path / "new").mkdir()
    monkeypatch.chdir(tmp_path / "new")
    code, told, remarks = run_command("dataset", "check", "lidar", "--repair", "new.yaml")
    assert code == 1
    assert "clock.epoch" in told + remarks
    assert "wrote new.yaml: lidar-repaired, with 1 repair" in remarks
    text = (tmp_path / "new" / "new.yaml").read_text()
    lines = [line.strip() for line in text.splitlines()]
    at = lines.index("shift: -37.0")
    assert lines[at - 1].startswith("# clock.epoch: sensors.lidar: its header stamps are 37 s ahead")
    assert run_command("dataset", "check", "lidar", "--repair", "new.yaml")[0] == 2
    assert run_command("dataset", "add", "new.yaml")[0] == 0
    code, told, remarks = run_command("dataset", "check", "lidar-repaired", "--repair", "newer.yaml")
    assert code == 0
    assert "clock.epoch" not in told + remarks
    assert "newer.yaml wasn't written: no finding has a repair" in remarks
    assert not (tmp_path / "new" / "newer.yaml").exists()
    (tmp_path / "new" / "sweep.yaml").write_text(SWEEP)
    remarks = run_command("plan", "sweep.yaml")[2]
    assert "lidar-repaired is repaired: each prepared recording of it is written anew, up to" in remarks
    assert "lidar is repaired" not in remarks


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("new.txt", "--repair: new.txt: a manifest ends in .yaml"),
        ("nowhere/new.yaml", "--repair: nowhere: no such folder"),
    ],
)
def test_a_manifest_that_cant_be_written_is_refused_before_anything_is_read(
    target: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_command: Any
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    code, _, errors = run_command("dataset", "check", "synthetic-lidar", "--repair", target)
    assert code == 2
    assert said in errors


def test_of_two_that_want_different_things_the_graver_one_has_it(lidar_entry: DatasetEntry) -> None:
    graver, other = found("a", shift=-37.0), found("b", Severity.WARNING, shift=-0.1, noReturns=True)
    made = repaired_manifest(lidar_entry.dataset, [graver, other])
    assert lidar_of(made.text)["shift"] == -37.0
    assert made.repaired == [graver]
    (note,) = made.notes
    assert note.startswith(
        "b (lidar) isn't repaired: repair.sensors.lidar.shift would be -0.1, but a comes first"
    )


def test_of_two_that_want_the_same_nothing_is_said(lidar_entry: DatasetEntry) -> None:
    made = repaired_manifest(lidar_entry.dataset, [found("a", noReturns=True), found("b", noReturns=True)])
    assert lidar_of(made.text) == {"noReturns": True}
    assert made.notes == []


def test_messages_that_either_of_two_leaves_out_are_left_out(lidar_entry: DatasetEntry) -> None:
    both = [found("a", drop=[12]), found("b", Severity.WARNING, drop=[3, 12, 20])]
    made = repaired_manifest(lidar_entry.dataset, both)
    assert lidar_of(made.text) == {"drop": [3, 12, 20]}
    assert (made.repaired, made.notes) == (both, [])
    assert "# a: " in made.text
    assert "# b: " in made.text


def test_what_no_manifest_takes_is_left_out(lidar_entry: DatasetEntry) -> None:
    fitting = found("b", noReturns=True)
    made = repaired_manifest(lidar_entry.dataset, [found("a", depthScale=1000), fitting])
    assert made.repaired == [fitting]
    (note,) = made.notes
    assert note.startswith(
        "a (lidar) isn't repaired: repair.sensors.lidar.depthScale: lidar is of type Lidar;"
    )


def test_what_is_found_under_a_repair_is_taken_together_with_it(lidar_entry: DatasetEntry) -> None:
    dataset = under(lidar_entry.dataset, shift=-37, dropLeading=1)
    made = repaired_manifest(dataset, [found("a", shift=-0.25), found("b", drop=[4])])
    assert lidar_of(made.text)["shift"] == -37.25
    assert lidar_of(made.text)["dropLeading"] == 1
    assert "b (lidar) isn't repaired: repair.sensors.lidar.drop counts messages that" in made.notes[0]


def test_it_is_named_after_the_dataset_once(lidar_entry: DatasetEntry) -> None:
    made = repaired_manifest(lidar_entry.dataset, [found("a", shift=1.0)])
    again = repaired_manifest(Dataset.model_validate(yaml.safe_load(made.text)), [found("a", shift=1.0)])
    assert made.name == again.name == "lidar-repaired"
    assert yaml.safe_load(again.text)["metadata"]["name"] == "lidar-repaired"
    assert lidar_of(again.text)["shift"] == 2.0
