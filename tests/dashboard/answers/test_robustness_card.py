# SPDX-License-Identifier: Apache-2.0
"""Robustness card of the dashboard: the same numbers as the command's, and complaints with their field."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive, SweepRecord
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.results import Outcome, Result

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from slamhive.model.results import RunRecord

AXIS = "parameters.nFeatures"
SEARCH = {"method": "Threshold", "axis": AXIS, "failing": {"metric": "ate.rmse", "above": 0.35}}


@pytest.fixture
async def site(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """A dashboard over a search for the number of features at which the error is too large."""
    runs = [
        make_run(
            number,
            uid=f"run-{number}",
            sweep="search",
            sweepUid="search",
            spec={"algorithmRef": {"name": "orb"}, "datasetRef": {"name": "hall"}},
            parameters={"nFeatures": number + 1},
            results=[
                Result(
                    evaluation="se3",
                    outcome=Outcome.TRACKED,
                    coverage=1.0,
                    values={"alignment": "se3", "ate": {"rmse": 0.1 * (number + 1)}},
                )
            ],
        )
        for number in range(6)
    ]
    with Archive.open(url) as archive:
        archive.put_sweep(
            SweepRecord(uid="search", name="search", spec={"matrix": [{"path": AXIS}], "search": SEARCH})
        )
        archive.put_runs(runs)
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


async def test_a_card_is_by_what_was_sought(site: Any) -> None:
    card = await site.get("/analysis/robustness")
    assert [axis["name"] for axis in card["axes"]] == [AXIS]
    ((cell,),) = [system["cells"] for system in card["systems"]]
    assert (cell["status"], cell["passing"], cell["failing"], cell["falls"]) == ("found", 3, 4, False)
    assert [one["failed"] for one in cell["values"]] == [0, 0, 0, 1, 1, 1]
    assert "failed are runs with ate.rmse above 0.35, Lost or Diverged" in " ".join(card["notes"])


async def test_a_run_that_a_search_chose_says_so(site: Any) -> None:
    (note,) = (await site.get("/runs/run-2"))["notes"]
    assert note.startswith("¶ a search (Threshold) chose this run")


async def test_another_rule_and_the_table(site: Any) -> None:
    ((cell,),) = [
        system["cells"]
        for system in (await site.get("/analysis/robustness?failing=ate.rmse>0.15"))["systems"]
    ]
    assert (cell["passing"], cell["failing"]) == (1, 2)
    table = await site.raw.get("/api/v1/analysis/robustness?format=csv")
    rows = csv.DictReader(io.StringIO(table.text))
    assert [(row["axis"], row["passes"], row["fails"]) for row in rows] == [(AXIS, "3.0", "4.0")]


@pytest.mark.parametrize(
    ("asked", "field"), [("axes=algorithm", "axes"), ("axes=nothing", "axes"), ("failing=x ~ 1", "failing")]
)
async def test_bad_input_names_its_field(site: Any, asked: str, field: str) -> None:
    told = await site.get(f"/analysis/robustness?{asked}", 400)
    assert told["field"] == field, told
