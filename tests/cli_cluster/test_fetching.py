# SPDX-License-Identifier: Apache-2.0
"""``slamhive fetch`` and ``slamhive run --on cluster``: results of a cluster in the archive here."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any

import pytest
from testcluster.lab import algorithm, condition_of, dataset, run, status_of, sweep, until

from slamhive.archive import Archive
from slamhive.kube.api.kinds import Kind
from slamhive.model.results import Phase, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

    from conftest import Desk

RESULT = {"evaluation": "se3", "outcome": "Tracked", "coverage": 0.99, "ate": {"rmse": 0.125}}


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


def records(desk: Desk, name: str = "study") -> list[RunRecord]:
    with desk.archive as archive:
        return [*archive.runs(sweep=name)]


def give_results(lab: Lab) -> None:
    """Write a result into every run, as an evaluation would."""
    for item in lab.cluster.get("mappingruns", "-n", lab.namespace)["items"]:
        patch = json.dumps({"status": {"results": [RESULT]}})
        words = ("--subresource=status", "--type=merge", "-p", patch)
        lab.cluster.kubectl("patch", "mappingrun", item["metadata"]["name"], "-n", lab.namespace, *words)


async def test_fetched_runs_are_like_runs_of_this_machine(lab: Lab, desk: Desk) -> None:
    hall = dataset("park")
    hall["spec"]["attributes"] = {"motion": "fast"}
    lab.apply(hall)
    async with lab.operator() as op:
        lab.apply(sweep(template={"datasetRef": {"name": "park"}}))
        await status_of(op, Kind.SWEEP, "study", is_complete)
    give_results(lab)
    said = await desk.types("fetch", "study")
    assert said.code == 0
    assert "study: 3 runs in" in said.text
    found = records(desk)
    assert [record.index for record in found] == [0, 1, 2]
    first = found[0]
    assert first.phase is Phase.SUCCEEDED
    assert first.usage is not None
    assert (first.usage.cpu.seconds, first.results[0].values["ate"]["rmse"]) == (8.0, 0.125)
    assert first.attributes == {"motion": "fast"}
    assert first.spec["parameters"] == {"size": 1}
    table = desk.type("results", "table", "--sweep", "study", "--format", "json")
    rows = json.loads(table.out)
    assert [(row["parameters.size"], row["ate.rmse.mean"]) for row in rows] == [(n, 0.125) for n in (1, 2, 3)]
    with desk.archive as archive:
        assert [sweep.uid for sweep in archive.sweeps()]
        assert {entry.name for entry in archive.catalog("Dataset")} == {"park"}


async def test_runs_on_a_generated_dataset_have_the_attributes_of_their_world(lab: Lab, desk: Desk) -> None:
    made = dataset("made")
    made["spec"] = {
        "recording": {"synthetic": {"loops": 0.25, "light": 0.5}},
        "attributes": {"motion": "fast"},
    }
    lab.apply(made)
    async with lab.operator() as op:
        lab.apply(sweep(template={"datasetRef": {"name": "made"}}))
        await status_of(op, Kind.SWEEP, "study", is_complete)
    assert (await desk.types("fetch", "study")).code == 0
    attributes = records(desk)[0].attributes
    # As a workstation has them: what is said by hand goes before what follows from the generator.
    assert (attributes["loops"], attributes["light"], attributes["motion"]) == (0.25, 0.5, "fast")


async def test_fetching_again_brings_up_to_date_and_doubles_nothing(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        lab.apply(sweep())
        await status_of(op, Kind.SWEEP, "study", is_complete)
    await desk.types("fetch", "study")
    assert not any(record.results for record in records(desk))
    give_results(lab)
    again = await desk.types("fetch", "study")
    assert "@" not in again.text
    assert [len(record.results) for record in records(desk)] == [1, 1, 1]


async def test_what_is_not_finished_is_told_and_left(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(sweep(sizes=5), run())
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 2)
        said = await desk.types("fetch", "study", "one")
    assert said.code == 0
    assert "study: 5 not finished yet" in said.text
    assert "one: 1 not finished yet" in said.text
    assert not records(desk)


async def test_runs_of_the_clusters_archive_are_told(lab: Lab, desk: Desk) -> None:
    with Archive.open(f"sqlite:///{desk.folder / 'there.sqlite'}") as archive:
        async with lab.operator(archive) as op:
            lab.apply(sweep(sizes=5, retention={"runs": 2}))
            await status_of(op, Kind.SWEEP, "study", is_complete)
            await until(
                lambda: len(op.cluster.store.of(Kind.MAPPING_RUN, lab.namespace)) == 2, "the surplus to go"
            )
            said = await desk.types("fetch", "study")
    assert "study: 2 runs" in said.text
    assert "3 more are in the cluster's own archive alone" in said.text


async def test_other_runs_of_the_name_are_not_mixed_in(lab: Lab, desk: Desk) -> None:
    other = RunRecord(uid="u-0", name="study-aaaa", sweep="study", index=0, spec={}, phase=Phase.SUCCEEDED)
    with desk.archive as archive:
        archive.put_run(other)
    async with lab.operator() as op:
        lab.apply(sweep())
        await status_of(op, Kind.SWEEP, "study", is_complete)
    said = await desk.types("fetch", "study")
    uid = lab.cluster.get("sweep", "study", "-n", lab.namespace)["metadata"]["uid"]
    assert [record.sweep_uid for record in records(desk)] == [None, uid, uid, uid]
    address = f"{lab.namespace}/study"
    assert f"--sweep {address} means that of the cluster" in said.text
    for name, code, words in (
        ("study", 2, f"write which of {address}, /study"),
        (address, 0, ""),
        ("/study", 0, ""),
    ):
        table = desk.type("results", "list", "--sweep", name, "--columns", "name")
        assert table.code == code
        assert words in table.text


async def test_a_single_run_is_a_sweep_of_one(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        lab.apply(run(), sweep())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Succeeded")
        await status_of(op, Kind.SWEEP, "study", is_complete)
        member = op.cluster.store.select(Kind.MAPPING_RUN, lab.namespace, "slamhive.io/sweep", "study")[1]
    said = await desk.types("fetch", "one", member["metadata"]["name"])
    assert said.code == 0
    assert [record.name for record in records(desk, "one")] == ["one"]
    assert [record.name for record in records(desk)] == [member["metadata"]["name"]]
    assert [str(record.index) for record in records(desk)] == [
        member["metadata"]["labels"]["slamhive.io/point"]
    ]


async def test_run_on_a_cluster_ends_like_a_run_here(lab: Lab, desk: Desk) -> None:
    async with lab.operator():
        said = await desk.types("run", desk.write(sweep(sizes=4)), "--on", "cluster", "-j", "3")
    assert said.code == 0
    assert "Sweep study: created, 4 runs" in said.err
    assert "4/4" in said.err
    assert "study: 4 runs: 4 succeeded, 0 failed" in said.out
    assert "algorithm icp, sensors lidar, dataset hall" in said.out  # the table, as after a run here
    assert len(records(desk)) == 4
    assert lab.cluster.get("sweep", "study", "-n", lab.namespace)["spec"]["parallelism"] == 3
    async with lab.operator():
        again = await desk.types("run", desk.write(sweep(sizes=4)), "--on", "cluster", "-j", "3")
    assert (again.code, len(records(desk))) == (0, 4)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "0 succeeded, 3 failed"),
        ({"maxFailures": 0, "parallelism": 1}, "2 not run (TooManyFailures)"),
    ],
)
async def test_run_on_a_cluster_fails_like_a_run_here(
    make_lab: Callable[..., Lab], desk: Desk, changes: dict[str, Any], text: str
) -> None:
    lab = make_lab(exit_code=3)
    async with lab.operator():
        said = await desk.types("run", desk.write(sweep(**changes)), "--on", "cluster")
    assert said.code == 1
    assert text in said.out


async def test_lines_of_json_say_what_runs_of_a_cluster_came_to(lab: Lab, desk: Desk) -> None:
    words = ("--on", "cluster", "--log-format", "json")
    async with lab.operator():
        said = await desk.types("run", desk.write(sweep(sizes=4), run()), *words)
    assert (said.code, said.err) == (0, "")
    lines = [json.loads(line) for line in said.out.splitlines()]
    told = {kind: [line for line in lines if line["event"] == kind] for kind in ("begin", "run", "end")}
    assert [(line["sweep"], line["runs"]) for line in told["begin"]] == [("study", 4), ("one", 1)]
    members = [line for line in told["run"] if line["sweep"] == "study"]
    assert [line["done"] for line in members] == [1, 2, 3, 4]
    kept = {record.name: record for record in records(desk)}
    for line in members:
        record = kept[line["run"]]
        assert line["settings"] == {"parameters.size": record.spec["parameters"]["size"]}
        assert (line["uid"], line["phase"], line["ate"]) == (
            record.uid,
            "Succeeded",
            record.results[0].values["ate"]["rmse"] if record.results else None,
        )
    assert [line["run"] for line in told["run"] if line["sweep"] == "one"] == ["one"]
    assert {line["sweep"]: (line["runs"], line["succeeded"], line["verdict"]) for line in told["end"]} == {
        "study": (4, 4, "Complete"),
        "one": (1, 1, "Succeeded"),
    }
    assert lines[-1]["event"] == "exit"
    assert lines[-1]["code"] == 0


async def test_run_on_a_cluster_takes_single_runs_too(lab: Lab, desk: Desk) -> None:
    async with lab.operator():
        said = await desk.types("run", desk.write(run()), "--on", "cluster")
    assert said.code == 0
    assert "one: Succeeded" in said.out
    assert [record.sweep for record in records(desk, "one")] == ["one"]


async def test_a_suspended_sweep_is_not_waited_for(lab: Lab, desk: Desk) -> None:
    async with lab.operator():
        said = await desk.types("run", desk.write(sweep(suspend=True)), "--on", "cluster")
    assert said.code == 1
    assert "Sweep study: suspended" in said.text
    assert "3 not run (Suspended)" in said.text


async def test_a_sweep_that_goes_away_is_told(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        task = asyncio.create_task(desk.types("run", desk.write(sweep()), "--on", "cluster"))
        await status_of(op, Kind.SWEEP, "study", lambda found: found.get("running") == 2)
        lab.delete("sweep", "study")
        said = await task
    assert said.code == 1
    assert "Sweep study: was deleted by someone" in said.text


@pytest.mark.parametrize("option", ["--rerun", "--retry-failed", "--watch"])
def test_options_of_this_machine_are_refused_for_a_cluster(bare_desk: Desk, option: str) -> None:
    path = bare_desk.write(algorithm(), dataset(), sweep())
    said = bare_desk.type("run", path, "--on", "cluster", option)
    assert said.code == 2
    assert option in said.text
