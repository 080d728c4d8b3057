# SPDX-License-Identifier: Apache-2.0
"""Homes with records of runs that nobody had to run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, SweepRecord
from slamhive.local.home.folder import Home
from slamhive.model.results import Outcome, Phase, Provenance, Result, RunRecord, TrajectoryInfo

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NOW = datetime(2026, 11, 20, tzinfo=UTC)


@dataclass
class Kept:
    """A home, and what can be put into it."""

    home: Home
    numbers: int = 0

    @property
    def path(self) -> Path:
        """Path of the home."""
        return self.home.path

    def run(self, uid: str, *, content: str = "c1", version: str = "v1", **fields: Any) -> RunRecord:
        """Keep a finished run of an algorithm ``icp``, with a folder of files."""
        self.numbers += 1
        error, sweep, name = (
            fields.pop("error", 0.1),
            fields.pop("sweep", "s"),
            fields.pop("name", f"s-{uid}"),
        )
        folder, dataset = self.path / "runs" / sweep / name, fields.pop("dataset_version", "d1")
        output = folder / "run" / "output"
        if fields.pop("files", True):
            output.mkdir(parents=True, exist_ok=True)
            (output / "trajectory.txt").write_text(f"0 0 0 0 0 0 0 1\n# {content}\n")
            (folder / "summary.json").write_text("{}")
            (folder / "attempt.json").write_text(json.dumps({"uid": uid, "contentHash": content * 32}))
        moment = NOW + timedelta(seconds=self.numbers)
        results = fields.pop(
            "results", [Result(evaluation="se3", outcome=Outcome.TRACKED, values={"ate": {"rmse": error}})]
        )
        record = RunRecord(
            **{
                "uid": uid,
                "name": name,
                "sweep": sweep,
                "sweep_uid": f"{sweep}-uid",
                "spec": {
                    "algorithmRef": {"name": "icp"},
                    "datasetRef": {"name": "hall"},
                    "sensors": "lidar",
                },
                "phase": Phase.SUCCEEDED,
                "created": moment,
                "finished": moment,
                "folder": str(folder),
                "trajectory": TrajectoryInfo(
                    poses=1, duration_seconds=0, sha256="x", path=str(output / "trajectory.txt")
                ),
                "results": results,
                "provenance": Provenance(
                    content_hash=content * 32,
                    algorithm_hash=version,
                    dataset_sha256=dataset,
                    preparation="1",
                    environment="e",
                ),
                **fields,
            }
        )
        with Archive.open(self.home.archive_url) as archive:
            archive.put_sweep(SweepRecord(uid=f"{sweep}-uid", name=sweep, spec={}, created=NOW))
            archive.put_run(record)
        return record

    def records(self) -> dict[str, RunRecord]:
        """Return all records by UID."""
        with Archive.open(self.home.archive_url) as archive:
            return {record.uid: record for record in archive.runs()}


@pytest.fixture
def keep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Kept]:
    """Makes homes; the one called ``mine`` is ours."""
    monkeypatch.setenv("SLAMHIVE_HOME", str(tmp_path / "mine"))
    for name in ("SLAMHIVE_ARCHIVE", "SLAMHIVE_ALSO"):
        monkeypatch.delenv(name, raising=False)

    def made(name: str) -> Kept:
        (tmp_path / name).mkdir(exist_ok=True)
        return Kept(Home.at(tmp_path / name))

    return made
