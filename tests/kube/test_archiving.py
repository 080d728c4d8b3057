# SPDX-License-Identifier: Apache-2.0
"""Runs that leave the cluster for the archive."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.kube.reconciling.archiving import at_its_end
from slamhive.kube.reconciling.records import record_of
from slamhive.kube.reconciling.sweep_runs import Tally

if TYPE_CHECKING:
    from pathlib import Path

RESULT = {"evaluation": "SE3", "outcome": "Tracked", "coverage": 1.0, "ate": {"rmse": 0.25}}
TRAJECTORY = {"poses": 10, "durationSeconds": 1.0, "sha256": "0" * 64, "path": "output/trajectory.txt"}


def a_run(**status: Any) -> dict[str, Any]:
    spec = {"algorithmRef": {"name": "icp"}, "datasetRef": {"name": "hall"}}
    meta = {"name": "r", "uid": "u", "labels": {"slamhive.io/point": "3"}}
    return {
        "metadata": meta,
        "spec": spec,
        "status": {"phase": "Succeeded", "trajectory": TRAJECTORY} | status,
    }


@pytest.mark.parametrize("known", ["with its result", "without", "without, never archived", "no archive"])
async def test_what_another_operator_measured_and_removed_counts(tmp_path: Path, known: str) -> None:
    with Archive.open(f"sqlite:///{tmp_path / 'a.sqlite'}") as archive:
        if "never" not in known:
            archive.put_run(record_of(a_run(results=[RESULT]), attributes={}))
        op: Any = SimpleNamespace(archive=None if known == "no archive" else archive)
        seen = a_run(results=[RESULT]) if known == "with its result" else a_run()
        tally = Tally()
        tally.add(await at_its_end(op, seen))
    measured = known in {"with its result", "without"}
    assert (tally.evaluated, [item["ate"] for item in tally.best]) == ((1, [0.25]) if measured else (0, []))
