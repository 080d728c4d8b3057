# SPDX-License-Identifier: Apache-2.0
"""``slamhive submit``: what reaches the cluster, what is left alone, what is refused and why."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import yaml
from testcluster.lab import algorithm, dataset, manifest, run, sweep

from slamhive.local.home.catalog import bundled

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest
    from testcluster.access import Cluster
    from testcluster.lab import Lab

    from conftest import Desk


def there(cluster: Cluster, namespace: str, kind: str) -> dict[str, dict[str, Any]]:
    return {item["metadata"]["name"]: item["spec"] for item in cluster.get(kind, "-n", namespace)["items"]}


def test_all_kinds_of_a_file_arrive_and_the_next_words_are_told(
    desk: Desk, crds: Cluster, namespace: str
) -> None:
    measure = manifest("Evaluation", "again", runs={"sweepRef": {"name": "study"}})
    study = sweep(sizes=4)
    study["metadata"] |= {"labels": {"team": "a"}, "annotations": {"why": "to see"}}
    said = desk.type("submit", desk.write(measure, study, run(), dataset(), algorithm()))
    assert said.code == 0
    assert said.out.splitlines()[:5] == [
        "Algorithm icp: created",
        "Dataset hall: created",
        "Sweep study: created, 4 runs",
        "MappingRun one: created",
        "Evaluation again: created",
    ]
    assert "slamhive status study one --watch" in said.out.replace("\n", " ")
    (study,) = crds.get("sweeps", "-n", namespace)["items"]
    assert study["metadata"]["labels"] == {"team": "a"}
    assert study["metadata"]["annotations"] == {"why": "to see"}
    assert study["spec"]["matrix"][0]["values"] == [1, 2, 3, 4]


def test_what_is_there_and_equal_is_left_alone(desk: Desk, crds: Cluster, namespace: str) -> None:
    path = desk.write(algorithm(), dataset(), sweep())
    desk.type("submit", path)
    before = crds.get("sweeps,algorithms,datasets", "-n", namespace)
    said = desk.type("submit", path)
    assert (said.code, said.out.count("unchanged")) == (0, 3)
    assert crds.get("sweeps,algorithms,datasets", "-n", namespace) == before


def test_what_may_change_is_changed_and_suspending_is_taken_back(
    desk: Desk, crds: Cluster, namespace: str
) -> None:
    desk.type("submit", desk.write(algorithm(), dataset(), sweep()))
    crds.kubectl(
        "patch", "sweep", "study", "-n", namespace, "--type=merge", "-p", '{"spec":{"suspend":true}}'
    )
    again = sweep(parallelism=7, budget={"cpuHours": 3})
    again["metadata"]["labels"] = {"team": "b"}
    said = desk.type("submit", desk.write(again))
    assert said.code == 0
    for change in ("spec.parallelism: 2 → 7", "spec.suspend: true → false", 'labels.team: absent → "b"'):
        assert change in said.out
    spec = there(crds, namespace, "sweeps")["study"]
    assert (spec["parallelism"], spec["suspend"], spec["budget"]) == (7, False, {"cpuHours": 3})


def test_a_changed_mapping_is_replaced_not_mixed(desk: Desk, crds: Cluster, namespace: str) -> None:
    desk.type("submit", desk.write(manifest("Evaluation", "e", runs={"matchLabels": {"a": "1"}})))
    desk.type("submit", desk.write(manifest("Evaluation", "e", runs={"matchLabels": {"b": "2"}})))
    assert there(crds, namespace, "evaluations")["e"]["runs"]["matchLabels"] == {"b": "2"}


def test_what_may_not_change_is_an_error_that_says_what_differs(
    desk: Desk, crds: Cluster, namespace: str
) -> None:
    desk.type("submit", desk.write(algorithm(), dataset(), sweep()))
    other = algorithm(parameters={"size": {"type": "Number", "default": 2, "minimum": 0}})
    said = desk.type("submit", desk.write(run("fresh"), other, sweep(sizes=5)))
    assert said.code == 2
    assert "spec.parameters.size.default: 1 → 2" in said.text
    assert "study.yaml:" in said.text
    assert "spec.matrix[0].values" in said.text
    assert not there(crds, namespace, "mappingruns")  # all or nothing


def test_what_the_cluster_lacks_comes_from_the_catalog_here(
    desk: Desk, crds: Cluster, namespace: str
) -> None:
    said = desk.type("submit", str(bundled("examples") / "demo.yaml"))
    assert said.code == 0
    assert "the cluster lacks" in said.err
    assert sorted(there(crds, namespace, "algorithms")) == ["genz-icp", "kiss-icp", "rko-lio"]
    assert sorted(there(crds, namespace, "datasets")) == ["synthetic-lidar"]
    assert "18 runs" in said.out
    again = desk.type("submit", str(bundled("examples") / "demo.yaml"))
    assert (again.code, again.out.splitlines()[0]) == (0, "Sweep demo: unchanged, 18 runs")


def test_without_the_catalog_here_unknown_names_are_told(desk: Desk, crds: Cluster, namespace: str) -> None:
    said = desk.type("submit", "--no-catalog", str(bundled("examples") / "demo.yaml"))
    assert said.code == 2
    assert "unknown algorithm 'kiss-icp'" in said.text
    assert not there(crds, namespace, "sweeps")


def test_runs_may_name_what_only_the_cluster_knows(desk: Desk, lab: Lab) -> None:
    said = desk.type("submit", desk.write(sweep()))
    assert (said.code, said.out.splitlines()[0]) == (0, "Sweep study: created, 3 runs")
    wrong = desk.type(
        "submit", desk.write(sweep("wrong", matrix=[{"path": "parameters.size", "values": [-1]}]))
    )
    assert wrong.code == 2
    assert "Sweep wrong: spec.matrix[0]" in wrong.text
    assert "-1 is below the minimum" in wrong.text


def test_a_dataset_whose_files_stay_here_is_told(desk: Desk, crds: Cluster) -> None:
    said = desk.type("submit", desk.write(algorithm(), dataset(), run()))
    assert said.code == 0
    assert "looks for a.bag under datasets/hall/" in said.text


def test_an_algorithm_without_an_image_is_refused(desk: Desk, crds: Cluster) -> None:
    body = algorithm(local={"adapter": "adapter.py"})
    del body["spec"]["image"]
    said = desk.type("submit", desk.write(body, dataset(), run()))
    assert said.code == 2
    assert "names no image" in said.text


def test_standard_input_is_read(
    desk: Desk, lab: Lab, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(yaml.safe_dump(sweep())))
    assert desk.type("submit", "-").code == 0
    assert "study" in there(lab.cluster, namespace, "sweeps")


def test_a_dry_run_makes_nothing_but_asks_the_server(desk: Desk, crds: Cluster, namespace: str) -> None:
    said = desk.type("submit", "--dry-run", desk.write(algorithm(), dataset(), sweep()))
    assert said.code == 0
    assert "Sweep study: would be created, 3 runs" in said.out
    assert not there(crds, namespace, "algorithms")
    assert not there(crds, namespace, "sweeps")


def test_what_only_the_server_refuses_is_wrong_input(desk: Desk, crds: Cluster, namespace: str) -> None:
    long = dataset("d" * 64)  # a name that is valid here, but cannot be a label's value there
    said = desk.type("submit", desk.write(algorithm(), long))
    assert said.code == 2
    assert "study.yaml:" in said.text
    assert "the cluster refuses it" in said.text
    assert not there(crds, namespace, "algorithms")


def test_a_namespace_of_a_manifest_counts(
    desk: Desk, crds: Cluster, namespace: str, make_namespace: Callable[[str], str]
) -> None:
    other = make_namespace("b")
    body = algorithm()
    body["metadata"]["namespace"] = other
    said = desk.type("submit", desk.write(body))
    assert said.code == 0
    assert "icp" in there(crds, other, "algorithms")
    said = desk.type("submit", desk.write(body), "-n", namespace)
    assert said.code == 2
    assert "metadata.namespace" in said.text
