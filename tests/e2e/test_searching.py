# SPDX-License-Identifier: Apache-2.0
"""A search of a real algorithm on a node: what it tries outlives its operator, and no run is done twice."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onnode.lab import manifest
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.lab import Lab

NAME, TRIALS = "search", 4
DEPLOYMENT = "deployment/slamhive-operator"


def test_a_search_goes_on_after_its_operator_ended(lab: Lab) -> None:
    spec = {
        "template": {
            "spec": {"algorithmRef": {"name": "kiss-icp"}, "datasetRef": {"name": "synthetic-lidar"}}
        },
        "matrix": [
            {"path": "parameters.voxelSize", "range": {"from": 0.2, "to": 4, "scale": "Log"}},
            {"path": "parameters.maxRange", "values": [20, 60]},
        ],
        "search": {
            "method": "TPE",
            "objectives": [{"metric": "ate.rmse"}],
            "trials": TRIALS,
            "repetitions": {"first": 1, "promote": 2},
            "keep": 2,
            "atATime": 2,
        },
        "parallelism": 2,
    }
    lab.apply(manifest("Sweep", NAME, **spec))
    first = until(lambda: _trials(lab), "the first settings")
    lab.kubectl("rollout", "restart", DEPLOYMENT)
    lab.kubectl("rollout", "status", DEPLOYMENT, "--timeout=5m", timeout=400)
    status = lab.completed(NAME)
    tried = status["search"]["trials"]
    assert tried[: len(first)] == first
    assert len(tried) == status["search"]["decided"] == TRIALS
    assert status["progress"] == f"{TRIALS}/{TRIALS} trials"
    runs = lab.runs(NAME)
    places = [run["metadata"]["labels"]["slamhive.io/point"] for run in runs]
    assert len(set(places)) == len(places) == status["total"] == status["succeeded"]
    best = status["search"]["best"][0]
    errors = [
        run["status"]["results"][0]["ate"]["rmse"]
        for run in runs
        if run["spec"]["parameters"]["voxelSize"] == best["values"][0]
    ]
    assert len(errors) == 2
    assert abs(best["figures"][0] - sum(errors) / 2) < 1e-9


def _trials(lab: Lab) -> list[object]:
    found: list[object] = ((lab.get("sweep", NAME).get("status") or {}).get("search") or {}).get("trials")
    return found
