# SPDX-License-Identifier: Apache-2.0
"""``slamhive status`` and ``logs`` beside an operator."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any

import pytest
from testcluster.lab import condition_of, manifest, run, status_of, sweep

from slamhive.kube.api.kinds import Kind

if TYPE_CHECKING:
    from collections.abc import Callable

    from testcluster.lab import Lab

    from conftest import Desk


RUNS = ("-l", "slamhive.io/role=run")


def is_complete(status: dict[str, Any]) -> bool:
    return condition_of(status, "Complete").get("status") == "True"


async def test_status_shows_all_that_there_is(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        lab.apply(sweep(), run("alone"))
        lab.apply(manifest("Evaluation", "again", runs={"sweepRef": {"name": "study"}}))
        await status_of(op, Kind.SWEEP, "study", is_complete)
        await status_of(op, Kind.MAPPING_RUN, "alone", lambda found: found.get("phase") == "Succeeded")
    said = await desk.types("status")
    assert said.code == 0
    line = next(line for line in said.out.splitlines() if line.startswith("study")).split()
    assert line[:8] == ["study", "Complete", "█" * 16, "3/3", "0", "–", "–", "0"]
    assert "alone" in said.out
    assert "Succeeded" in said.out
    assert "200Mi" in said.out
    assert "again" in said.out
    assert said.out.count("study-") == 0  # a sweep's runs are not listed one by one


async def test_status_of_a_run_beyond_the_retention_names_the_archive(lab: Lab, desk: Desk) -> None:
    lab.apply(sweep())
    said = await desk.types("status", "study-qql0vsjwnqzx")
    assert said.code == 2
    assert "the archive alone: slamhive results show" in said.text
    assert "the archive" not in (await desk.types("status", "unheard")).text


async def test_status_of_a_sweep_tells_why_runs_failed(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(exit_code=3)
    async with lab.operator() as op:
        lab.apply(sweep())
        await status_of(op, Kind.SWEEP, "study", is_complete)
    said = await desk.types("status", "study")
    assert said.code == 0
    assert "failed runs: 3 AlgorithmFailed" in said.out
    assert "exit code 3" in said.out
    assert "3 failed" in said.text
    plain = json.loads((await desk.types("status", "study", "--json")).out)
    assert [one["status"]["reason"] for one in plain["sweeps"][0]["failedRuns"]] == ["AlgorithmFailed"] * 3
    assert plain["sweeps"][0]["status"]["failed"] == 3


async def test_status_of_a_run_has_its_figures_and_conditions(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Succeeded")
    said = await desk.types("status", "one")
    for text in ("Succeeded", "8.0 s, 0.80 cores", "200 MiB", "200 poses", "Accepted", "runs/"):
        assert text in said.text


async def test_status_repeats_what_conditions_complain_of(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        wrong = sweep("wrong", matrix=[{"path": "parameters.size", "values": [-1]}])
        lab.apply(wrong, sweep("asleep", suspend=True))
        await status_of(op, Kind.SWEEP, "wrong", lambda found: condition_of(found, "Accepted"))
        await status_of(op, Kind.SWEEP, "asleep", lambda found: found.get("phase") == "Suspended")
    said = await desk.types("status")
    assert "wrong: not accepted: spec.matrix[0]" in said.text
    assert "-1 is below the minimum" in said.text
    assert "asleep: suspended" in said.text


async def test_watching_ends_with_what_is_watched(lab: Lab, desk: Desk) -> None:
    lab.apply(sweep())
    async with lab.operator():
        said = await desk.types("status", "study", "--watch")
    assert said.code == 0
    assert said.out.splitlines()[-1] == "Sweep study: Complete 3/3, 0 failed"


async def test_watching_as_json_gives_a_line_a_change(lab: Lab, desk: Desk) -> None:
    lab.apply(run())
    async with lab.operator():
        said = await desk.types("status", "one", "--watch", "--json")
    phases = [json.loads(line)["runs"][0]["status"].get("phase") for line in said.out.splitlines()]
    assert phases[-1] == "Succeeded"


@pytest.mark.parametrize("command", ["status", "cancel", "fetch", "logs"])
def test_unknown_names_are_told_with_the_nearest_one(lab: Lab, desk: Desk, command: str) -> None:
    lab.apply(run("pine"))
    said = desk.type(command, "pime")
    assert said.code == 2
    assert "did you mean 'pine'?" in said.text


def test_an_empty_namespace_is_no_error(lab: Lab, desk: Desk) -> None:
    said = desk.type("status")
    assert (said.code, said.out) == (0, "")
    assert "nothing in namespace" in said.err


async def test_the_log_of_a_run_without_a_pod_is_what_was_kept(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Succeeded")
        patch = json.dumps({"status": {"logTail": "first words\nlast words"}})
        words = ("--subresource=status", "--type=merge", "-p", patch)
        lab.cluster.kubectl("patch", "mappingrun", "one", "-n", lab.namespace, *words)
        lab.delete("job", "one-1")
        lab.cluster.kubectl("wait", "--for=delete", "pod", *RUNS, "-n", lab.namespace, "--timeout=240s")
    said = await desk.types("logs", "one")
    assert said.out.splitlines() == ["first words", "last words"]
    assert "the pod is gone" in said.err
    assert "its files are on the results volume, in runs/" in said.text
    monitor = await desk.types("logs", "one", "--container", "monitor")
    assert (monitor.code, monitor.out) == (0, "")
    assert "the log of its container monitor with it" in monitor.text


async def test_the_log_of_a_run_that_never_ran_says_why(lab: Lab, desk: Desk) -> None:
    async with lab.operator() as op:
        lab.apply(run(parameters={"sice": 2}))
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Failed")
    said = await desk.types("logs", "one", "-f")
    assert (said.code, said.out) == (0, "")
    assert "one never ran: InvalidParameters" in said.text


def test_the_log_of_a_run_that_waits_says_for_what(lab: Lab, desk: Desk) -> None:
    lab.apply(run())
    said = desk.type("logs", "one")
    assert said.code == 0
    assert "one: Pending; it has written nothing yet (-f waits)" in said.text


async def test_a_container_that_a_run_has_not_is_told(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Running")
        said = await desk.types("logs", "one", "-c", "player")
    assert said.code == 2
    assert "it has monitor, algorithm" in said.text


async def test_what_is_deleted_while_it_is_watched_is_told(make_lab: Callable[..., Lab], desk: Desk) -> None:
    lab = make_lab(hold=True)
    async with lab.operator() as op:
        lab.apply(run())
        await status_of(op, Kind.MAPPING_RUN, "one", lambda found: found.get("phase") == "Running")
        watching = asyncio.create_task(desk.types("status", "one", "--watch"))
        await asyncio.sleep(0)
        lab.delete("mappingrun", "one")
        said = await watching
    assert said.code in {1, 2}  # 2 where it was gone before the first look
    assert "Traceback" not in said.text
