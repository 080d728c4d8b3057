# SPDX-License-Identifier: Apache-2.0
"""Machines of runs at the terminal: nodes beside their like, and tables that tell machines apart."""

from __future__ import annotations

import csv
import io
import json
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.archive import Archive
from slamhive.model.results import Machine, Outcome, Phase, Provenance, Result, RunRecord, Usage

if TYPE_CHECKING:
    from collections.abc import Callable

    from slamhive.local.home.folder import Home

    Command = Callable[..., tuple[int, str, str]]
SECONDS = {"n1": 10.0, "n2": 12.0, "n3": 10.1}


def record(node: str, number: int, **changes: Any) -> RunRecord:
    names = {"algorithmRef": {"name": "a"}, "datasetRef": {"name": "d"}, "sensors": "lidar"}
    moment = datetime(2026, 1, 1, 0, number, tzinfo=UTC)
    machine = Machine.model_validate({"governor": "performance", "exclusiveCores": True} | changes)
    return RunRecord(
        uid=f"{node}-{number}-{len(changes)}",
        name=f"{node}-{number}",
        spec=names | {"parameters": {"k": number % 3}, "input": {"pace": "Lockstep"}, "seed": number},
        phase=Phase.SUCCEEDED,
        created=moment,
        finished=moment,
        usage=Usage.model_validate({"cpu": {"seconds": SECONDS[node] + 0.01 * (number % 5)}}),
        results=[Result(evaluation="se3", outcome=Outcome.TRACKED, values={"ate": {"rmse": 0.1}})],
        provenance=Provenance(
            node=node, cpu_model="P", content_hash=f"{node}{number:062d}", algorithm_hash="a", machine=machine
        ),
    )


@pytest.fixture
def shown(home: Home, monkeypatch: pytest.MonkeyPatch, run_command: Command) -> Command:
    monkeypatch.setenv("SLAMHIVE_HOME", str(home.path))
    with Archive.open(home.archive_url) as archive:
        archive.put_runs([record(node, number) for node in SECONDS for number in range(12)])
    return lambda *words: run_command("results", *words)


def test_a_slow_node_is_named_in_every_form(shown: Command) -> None:
    code, out, _ = shown("nodes")
    assert code == 0
    assert "n2 is slower: 19." in out
    rows = json.loads(shown("nodes", "--format", "json")[1])
    assert [(row["node"], row["verdict"], row["runs"]) for row in rows] == [
        *(("n2", "slower", 12), ("n3", "equal", 12), ("n1", "equal", 12)),
    ]
    assert rows[0]["kind"] == {
        "provenance.cpuModel": "P",
        "provenance.machine.governor": "performance",
        "provenance.machine.exclusiveCores": True,
    }
    (first, *_) = csv.DictReader(io.StringIO(shown("nodes", "--format", "csv")[1]))
    assert (first["node"], first["provenance.cpuModel"]) == ("n2", "P")
    assert "| n2 | P, governor performance, exclusive cores on |" in shown("nodes", "--format", "markdown")[1]


def test_one_node_has_nothing_to_be_compared_with(shown: Command) -> None:
    code, out, err = shown("nodes", "--where", "node == 'n1'", "--format", "json")
    assert (code, json.loads(out)) == (0, [])
    assert "all runs were on one node, n1: nothing to compare" in err


def test_nodes_and_machines_are_rows_as_any_setting(home: Home, shown: Command) -> None:
    with Archive.open(home.archive_url) as archive:
        archive.put_runs([record("n1", number + 12, governor="powersave") for number in range(3)])
    words = ("table", "--format", "json", "-m", "usage.cpu.seconds", "--rows")
    by_node = json.loads(shown(*words, "node")[1])
    assert sorted((row["provenance.node"], row["runs"]) for row in by_node) == [
        *(("n1", 3), ("n1", 12), ("n2", 12), ("n3", 12)),
    ]
    # Nobody asked for the governor, and it is told apart all the same.
    found = json.loads(shown(*words, "algorithm")[1])
    assert sorted(row["provenance.machine.governor"] for row in found) == ["performance", "powersave"]
