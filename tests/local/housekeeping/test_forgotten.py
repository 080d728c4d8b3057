# SPDX-License-Identifier: Apache-2.0
"""Runs whose files were removed: they count as before, are not done again, and serve equal runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from slamhive.local.home.linking import LEAST_BYTES
from slamhive.local.housekeeping.forgetting import ArchivedRun, alone, forget, plan_forgetting

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.running.workbench import Workbench

MAP = f"""
with (run / "output" / "map.bin").open("wb") as file:
    file.write(b"m" * {LEAST_BYTES})
"""


def forgotten(bench: Workbench) -> list[ArchivedRun]:
    """Remove the files of all runs, and return the runs."""
    runs = [ArchivedRun(one.uid, one.name, one.sweep, one.folder) for one in bench.archive.runs()]
    plan = plan_forgetting(bench.home.path, runs, {run.uid for run in runs})
    with alone(bench.home, "a test"):
        forget(bench.home, bench.archive, plan)
    return runs


def test_runs_without_files_are_done_and_serve_others(bench: Workbench, run_acts: Callable[..., Any]) -> None:
    run_acts(["good"])
    forgotten(bench)
    job, notes = run_acts(["good"])
    assert (job.kept, notes.records) == (1, [])
    _, notes = run_acts(["good"], name="another")
    (record,) = notes.records
    assert record.provenance.reused_from is not None
    assert record.results[0].values["ate"]["rmse"] < 1e-6


def test_a_map_that_an_edit_does_not_change_stands_once(
    bench: Workbench, run_acts: Callable[..., Any]
) -> None:
    adapter = bench.workshop.algorithm("actor").folder / "adapter.py"
    for text in (MAP, "# edited\n"):
        adapter.write_text(adapter.read_text() + text)
        run_acts(["good"])
    (first, second) = bench.home.path.glob("runs/acts/*/run/output/map.bin")
    assert first.samefile(second)
    assert len(forgotten(bench)) == 2
    assert not list(bench.home.path.glob("runs/acts/*/run"))
