# SPDX-License-Identifier: Apache-2.0
"""Tests of the Jobs that report to the operator what other evaluators wrote and what a monitor left."""

from __future__ import annotations

import json
import os
from typing import Any

import pytest

from slamhive.jobs.lines import decode
from slamhive.jobs.report import report
from slamhive.jobs.requests import EvaluateRequest
from slamhive.kube.reports import read_report

RUNS = [{"uid": f"uid-{name}", "name": name} for name in ("a", "b", "c")]
REQUEST = {"evaluation": "theirs", "settings": {}, "runs": RUNS}


def lines_of(*objects: Any) -> str:
    return "".join((one if isinstance(one, str) else json.dumps(one)) + "\n" for one in objects)


def reported(*objects: Any) -> list[dict[str, Any]]:
    return report(EvaluateRequest.model_validate(REQUEST), lines_of(*objects))


@pytest.mark.parametrize(
    "line",
    [
        {"name": "a", "outcome": "Tracked", "coverage": 0.5, "ate": {"rmse": 0.1}},
        {"run": "a", "outcome": "Tracked", "coverage": 0.5, "values": {"ate": {"rmse": 0.1}}},
        {
            "uid": "uid-a",
            "result": {"outcome": "Tracked", "coverage": 0.5, "values": {"ate": {"rmse": 0.1}}},
        },
        (
            '{"name": "a", "outcome": "Lost"}\n'
            '{"name": "a", "outcome": "Tracked", "coverage": 0.5, "ate": {"rmse": 0.1}}'
        ),
    ],
)
def test_results_may_be_written_in_either_way(line: Any) -> None:
    [first, *others] = reported(line)
    result = {
        "evaluation": "theirs",
        "outcome": "Tracked",
        "coverage": 0.5,
        "values": {"ate": {"rmse": 0.1}},
    }
    assert first == {"uid": "uid-a", "name": "a", "result": result}
    assert all("wrote no line" in other["error"] for other in others)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ({"name": "a", "error": "no map"}, "no map"),
        ({"name": "a"}, "line 1: outcome: None is not one of Tracked, Partial, Lost, Diverged"),
        ({"name": "a", "outcome": "Fine"}, "'Fine' is not one of"),
        ({"name": "a", "outcome": ["Lost"]}, "is not one of"),
        ({"name": "a", "result": 3}, "result: must be an object"),
        ({"name": "a", "outcome": "Lost", "coverage": "all"}, "coverage"),
        ({"name": "a", "outcome": "Lost", "values": [1]}, "values: must be an object"),
        ({"name": "a", "outcome": "Lost", "x": "y" * 70_000}, "at most 65536"),
        ('{"name": "a", "outcome": "Lost", "x": ' + "[" * 600 + "]" * 600 + "}", "nested too deep"),
    ],
)
def test_a_line_that_is_no_result_is_its_run_s_error(line: Any, sentence: str) -> None:
    records = reported(line, {"name": "b", "outcome": "Lost"})
    assert sentence in records[0]["error"]
    assert records[1]["result"]["outcome"] == "Lost"
    assert len(records) == 3


@pytest.mark.parametrize(
    "line", ["3", "[]", "{", "null", "[" * 9000, '{"name": "stranger"}', '{"name": 7}', '{"outcome": "Lost"}']
)
def test_a_line_of_no_run_is_an_error_of_its_own(line: str) -> None:
    records = reported(line, {"name": "b", "outcome": "Lost"})
    assert len(records) == 4
    assert "line 1" in records[3]["error"]
    assert records[3]["uid"] is None


def test_no_more_strangers_are_told_than_anybody_reads() -> None:
    assert len(reported(*["stranger"] * 1000)) == 3 + 20


def test_numbers_that_json_does_not_have_become_null() -> None:
    [first, *_] = reported('{"name": "a", "outcome": "Lost", "ate": NaN, "b": [-Infinity, 1e999]}')
    assert first["result"]["values"] == {"ate": None, "b": [None, None]}


def test_the_program_reports_what_lies_there(pod: Any) -> None:
    (pod.root / "output" / "results.jsonl").write_text(lines_of({"name": "b", "outcome": "Lost", "x": 1}))
    ended = pod.run("report", request=REQUEST)
    assert (ended.code, ended.told["failed"]) == (0, 2)
    found = decode(ended.stdout)
    assert found.is_complete
    assert found.records[1]["result"]["values"] == {"x": 1}


@pytest.mark.parametrize("there", ["nothing", "link", "folder"])
def test_no_results_at_all_are_a_fault(pod: Any, there: str) -> None:
    path = pod.root / "output" / "results.jsonl"
    if there == "link":
        path.symlink_to("/etc/passwd")
    elif there == "folder":
        path.mkdir()
    ended = pod.run("report", request=REQUEST)
    assert "results.jsonl" in ended.error[1]
    assert ended.stdout == ""


SUMMARY = {
    "exitCode": None,
    "reason": None,
    "message": "",
    "startedAt": "2026-01-02T03:04:05.678Z",
    "finishedAt": "2026-01-02T03:04:35.678Z",
    "usage": {"cpu": {"seconds": 12.5}, "memory": {"peakBytes": 1000}, "wallSeconds": 30.0},
    "logTail": "a\n" * 5000,
    "trajectory": {"poses": 3, "durationSeconds": 1.0, "sha256": "0" * 64, "path": "output/trajectory.txt"},
    "frames": {"offered": 3, "processed": 3, "dropped": 0},
    "node": "n",
    "cpuModel": "c",
}


def test_a_summary_is_told_as_the_monitor_would_have(pod: Any) -> None:
    folder = pod.root / "results" / "runs" / "uid" / "pod"
    folder.mkdir(parents=True)
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    ended = pod.run("read", request={"path": "runs/uid/pod/summary.json"})
    assert ended.code == 0
    assert len(ended.message) <= 2048
    found = read_report(ended.message)
    assert found is not None
    assert found.usage is not None
    assert found.trajectory is not None
    assert (found.usage.cpu.seconds, found.trajectory.poses, found.cpu_model) == (12.5, 3, "c")


def test_of_a_run_whose_last_pod_nobody_knows_the_one_that_began_last_is_told(pod: Any) -> None:
    for number, name in enumerate(("taken", "last", "empty")):
        folder = pod.root / "results" / "runs" / "uid" / name
        folder.mkdir(parents=True)
        if name != "empty":
            (folder / "config.yaml").touch()
            os.utime(folder / "config.yaml", (number, number))
            (folder / "summary.json").write_text(json.dumps(SUMMARY | {"cpuModel": name}))
    found = read_report(pod.run("read", request={"path": "runs/uid"}).message)
    assert found is not None
    assert (found.pod, found.cpu_model) == ("last", "last")
    # A pod that left none is not another's.
    (pod.root / "results" / "runs" / "uid" / "last" / "summary.json").unlink()
    assert "last/summary.json: does not exist" in pod.run("read", request={"path": "runs/uid"}).error[1]


@pytest.mark.parametrize(
    ("path", "content"),
    [
        ("runs/uid", None),
        ("runs/..", None),
        ("runs/uid/pod/summary.json", None),
        ("runs/uid/pod/summary.json", "["),
        ("runs/uid/pod/summary.json", "[]"),
        ("runs/uid/pod/summary.json", '{"usage": {"wallSeconds": NaN}}'),
        ("runs/uid/pod/usage.csv", None),
        ("runs/../pod/summary.json", None),
        ("/runs/uid/pod/summary.json", None),
    ],
)
def test_a_summary_that_is_none_is_a_fault(pod: Any, path: str, content: str | None) -> None:
    if content is not None:
        folder = pod.root / "results" / "runs" / "uid" / "pod"
        folder.mkdir(parents=True)
        (folder / "summary.json").write_text(content)
    assert pod.run("read", request={"path": path}).error[0] == "SystemFault"
