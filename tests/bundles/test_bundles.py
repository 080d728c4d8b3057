# SPDX-License-Identifier: Apache-2.0
"""Bundles: equal bytes, figures that come out alike elsewhere, and mistakes of those that were changed."""

from __future__ import annotations

import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from furnishing import furnish
from slamhive.archive import Archive, SweepRecord
from slamhive.bridges.bundles import verifying
from slamhive.data.files import unpacking
from slamhive.local.home.folder import Home
from slamhive.model.results import IMPORTED, Phase, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    Command = Callable[..., tuple[int, str, str]]

HERE = Path(__file__).parent
BESIDE = """\
apiVersion: slamhive.io/v1alpha1
kind: Dataset
metadata: {name: own}
spec:
  recording: {files: [{path: recording.bag}]}
  sensors: {lidar: {type: Lidar, topic: /points}}
  groundTruth: {file: own.txt}
---
apiVersion: slamhive.io/v1alpha1
kind: Sweep
metadata: {name: beside}
spec: {template: {spec: {algorithmRef: {name: actor}, datasetRef: {name: own}}}}
"""
AGREE = "figures of 2 results of 2 runs agree to the last digit, 0 do not"


def records(home: Path) -> dict[str, Any]:
    with Archive.open(Home.at(home).archive_url, read_only=True) as archive:
        return {record.uid: record for record in archive.runs()}


def copied(studied: Path, folder: Path) -> Path:
    """Return a copy of the home, without what SQLite has beside the archive while another test reads it."""
    ignored = shutil.ignore_patterns("archive.sqlite-*")
    return Path(shutil.copytree(studied, folder / "home", symlinks=True, ignore=ignored))


def test_a_study_bundled_twice_gives_the_same_bytes(
    studied: Path, study: Path, tmp_path: Path, run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(studied))
    again = tmp_path / "again.zip"
    words = ("-o", again, "--license", "CC-BY-4.0", "--author", "A. Author")
    code, out, err = run_command("bundle", "acts", *words)
    assert code == 0, err
    assert "4 runs, 2 with trajectories" in out
    assert again.read_bytes() == study.read_bytes()
    with zipfile.ZipFile(again) as archive:
        told = json.loads(archive.read("study.json"))
        crate = json.loads(archive.read("ro-crate-metadata.json"))
        everything = b"".join(archive.read(name) for name in archive.namelist())
    assert [one["name"] for one in told["datasets"]] == ["tiny"]
    assert len(told["datasets"][0]["truth"]) == len(told["datasets"][0]["recordings"][0]) == 64
    actions = [one for one in crate["@graph"] if one["@type"] == "CreateAction"]
    assert sorted(one["actionStatus"].rpartition("/")[2] for one in actions) == [
        *["CompletedActionStatus"] * 2,
        *["FailedActionStatus"] * 2,
    ]
    assert str(studied).encode() not in everything
    code, _, err = run_command("bundle", "acts", "-o", again)
    assert code == 2
    assert "exists already" in err


def test_a_dataset_that_stood_beside_its_sweep_is_the_archives(
    studied: Path, study: Path, tmp_path: Path, run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = copied(studied, tmp_path)
    (home / "datasets").unlink()
    (home / "datasets").mkdir()
    for made in (studied / "datasets").glob("tiny-*"):
        (home / "datasets" / made.name).symlink_to(made)
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    words = ("-o", tmp_path / "again.zip", "--license", "CC-BY-4.0", "--author", "A. Author")
    code, _, err = run_command("bundle", "acts", *words)
    assert code == 0, err
    assert (tmp_path / "again.zip").read_bytes() == study.read_bytes()


def test_a_dataset_with_files_beside_its_sweep_is_found_by_that_file(
    studied: Path, tiny: Path, tmp_path: Path, run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, folder = tmp_path / "home", tmp_path / "mine"
    shutil.copytree(studied, home, symlinks=True, ignore=shutil.ignore_patterns("archive.*", "runs"))
    shutil.copytree(next(tiny.glob("tiny-*")), folder)
    # Nor is its algorithm known by name: that one stood in a file of the command, too.
    shutil.copytree(home / "algorithms" / "actor", folder, dirs_exist_ok=True)
    shutil.rmtree(home / "algorithms")
    (folder / "mine.yaml").write_text(BESIDE)
    (folder / "edited.yaml").write_text(BESIDE.replace("topic: /points", "topic: /other"))
    (folder / "groundtruth.txt").rename(folder / "own.txt")
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    code, _, err = run_command("run", folder / "algorithm.yaml", folder / "mine.yaml")
    assert code == 0, err
    file = tmp_path / "new.zip"
    for more, said in (
        ([], "dataset 'own' has files of its own and is not known here"),
        (["--dataset", folder / "edited.yaml"], "dataset: 'own' is not as the runs used it"),
        (["--dataset", folder / "algorithm.yaml"], "no Dataset in it"),
    ):
        code, _, err = run_command("bundle", "beside", "-o", file, *more)
        assert code == 2
        assert said in " ".join(err.split())
        assert not file.exists()
    code, _, err = run_command("bundle", "beside", "-o", file, "--dataset", folder / "mine.yaml")
    assert code == 0, err
    code, out, err = run_command("verify", file, "--ground-truth", folder)
    assert code == 0, err
    assert "of 1 result of 1 run agree to the last digit, 0 do not" in " ".join(out.split())


def test_a_study_stays_its_own_beside_the_same_program_of_somebody_else(
    studied: Path, study: Path, tmp_path: Path, run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = copied(studied, tmp_path)
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    code, _, err = run_command("import", study, "--label", "lab")
    assert code == 0, err
    again = tmp_path / "again.zip"
    words = ("-o", again, "--license", "CC-BY-4.0", "--author", "A. Author")
    code, _, err = run_command("bundle", "acts", *words)
    assert code == 0, err
    assert again.read_bytes() == study.read_bytes()
    with Archive.open(Home.at(home).archive_url) as archive:
        archive.remove_run(next(iter(records(studied))))
    code, out, err = run_command("bundle", "acts", "-o", tmp_path / "part.zip")
    assert code == 0, err
    assert "the other 1 of the 4 that were asked for have not finished and are not in it" in " ".join(
        (out + err).split()
    )


def test_runs_of_the_original_slam_hive_are_refused(
    elsewhere: Path, tmp_path: Path, run_command: Command
) -> None:
    spec = {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "tiny"}, "sensors": "mono"}
    record = RunRecord(uid="1", name="run-1", spec=spec, phase=Phase.SUCCEEDED, labels={"source": IMPORTED})
    with Archive.open(Home.at(elsewhere).archive_url) as archive:
        archive.put_sweep(SweepRecord(uid=IMPORTED, name=IMPORTED, spec={}))
        archive.put_run(record.replace(sweep=IMPORTED, sweep_uid=IMPORTED))
    code, _, err = run_command("bundle", IMPORTED, "-o", tmp_path / "new.zip")
    assert code == 2
    assert "came from the original SLAM Hive, which has no manifests of what ran" in " ".join(err.split())
    assert not (tmp_path / "new.zip").exists()


def test_figures_agree_where_nobody_knows_the_system(
    elsewhere: Path, study: Path, run_command: Command
) -> None:
    code, out, err = run_command("verify", study)
    assert code == 0, err
    assert AGREE in " ".join(out.split())
    assert not records(elsewhere)


@pytest.mark.parametrize("name", ["runs", "study.json", "manifests/sweep.yaml", "ro-crate-metadata.json"])
def test_one_byte_that_changed_is_named(
    *,
    elsewhere: Path,
    study: Path,
    trajectories: list[str],
    rezip: Callable[..., Path],
    run_command: Command,
    name: str,
) -> None:
    name = trajectories[0] if name == "runs" else name
    with zipfile.ZipFile(study) as archive:
        content = bytearray(archive.read(name))
    content[-3] ^= 1
    code, _, err = run_command("verify", rezip({name: bytes(content)}))
    assert code == 2
    assert name in err.replace("\n", "")
    code, _, err = run_command("import", rezip({name: bytes(content)}))
    assert code == 2
    assert not (elsewhere / "runs").exists()


def test_one_byte_of_the_archive_that_changed_is_named(
    elsewhere: Path, study: Path, tmp_path: Path, trajectories: list[str], run_command: Command
) -> None:
    content = bytearray(study.read_bytes())
    with zipfile.ZipFile(study) as archive:
        info = archive.getinfo(trajectories[0])
    content[info.header_offset + 30 + len(info.filename) + 200] ^= 1
    (tmp_path / "study.zip").write_bytes(content)
    code, _, err = run_command("verify", tmp_path / "study.zip")
    assert code == 2
    assert "study.zip: is damaged" in err


def test_figures_that_were_made_up_are_named(
    elsewhere: Path, study: Path, trajectories: list[str], rezip: Callable[..., Path], run_command: Command
) -> None:
    name = trajectories[1].replace("trajectory.txt", "run.json")
    with zipfile.ZipFile(study) as archive:
        run = json.loads(archive.read(name))
    run["record"]["results"][0]["values"]["ate"]["rmse"] += 0.25
    changed = rezip({name: json.dumps(run).encode()}, forged=True)
    code, out, _ = run_command("verify", changed)
    assert code == 1
    (line,) = [line for line in out.splitlines() if "ate.rmse" in line]
    assert line.startswith(f"{name.split('/')[1]}   se3   ".rstrip())
    assert "agree to the last digit, 1 do not" in " ".join(out.split())
    code, out, _ = run_command("verify", changed, "--json")
    told = json.loads(out)
    assert [one["figure"] for one in told if one["kind"] == "mismatch"] == ["ate.rmse"]
    assert told[-1]["differ"] == 1


@pytest.mark.parametrize("able", [1, 0])
def test_runs_that_take_too_much_together_are_computed_one_by_one(
    *, able: int, elsewhere: Path, study: Path, run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = verifying.Recomputing.__call__

    def greedy(self: verifying.Recomputing, tasks: list[Any], truths: dict[str, Any]) -> Any:
        if len(tasks) > able:
            os.kill(os.getpid(), signal.SIGXCPU)
        return answer(self, tasks, truths)

    monkeypatch.setattr(verifying.Recomputing, "__call__", greedy)
    monkeypatch.setattr(verifying, "_GROUPS", 1)
    code, out, _ = run_command("verify", study, "-j", "1", "--json")
    *lines, total = json.loads(out)
    assert code == total["differ"] / 2 == len(lines) / 2 == 1 - able
    assert {one["recomputed"] for one in lines} <= {"it takes more than 600 s of CPU time"}


BROKEN: dict[str, dict[str, bytes | None]] = {
    "lacks a file": {"{trajectory}": None},
    "lacks the crate": {"ro-crate-metadata.json": None},
    "leaves its folder": {"../outside.txt": b"x"},
    "holds more": {"runs/more.txt": b"x"},
    "another form": {"study.json": b'{"form": "slamhive-study/9"}'},
    "no JSON": {"study.json": b"[" * 100_000},
    "a wrong field": {"study.json": b'{"form": "slamhive-study/1", "name": 3}'},
    "a wrong name": {"{run}": b'{"record": {"uid": "u", "name": "../x", "spec": {}, "phase": "Failed"}}'},
}


def broken(rezip: Callable[..., Path], kind: str, trajectory: str, folder: Path) -> Path:
    if kind in BROKEN:
        run = trajectory.replace("trajectory.txt", "run.json")
        changes = {name.format(trajectory=trajectory, run=run): one for name, one in BROKEN[kind].items()}
        return rezip(changes, forged=kind == "a wrong name")
    path = folder / f"{kind}.zip"
    if kind == "other":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("readme.txt", "x")
    elif kind == "rare":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as archive:
            archive.writestr("study.json", "{}")
    else:
        path.write_text("no archive")
    return path


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("lacks a file", "changed.zip: lacks {trajectory}"),
        ("lacks the crate", "changed.zip: lacks ro-crate-metadata.json"),
        ("leaves its folder", "'../outside.txt' leads outside of its folder: refused"),
        ("holds more", "holds what study.json doesn't name: runs/more.txt"),
        (
            "another form",
            "study.json: form is 'slamhive-study/9', and this slamhive reads 'slamhive-study/1'",
        ),
        ("no JSON", "study.json: is no JSON"),
        ("a wrong field", "study.json: name: must be a text, found '3'"),
        ("a wrong name", "run.json: algorithm: Field required"),
        ("other", "has no study.json: it is no bundle of slamhive bundle"),
        ("text", "text.zip: is damaged, or no zip file"),
        ("rare", "rare.zip: study.json: is encrypted or packed in a rare way: refused"),
    ],
)
def test_what_is_no_bundle_is_refused_by_name(
    *,
    elsewhere: Path,
    rezip: Callable[..., Path],
    trajectories: list[str],
    tmp_path: Path,
    run_command: Command,
    kind: str,
    said: str,
) -> None:
    path = broken(rezip, kind, trajectories[0], tmp_path)
    assert "a folder; a bundle is one .zip file" in " ".join(run_command("verify", tmp_path)[2].split())
    for command in ("verify", "import"):
        code, _, err = run_command(command, path)
        assert code == 2
        assert said.format(trajectory=trajectories[0]) in " ".join(err.split())
    assert not (elsewhere / "archive.sqlite").exists() or not records(elsewhere)
    assert not (tmp_path / "outside.txt").exists()


def test_an_archive_that_grows_beyond_all_bounds_is_refused(
    elsewhere: Path, rezip: Callable[..., Path], run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 16)
    monkeypatch.setattr(unpacking, "MOST_RATIO", 4)
    code, _, err = run_command("verify", rezip({"runs/zeros": bytes(4 << 20)}))
    assert code == 2
    assert "refused as no archive of data does" in " ".join(err.split())


def test_ground_truth_that_is_not_here_is_said(
    *,
    tmp_path: Path,
    study: Path,
    tiny: Path,
    rezip: Callable[..., Path],
    run_command: Command,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    home = tmp_path / "empty"
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    with zipfile.ZipFile(study) as archive:
        told = json.loads(archive.read("study.json"))
    told["datasets"][0]["truth"] = "0" * 64
    truths = tmp_path / "truths"
    truths.mkdir()
    shutil.copyfile(next(tiny.glob("tiny-*/groundtruth.txt")), truths / "tiny.txt")
    content = json.dumps(told).encode()
    code, out, err = run_command("verify", rezip({"study.json": content}), "--ground-truth", truths)
    assert code == 2
    assert "study.json: not what README.md has the checksum of" in " ".join(err.split())
    older = rezip({"study.json": content, "README.md": b"# Study\n"}, forged=True)
    assert run_command("verify", older, "--ground-truth", truths)[0] == 1
    changed = rezip({"study.json": content}, forged=True)
    code, out, err = run_command("verify", changed, "--ground-truth", truths)
    assert code == 1
    assert "is another one: checksum" in " ".join(err.split())
    assert "0 figures of 0 results" in out
    code, out, err = run_command("verify", study, "--ground-truth", truths)
    assert code == 0, err
    assert AGREE in " ".join(out.split())
    with zipfile.ZipFile(study) as archive:
        manifest = next(name for name in archive.namelist() if "/datasets/" in name)
    other = "apiVersion: slamhive.io/v1alpha1\nkind: Dataset\nmetadata: {name: tiny}\nspec:\n"
    other += "  recording: {format: Rosbag1, files: [{path: a.bag}]}\n"
    other += "  sensors: {lidar: {type: Lidar, topic: /p}}\n"
    code, out, err = run_command("verify", rezip({manifest: other.encode()}, forged=True))
    assert code == 1
    assert "dataset tiny: its ground truth isn't here" in " ".join(err.split())


def test_runs_come_as_somebody_elses_and_are_repeated(
    *,
    tmp_path: Path,
    environments: Path,
    tiny: Path,
    study: Path,
    run_command: Command,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    home = furnish(tmp_path / "home", environments, tiny)
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    code, out, err = run_command("import", study)
    assert code == 0, err
    assert "4 runs imported, 0 here already" in out
    code, out, _ = run_command("import", study)
    assert "0 runs imported, 4 here already" in out
    foreign = records(home)
    assert {one.origin.kind for one in foreign.values()} == {"Bundle"}
    assert {one.spec["algorithmRef"]["name"] for one in foreign.values()} == {"actor @study"}
    assert {one.provenance.content_hash for one in foreign.values()} == {None}

    def origins() -> set[str]:
        _, told, _ = run_command("results", "list", "--format", "json", "--columns", "algorithm,origin")
        return {f"{one['algorithm']}: {one['origin']}" for one in json.loads(told)}

    assert origins() == {"actor @study: somebody else's (study)"}
    # Nobody takes over their results: this one runs.
    code, out, err = run_command("verify", study, "--repeat", "1")
    assert code == 0, err
    assert "done again" in out
    assert "+0.00 standard deviations" in out
    own = [one for one in records(home).values() if one.origin is None]
    assert [one.provenance.reused_from for one in own] == [None]
    assert origins() == {
        "actor: run here",
        "actor @study: somebody else's (study)",
        "actor @study: repeated here (study)",
    }
    code, out, err = run_command("results", "table", "--rows", "dataset", "--outcomes", "all")
    assert code == 0, err
    assert {"actor", "actor @study"} <= {line.partition("   ")[0] for line in out.splitlines()}
    assert "actor @study: repeated here and somebody else's (4 runs from Study acts (study.zip))" in err
    # Load is never set beside that of others.
    code, out, err = run_command(
        "results", "table", "-m", "usage.cpu.seconds", "--rows", "dataset", "--format", "json"
    )
    assert code == 0, err
    assert {one["origin"] for one in json.loads(out)} >= {"run here"}
    code, _, err = run_command("bundle", "acts @study", "-o", tmp_path / "mine.zip")
    assert code == 2
    assert "is somebody else's" in err


def test_other_bundles_need_other_labels(
    elsewhere: Path, study: Path, rezip: Callable[..., Path], run_command: Command
) -> None:
    assert run_command("import", study)[0] == 0
    other = rezip({"README.md": b"another"}, forged=True)
    code, _, err = run_command("import", other, "--label", "study")
    assert code == 2
    assert "is taken: actor @study is from Study acts (study.zip)" in " ".join(err.split())
    assert run_command("import", other)[0] == 0
    assert len(records(elsewhere)) == 8


def test_an_anonymous_bundle_tells_nothing_and_is_verified(
    studied: Path, elsewhere: Path, tmp_path: Path, run_command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLAMHIVE_HOME", str(studied))
    path = tmp_path / "review.zip"
    code, _, err = run_command("bundle", "acts", "-o", path, "--anonymous", "--author", "A. Author")
    assert code == 2
    assert "leave out --author" in err
    code, _, err = run_command("bundle", "acts", "-o", path, "--anonymous")
    assert code == 0, err
    with zipfile.ZipFile(path) as archive:
        everything = b"\n".join(archive.read(name) for name in archive.namelist()).decode()
        run = json.loads(archive.read(next(n for n in archive.namelist() if n.endswith("run.json"))))
    assert platform.node() not in everything
    assert str(Path.home()) not in everything
    assert "A. Author" not in everything
    assert not {"created", "started", "finished", "message"} & run["record"].keys()
    assert "node" not in run["record"]["provenance"]
    monkeypatch.setenv("SLAMHIVE_HOME", str(elsewhere))
    code, out, err = run_command("verify", path)
    assert code == 0, err
    assert AGREE in " ".join(out.split())
    assert run_command("import", path)[0] == 0


@pytest.mark.slow
def test_the_validator_of_crates_finds_nothing(study: Path, tmp_path: Path) -> None:
    # In an environment of its own, as it wants an older rich than ours.
    python = tmp_path / "validator" / "bin" / "python"
    uv = Path(sys.executable).with_name("uv")
    subprocess.run([uv, "venv", "--quiet", python.parents[1]], check=True)
    packages = ["--require-hashes", "--requirement", HERE / "validator.txt"]
    subprocess.run([uv, "pip", "install", "--quiet", "--python", python, *packages], check=True)

    def validate(path: Path) -> subprocess.CompletedProcess[str]:
        command = [python, HERE / "validate.py", path]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)

    found = validate(study)
    assert (found.returncode, found.stdout) == (0, "47 checks\n"), found.stdout + found.stderr
    changed = tmp_path / "changed.zip"
    with zipfile.ZipFile(study) as archive, zipfile.ZipFile(changed, "w") as other:
        for name in archive.namelist():
            content = archive.read(name)
            if name == "ro-crate-metadata.json":
                content = content.replace(b'"instrument"', b'"instruments"')
            other.writestr(name, content)
    found = validate(changed)
    assert found.returncode == 1
    assert "instrument" in found.stdout
