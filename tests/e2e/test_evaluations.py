# SPDX-License-Identifier: Apache-2.0
"""Evaluations of the finished first sweep: with another alignment, and by a container of somebody's own."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from onnode.first import NAME
from onnode.lab import DATASET, manifest
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.first import First
    from onnode.lab import Lab

CUSTOM = f"""
import json, pathlib
root = pathlib.Path("/slamhive")
truth = sum(line[0] != "#" for line in (root / "groundtruth" / "{DATASET}.txt").open())
with (root / "output" / "results.jsonl").open("w") as file:
    for run in sorted((root / "runs").iterdir()):
        poses = len((run / "output" / "trajectory.txt").read_text().splitlines())
        line = {{"run": run.name, "outcome": "Tracked", "values": {{"length": poses, "truth": truth}}}}
        file.write(json.dumps(line) + "\\n")
"""


def measured(lab: Lab, first: First, name: str, **spec: Any) -> dict[str, dict[str, Any]]:
    """Apply an Evaluation of the first sweep and return its results by run."""
    lab.apply(manifest("Evaluation", name, runs={"sweepRef": {"name": NAME}}, **spec))

    def results() -> dict[str, dict[str, Any]] | None:
        found = {
            run["metadata"]["name"]: result
            for run in lab.runs(NAME)
            for result in run["status"]["results"]
            if result["evaluation"] == name
        }
        return found if len(found) == len(first.runs) else None

    try:
        return until(results, f"the results of {name}", 180, 0.5)
    except Exception:
        print(json.dumps(lab.get("evaluation", name).get("status"), indent=1))  # noqa: T201 - what failed
        raise


def test_another_alignment_is_measured_beside_the_first(lab: Lab, first: First) -> None:
    found = measured(lab, first, "drift", alignment="Origin", rpe=[{"delta": 1, "unit": "s"}])
    for run in first.runs:
        mine, drift = run["status"]["results"][0], found[run["metadata"]["name"]]
        assert drift["alignment"] == "origin"
        assert drift["ate"]["rmse"] >= mine["ate"]["rmse"]
        assert (drift["rpe"][0]["unit"], mine["rpe"][0]["unit"]) == ("s", "m")
        again = lab.get("mappingrun", run["metadata"]["name"])["status"]["results"]
        assert again[0] == mine
    status = lab.wait("evaluation", "drift", "Complete")
    assert (status["evaluated"], status["failed"]) == (len(first.runs), 0)
    groups = {group["algorithm"]: group["runs"] for group in status["summary"]["groups"]}
    assert groups == {"kiss-icp": 8, "genz-icp": 8}


def test_a_container_of_somebodys_own(lab: Lab, first: First) -> None:
    image = "slamhive/evaluator:0.1.0"
    found = measured(lab, first, "counted", evaluator={"image": image, "command": ["python3", "-c", CUSTOM]})
    for run in first.runs:
        result = found[run["metadata"]["name"]]
        assert result["length"] == run["status"]["trajectory"]["poses"]
        assert result["truth"] > 1000


@pytest.mark.parametrize(
    ("command", "said"),
    [(["false"], "exit code 1"), (["python3", "-c", "print('no file')"], "results.jsonl")],
    ids=["fails", "writes-nothing"],
)
def test_a_container_that_fails_is_said_in_a_condition(
    lab: Lab, first: First, command: list[str], said: str, request: pytest.FixtureRequest
) -> None:
    name = f"broken-{request.node.callspec.id}"
    evaluator = {"image": "slamhive/evaluator:0.1.0", "command": command}
    lab.apply(
        manifest("Evaluation", name, runs={"names": [first.runs[0]["metadata"]["name"]]}, evaluator=evaluator)
    )
    until(lambda: said in json.dumps(lab.get("evaluation", name).get("status") or {}), said, 240)
