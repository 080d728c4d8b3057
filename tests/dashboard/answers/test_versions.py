# SPDX-License-Identifier: Apache-2.0
"""Earlier versions: left out unless asked for, counted, and compared with the current ones."""

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

SETTINGS = 6
SPEC = {
    "template": {"spec": {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "b"}, "sensors": "stereo"}},
    "matrix": [{"path": "parameters.nFeatures", "values": [1, 2, 3, 4, 5, 6]}],
}


def sweep(uid: str, day: int, **more: Any) -> SweepRecord:
    fields = {"uid": uid, "name": "study", "spec": SPEC, "created": f"2026-01-{day:02d}T00:00:00Z"}
    return SweepRecord.model_validate(fields | more)


def versioned(make_run: Callable[..., RunRecord], version: int, **more: Any) -> list[RunRecord]:
    """Return six runs of a version of an algorithm and of its sweep; each version doubles the error."""
    return [
        make_run(
            10 * version + number,
            uid=f"v{version}-{number}",
            sweep_uid=f"sweep-{version}",
            created=f"2026-01-{version:02d}T00:0{number}:00Z",
            spec={"algorithmRef": {"name": "orb"}, "datasetRef": {"name": "hall"}},
            parameters={"nFeatures": number + 1},
            provenance={"algorithmHash": f"hash-{version}", "contentHash": f"content-{version}-{number}"},
            attributes={},
            results=[
                Result(
                    evaluation="se3",
                    outcome=Outcome.TRACKED,
                    coverage=1.0,
                    values={"alignment": "se3", "ate": {"rmse": 0.1 * 2**version * (number + 1)}},
                )
            ],
            **more,
        )
        for number in range(SETTINGS)
    ]


@pytest.fixture
async def edited(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> AsyncIterator[Any]:
    """A dashboard over a sweep that was edited once, with its algorithm, and one of the name elsewhere."""
    with Archive.open(url) as archive:
        for version in (1, 2):
            archive.put_sweep(sweep(f"sweep-{version}", version))
            archive.put_runs(versioned(make_run, version))
        archive.put_sweep(sweep("lab", 3, namespace="lab", cluster="big"))
        archive.put_run(
            make_run(99, uid="lab-run", sweep_uid="lab", namespace="lab", cluster="big", results=[])
        )
        archive.put_sweep(sweep("idle", 4, name="yet-to-begin"))
    async with open_app(Workstation(url, tmp_path)) as client:
        yield client


QUESTIONS = (
    "runs?",
    "columns?",
    "analysis/points?x=seed&y=ate.rmse",
    "analysis/aggregate?",
    "analysis/leaderboard?",
    "analysis/compare?",
    "analysis/pareto?x=usage.cpu.seconds",
    "analysis/importance?",
    "analysis/repeatability?",
    "analysis/suspects?",
    "analysis/common?",
)


@pytest.mark.parametrize("question", QUESTIONS)
async def test_earlier_versions_are_left_out_and_said_unless_asked_for(edited: Any, question: str) -> None:
    left_out = "6 runs of earlier versions left out (algorithm changed)"
    assert left_out in (await edited.get(f"/{question}&sweep=study"))["notes"]
    notes = (await edited.get(f"/{question}&sweep=study&superseded=1"))["notes"]
    assert not any("earlier versions" in note for note in notes)
    assert (await edited.get(f"/{question}&superseded=2", 400))["field"] == "superseded"


async def test_rows_of_earlier_versions_say_why_they_are_none_of_today(edited: Any) -> None:
    asked = "/runs?sweep=study&namespace=null&columns=uid,superseded"
    assert (await edited.get(asked))["total"] == SETTINGS
    everything = (await edited.get(f"{asked}&superseded=1"))["items"]
    assert len(everything) == 2 * SETTINGS
    assert {row["superseded"] for row in everything if row["uid"].startswith("v1")} == {"algorithm changed"}
    assert {row["superseded"] for row in everything if row["uid"].startswith("v2")} == {None}


async def test_versions_of_a_sweep_are_one_sweep_and_namespaces_are_not(edited: Any) -> None:
    items = {(item["namespace"], item["name"]): item for item in (await edited.get("/sweeps"))["items"]}
    assert {*items} == {(None, "study"), ("lab", "study"), (None, "yet-to-begin")}
    here = items[None, "study"]
    assert (here["versions"], here["runs"], here["superseded"]) == (2, SETTINGS, SETTINGS)
    assert (here["uid"], here["total"]) == ("sweep-2", SETTINGS)
    counts = (await edited.get(""))["counts"]
    assert (counts["sweeps"], counts["runs"], counts["superseded"]) == (3, SETTINGS + 1, SETTINGS)


async def test_a_sweep_is_found_by_its_namespace(edited: Any) -> None:
    mistake = await edited.get("/sweeps/study", 400)
    assert mistake["field"] == "namespace"
    assert "lab, this workstation" in mistake["error"]
    assert (await edited.get("/sweeps/study?namespace=lab"))["uid"] == "lab"
    assert (await edited.get("/sweeps/study?namespace="))["uid"] == "sweep-2"
    await edited.get("/sweeps/study?namespace=elsewhere", 404)


async def test_what_an_edited_algorithm_changed(edited: Any) -> None:
    answer = await edited.get("/analysis/versions?namespace=null")
    (change,) = answer["changes"]
    assert (change["changed"], change["keys"]) == ("algorithm", {"algorithm": "orb", "sensors": "stereo"})
    assert (change["n"], change["wins"]) == (SETTINGS, {"better": 0, "worse": SETTINGS, "same": 0})
    assert change["ratio"] == pytest.approx(2.0)
    assert change["p"] == 2 / 2**SETTINGS
    assert "after is 2 times worse, in 6 of 6 settings: more than chance" in change["sentence"]
    assert change["before"]["last"] < change["after"]["first"]
    assert change["current"]
    first = change["settings"][0]
    assert first["keys"] == {"dataset": "hall", "parameters.nFeatures": 1}
    assert (first["before"]["median"], first["after"]["median"]) == (0.2, 0.4)
    differing = {one["column"]: (one["before"], one["after"]) for one in change["differences"]}
    assert differing["provenance.algorithmHash"] == (["hash-1"], ["hash-2"])
    # Whether the switch is on or off: the question is about earlier versions.
    assert (await edited.get("/analysis/versions?namespace=null&superseded=0"))["changes"] == [change]


async def test_what_changed_is_a_table_too(edited: Any) -> None:
    answer = await edited.raw.get("/api/v1/analysis/versions?format=csv&metric=usage.cpu.seconds")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert len(rows) == SETTINGS
    assert rows[0]["before.median"] == "20.0"
    assert rows[0]["after.median"] == "30.0"
    assert "higher, in 6 of 6 settings" in rows[0]["sentence"]


async def test_a_failure_has_no_ratio(
    url: str, tmp_path: Path, open_app: Callable[..., Any], make_run: Callable[..., RunRecord]
) -> None:
    failed = {"phase": "Failed", "reason": "OutOfMemory", "results": []}
    meant = [{"evaluation": "se3", "alignment": "se3"}]
    with Archive.open(url) as archive:
        archive.put_runs(versioned(make_run, 1))
        archive.put_runs(
            run.model_copy(update={"results": []}).model_validate(
                run.model_dump(by_alias=True) | failed | {"evaluations": meant}
            )
            for run in versioned(make_run, 2)
        )
    async with open_app(Workstation(url, tmp_path)) as client:
        (change,) = (await client.get("/analysis/versions"))["changes"]
    assert (change["ratio"], change["settings"][0]["after"]["medianFailed"]) == (None, True)
    assert change["settings"][0]["after"]["failures"] == {"OutOfMemory": 1}
    assert "after is worse in 6 and better in 0 of 6 settings, some of which failed" in change["sentence"]
