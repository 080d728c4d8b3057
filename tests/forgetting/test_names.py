# SPDX-License-Identifier: Apache-2.0
"""Datasets, algorithms and sweeps that are removed or get another name: what was measured stays readable."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, CatalogEntry, SweepRecord
from slamhive.data.store.datasets import add_dataset, materialise
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.changes import set_aside
from slamhive.local.home.folder import lock
from slamhive.local.home.sweeping import require_own_name
from slamhive.local.housekeeping import unlisting
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError
from slamhive.model.loading import load_file
from slamhive.model.sweep import Sweep
from slamhive.plan import content_hash, local_uid, spec_hash

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ALIKE = {"algorithm": "icp", "parameters": {}}


def dataset(name: str, seed: int = 1) -> Dataset:
    spec = {"recording": {"synthetic": {"seed": seed, "sensors": ["Lidar"], "durationSeconds": 99}}}
    return Dataset.model_validate({"metadata": {"name": name}, "spec": spec})


@pytest.fixture
def hall(lab: Any) -> Path:
    """A dataset of the home, with a folder as if its recording had been generated."""
    root = lab.home.folder("datasets")
    add_dataset(dataset("hall"), root, root)
    made = root / ("hall-" + "a" * 16)
    made.mkdir()
    (made / "recording.bag").write_bytes(b"r" * 9000)
    return made  # type: ignore[no-any-return]


def names(lab: Any) -> set[str]:
    return set(load_workshop(lab.home).datasets) & {"hall", "room", "den"}


def test_a_dataset_goes_and_its_runs_stay_readable(
    lab: Any, slamhive: Callable[..., Any], hall: Path
) -> None:
    record = lab.run("a")
    said = slamhive("dataset", "remove", "hall", "--yes")
    assert (said.code, names(lab), hall.exists()) == (0, set(), False)
    assert "1 run of it stay readable" in said.err
    assert lab.records() == {record.uid: record}
    assert slamhive("results", "show", "a").code == 0


def test_a_typo_is_forgotten_by_the_command_that_the_refusal_names(
    lab: Any, slamhive: Callable[..., Any], hall: Path
) -> None:
    root = lab.home.path / "datasets"
    with pytest.raises(InputError, match="slamhive dataset remove hall"):
        add_dataset(dataset("hall", seed=2), root, root)
    assert slamhive("dataset", "remove", "hall", "--yes").code == 0
    add_dataset(dataset("hall", seed=2), root, root)
    # One that stops every other command can be forgotten all the same.
    (root / "hall" / "dataset.yaml").write_text("kind: [")
    assert slamhive("dataset", "list").code == 2
    assert slamhive("dataset", "remove", "hall", "--yes").code == 0
    assert slamhive("dataset", "list").code == 0


def test_files_that_a_dataset_links_to_stay(lab: Any, slamhive: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "my.bag").write_bytes(b"bag")
    sensors = {"lidar": {"type": "Lidar", "topic": "/points", "frameId": "lidar", "stamp": "ScanStart"}}
    spec = {"recording": {"format": "Rosbag1", "files": [{"path": "my.bag"}]}, "sensors": sensors}
    mine = Dataset.model_validate({"metadata": {"name": "mine"}, "spec": spec})
    add_dataset(mine, tmp_path, lab.home.folder("datasets"))
    assert slamhive("dataset", "remove", "mine", "--yes").code == 0
    assert (tmp_path / "my.bag").read_bytes() == b"bag"
    assert not (lab.home.path / "datasets" / "mine").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("dataset", "remove", "nosuch"), "unknown dataset 'nosuch'; known: hall"),
        (("dataset", "remove", "../hall"), "unknown dataset '../hall'"),
        (("dataset", "remove", "synthetic-lidar"), "comes with slamhive and stays"),
        (("algorithm", "remove", "kiss-icp"), "comes with slamhive and stays"),
        (("algorithm", "remove", "nosuch"), "unknown algorithm 'nosuch'"),
        (("dataset", "rename", "hall", "synthetic-lidar"), "is known already: choose another name"),
        (("dataset", "rename", "hall", "den"), "a record refers to a dataset 'den'"),
        (("dataset", "rename", "hall", "../x"), "NEW: expected a name of lower-case letters"),
        (("dataset", "rename", "nosuch", "x"), "unknown dataset 'nosuch'"),
        (("sweep", "rename", "nosuch", "x"), "unknown sweep 'nosuch'"),
        (
            ("sweep", "rename", "s", "My_Sweep"),
            "NEW: expected a name of lower-case letters, digits, - and ., found 'My_Sweep'; try my-sweep",
        ),
        (("sweep", "rename", "s", "t"), "a sweep 't' is known already"),
        (("sweep", "rename", "far", "x"), "is a cluster's"),
        (("sweep", "remove", "nosuch"), "unknown sweep 'nosuch'"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(
    lab: Any, slamhive: Callable[..., Any], hall: Path, words: tuple[str, ...], sentence: str
) -> None:
    lab.run("a", dataset="den")
    for name, fields in (("s", {}), ("t", {}), ("far", {"namespace": "lab", "cluster": "c"})):
        lab.sweep(name, **fields)
    before = lab.records()
    said = slamhive(*words)
    assert (said.code, sentence in said.err) == (2, True), said.err
    assert (lab.records(), names(lab), hall.exists()) == (before, {"hall"}, True)


@pytest.mark.parametrize(
    "words",
    [
        ("dataset", "remove", "hall", "--yes"),
        ("dataset", "rename", "hall", "room"),
        ("sweep", "rename", "s", "t"),
        ("sweep", "remove", "s", "--yes"),
    ],
)
def test_nothing_changes_while_a_runner_is_at_work(
    lab: Any, slamhive: Callable[..., Any], hall: Path, words: tuple[str, ...]
) -> None:
    lab.sweep("s")
    lab.run("a")
    before = lab.records()
    with lock(lab.home.path / "runner.lock"):
        said = slamhive(*words)
    assert (said.code, "at work" in said.err) == (2, True)
    assert (lab.records(), names(lab)) == (before, {"hall"})


def hashed(lab: Any, name: str, **fields: Any) -> Any:
    """Keep a run whose hashes are those of what it says."""
    spec = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}, "sensors": "lidar", "input": {}}
    spec |= {"parameters": {}, "resources": {}, "repetition": 0, "seed": 0}
    record = lab.run(name, spec=spec, **fields)
    digest = spec_hash(spec)
    known = record.provenance
    content = content_hash(digest, "v1", str(known.dataset_sha256), "1", "e")
    record = record.replace(provenance=known.replace(spec_hash=digest, content_hash=content))
    with lab.archive() as archive:
        archive.put_run(record, dataset=CatalogEntry.of(dataset("hall")))
    return record


def test_a_renamed_dataset_keeps_its_results_under_the_new_name(
    lab: Any, slamhive: Callable[..., Any], hall: Path
) -> None:
    record = hashed(lab, "a")
    hashed(lab, "other", namespace="lab", cluster="c")
    said = slamhive("dataset", "rename", "hall", "room")
    assert (said.code, names(lab)) == (0, {"room"})
    assert "1 run of a cluster or an import keep the name" in said.err
    found = lab.records()
    now = found["u-a"]
    assert now.spec == record.spec | {"datasetRef": {"name": "room"}}
    assert found["u-other"].spec == record.spec
    # Nothing else is another, but for the hashes, by which a sweep over the new name finds the result.
    assert now.provenance.spec_hash == spec_hash(now.spec)
    assert now.replace(spec=record.spec, provenance=record.provenance) == record
    with lab.archive() as archive:
        assert archive.find_reusable(str(now.provenance.content_hash)) == now
        assert [entry.name for entry in archive.catalog("Dataset")] == ["hall", "room"]
    (item,) = load_file(lab.home.path / "datasets" / "room" / "dataset.yaml")
    assert item == dataset("room")
    assert hall.with_name("room-" + "a" * 16).is_dir()
    table = slamhive("results", "table", "--where", "dataset == 'room'")
    assert "icp room 0.1" in table.out


def test_what_was_generated_is_found_by_the_new_name(lab: Any, slamhive: Callable[..., Any]) -> None:
    root = lab.home.folder("datasets")
    add_dataset(dataset("hall"), root, root)
    made = unlisting.made_folder(dataset("hall"), root)
    made.mkdir()
    (made / "sensors.json").write_text('{"sensors": {}}')
    assert slamhive("dataset", "rename", "hall", "room").code == 0
    assert materialise(dataset("room"), root, root).root.name == made.name.replace("hall", "room")


class Killed(BaseException):
    """The end of the process."""


@pytest.mark.parametrize("steps", range(5))
def test_an_interrupted_renaming_is_gone_on_with(
    lab: Any, slamhive: Callable[..., Any], hall: Path, monkeypatch: pytest.MonkeyPatch, steps: int
) -> None:
    hashed(lab, "a")
    left = steps

    def dying(call: Callable[..., Any]) -> Callable[..., Any]:
        def step(*given: Any) -> Any:
            nonlocal left
            left -= 1
            if left < 0:
                raise Killed
            return call(*given)

        return step

    with monkeypatch.context() as patched:
        patched.setattr(unlisting, "write_whole", dying(unlisting.write_whole))
        patched.setattr(unlisting, "_rename_records", dying(unlisting._rename_records))
        patched.setattr(type(hall), "rename", dying(type(hall).rename))
        with pytest.raises(Killed):
            slamhive("dataset", "rename", "hall", "room")
    assert len(names(lab)) == 1
    assert slamhive("results", "show", "a").code == 0
    if steps:
        said = slamhive("dataset", "rename", "hall", "den")
        assert (said.code, "finish it first: slamhive dataset rename hall room" in said.err) == (2, True)
    assert slamhive("dataset", "rename", "hall", "room").code == 0
    assert names(lab) == {"room"}
    assert lab.records()["u-a"].spec["datasetRef"]["name"] == "room"
    assert hall.with_name("room-" + "a" * 16).is_dir()
    assert slamhive("dataset", "rename", "room", "hall").code == 0


def test_of_a_run_that_was_edited_and_done_again_the_current_one_is_meant(
    lab: Any, slamhive: Callable[..., Any]
) -> None:
    for version in ("v1", "v2", "v3"):
        with Archive.open(lab.home.archive_url) as archive:
            set_aside(archive, "u-a")
        lab.run("a", version=version, content=f"{version}-content")
    said = slamhive("results", "show", "a", "--json")
    assert [row["provenance.algorithmHash"] for row in json.loads(said.out)] == ["v3"]
    assert "3 runs are called a: u-a is the current one; by UID: u-a@v1-conte, u-a@v2-conte" in said.err
    assert "v1" in slamhive("results", "show", "u-a@v1-conte").out
    viewed = slamhive("view", "a")
    assert "u-a is the current one" in viewed.err
    assert "name one by its UID" not in viewed.err


def test_an_algorithms_folder_stays_where_it_was_added_from(
    lab: Any, slamhive: Callable[..., Any], tmp_path: Path
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "algorithm.yaml").touch()
    (lab.home.folder("algorithms") / "mine").symlink_to(mine)
    said = slamhive("algorithm", "remove", "mine", "--yes")
    assert (said.code, "which stays" in said.out) == (0, True)
    assert (mine / "algorithm.yaml").exists()
    assert not (lab.home.path / "algorithms" / "mine").is_symlink()


def test_a_sweep_is_called_otherwise_and_stays_the_same(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.sweep("s")
    record = lab.run("a")
    assert slamhive("sweep", "rename", "s", "paper").code == 0
    assert lab.records() == {record.uid: record.replace(sweep="paper")}
    assert '"sweep": "paper"' in slamhive("sweep", "list", "--json").out
    assert "sweep paper" in slamhive("results", "show", "a").out
    assert "0.1" in slamhive("results", "table", "--sweep", "paper").out


def test_a_file_with_the_earlier_name_of_a_sweep_is_refused(lab: Any, slamhive: Callable[..., Any]) -> None:
    template = {"spec": {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}}
    sweep = Sweep.model_validate({"metadata": {"name": "s"}, "spec": {"template": template}})
    with lab.archive() as archive:
        archive.put_sweep(SweepRecord(uid=local_uid(sweep), name="s", spec={}))
        require_own_name(archive, [sweep])
        slamhive("sweep", "rename", "s", "paper")
        with pytest.raises(InputError, match="renamed to 'paper': write that into its file"):
            require_own_name(archive, [sweep])


def test_a_sweep_is_forgotten_with_its_runs(lab: Any, slamhive: Callable[..., Any]) -> None:
    lab.sweep("s")
    lab.sweep("t")
    lab.run("a")
    lab.run("b", sweep="t")
    said = slamhive("sweep", "remove", "s", "--yes")
    assert "files and records of 1 run" in said.out
    assert set(lab.records()) == {"u-b"}
    assert not (lab.home.path / "runs" / "s").exists()
    with lab.archive() as archive:
        assert [one.name for one in archive.sweeps()] == ["t"]
    assert '"bytes"' in slamhive("sweep", "list", "--size", "--json").out
