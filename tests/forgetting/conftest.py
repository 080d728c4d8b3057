# SPDX-License-Identifier: Apache-2.0
"""A home with records and folders of runs that nobody had to run, and the command on it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, SweepRecord
from slamhive.cli import main
from slamhive.local.home.folder import Home
from slamhive.model.results import Outcome, Phase, Provenance, Reason, Result, RunRecord, TrajectoryInfo

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NOW = datetime(2026, 11, 20, tzinfo=UTC)
MIB = 1 << 20


@dataclass
class Lab:
    """A home, and what can be put into it."""

    home: Home
    numbers: int = 0

    def run(self, name: str, *, sweep: str = "s", size: int = 1000, **fields: Any) -> RunRecord:
        """Keep a finished run with a folder of files; the largest of them is output/map.bin."""
        self.numbers += 1
        folder = self.home.path / "runs" / sweep / name
        dataset, algorithm = fields.pop("dataset", "hall"), fields.pop("algorithm", "icp")
        version, content = fields.pop("version", "v1"), fields.pop("content", f"{self.numbers:064x}")
        failed = fields.pop("failed", False)
        sha256, age = fields.pop("dataset_sha256", "d1"), fields.pop("age", timedelta())
        output = folder / "run" / "output"
        if fields.pop("files", True):
            output.mkdir(parents=True)
            (output / "map.bin").write_bytes(b"m" * size)
            (output / "trajectory.txt").write_text("0 0 0 0 0 0 0 1\n")
            (folder / "summary.json").write_text("{}")
            (folder / "attempt.json").write_text(json.dumps({"uid": name, "contentHash": content}))
        moment = NOW - age + timedelta(seconds=self.numbers)
        record = RunRecord(
            **{
                "uid": f"u-{name}",
                "name": name,
                "sweep": sweep,
                "sweep_uid": f"{sweep}-uid",
                "spec": {
                    "algorithmRef": {"name": algorithm},
                    "datasetRef": {"name": dataset},
                    "sensors": "lidar",
                },
                "phase": Phase.FAILED if failed else Phase.SUCCEEDED,
                "reason": Reason.ALGORITHM_FAILED if failed else None,
                "created": moment,
                "finished": moment,
                "folder": str(folder),
                "trajectory": TrajectoryInfo(
                    poses=1, duration_seconds=0, sha256="x", path=str(output / "trajectory.txt")
                ),
                "results": []
                if failed
                else [Result(evaluation="se3", outcome=Outcome.TRACKED, values={"ate": {"rmse": 0.1}})],
                "provenance": Provenance(
                    content_hash=content,
                    algorithm_hash=version,
                    dataset_sha256=sha256,
                    preparation="1",
                    environment="e",
                ),
                **fields,
            }
        )
        with self.archive() as archive:
            archive.put_run(record)
        return record

    def sweep(self, name: str, uid: str | None = None, **fields: Any) -> SweepRecord:
        """Keep a sweep as it was asked for."""
        record = SweepRecord(uid=uid or f"{name}-uid", name=name, spec={}, created=NOW, **fields)
        with self.archive() as archive:
            archive.put_sweep(record)
        return record

    def archive(self) -> Archive:
        """Return the archive, to write to it."""
        return Archive.open(self.home.archive_url)

    def records(self) -> dict[str, RunRecord]:
        """Return all records by UID."""
        with self.archive() as archive:
            return {record.uid: record for record in archive.runs()}

    def folder(self, name: str, sweep: str = "s") -> Path:
        """Return the folder of a run."""
        return self.home.path / "runs" / sweep / name

    def files(self) -> set[str]:
        """Return all files below ``runs``, by their paths from there."""
        runs = self.home.path / "runs"
        return {str(path.relative_to(runs)) for path in runs.rglob("*") if not path.is_dir()}


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """A home of its own."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("SLAMHIVE_HOME", str(home))
    monkeypatch.delenv("SLAMHIVE_ARCHIVE", raising=False)
    monkeypatch.chdir(tmp_path)
    return Lab(Home.at(home))


@dataclass(frozen=True)
class Said:
    """Exit code and output of a `slamhive` command."""

    code: int
    out: str
    err: str


@pytest.fixture
def slamhive(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """The command, in this process; its lines have single spaces."""

    def call(*words: str) -> Said:
        monkeypatch.setattr("sys.argv", ["slamhive", *words])
        code = 0
        try:
            main.main()
        except SystemExit as end:
            code = int(end.code or 0)
        told = capsys.readouterr()
        return Said(code, *(" ".join(text.split()) for text in (told.out, told.err)))

    return call
