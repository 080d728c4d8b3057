# SPDX-License-Identifier: Apache-2.0
"""Tests of the documents after the first sweep: change, watch, upgrade, uninstall; and all of kind.md.

These tests come last, as their order in the document says: they take away what the others use.
"""

from __future__ import annotations

import re
import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from onnode import documents
from onnode.documents import ROOT
from onnode.first import LONG, NAME
from onnode.lab import RUNS, stand_in
from testcluster.access import until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from onnode.documents import Desk
    from onnode.first import First
    from onnode.lab import Lab

KUBERNETES, KIND = documents.sections("kubernetes.md"), documents.sections("kind.md")


def ready(lab: Lab) -> None:
    lab.kubectl("rollout", "status", "deployment/slamhive-operator", "--timeout=5m", timeout=400)


def test_a_sweep_is_changed_and_deleted(lab: Lab, first: First) -> None:
    change = documents.scripts(KUBERNETES["The first sweep"])[1]
    lab.desk.run(change)
    ours = ("-l", f"slamhive.io/sweep={NAME}")
    until(lambda: not lab.get(f"{RUNS},jobs,pods", *ours)["items"], "the sweep's objects to go", 240)


def test_watching(lab: Lab) -> None:
    (watch,) = documents.scripts(KUBERNETES["Watching"])
    told = lab.desk.run(watch)
    assert "slamhive_runs_finished_total" in told
    assert f"watching {lab.namespace}" in told
    assert lab.get("configmaps", "-l", "grafana_dashboard=1")["items"]


def test_upgrade_and_uninstall(lab: Lab) -> None:
    upgrade, uninstall = documents.scripts(KUBERNETES["Upgrade and uninstall"])
    lab.desk.run(upgrade)
    ready(lab)
    lab.desk.run(uninstall)
    operator = ("-l", "app.kubernetes.io/component=operator")
    until(lambda: not lab.get("pods", *operator)["items"], "the operator to go", 240)
    claims = {claim["metadata"]["name"] for claim in lab.get("persistentvolumeclaims")["items"]}
    assert claims == {"slamhive-results", "slamhive-data"}
    assert lab.get("algorithms", "kiss-icp")
    assert lab.runs(LONG)[0]["status"]["results"]


@pytest.fixture
def kind_desk(lab: Lab, tmp_path: Path) -> Iterator[Desk]:
    """Desk with all that kind.md takes for granted, and nothing of the other document's."""
    lab.desk.run("helm uninstall slamhive-crds --namespace kube-system")
    yield lab.desk
    lab.cluster.kubectl("delete", "namespace", "slamhive", "--wait=false", "--ignore-not-found")
    volumes = [f"slamhive-slamhive-{name}" for name in ("results", "data", "archive")]
    lab.cluster.kubectl("delete", "persistentvolume", *volumes, "--wait=false", "--ignore-not-found")


def test_kind_from_nothing_to_a_finished_sweep(kind_desk: Desk, lab: Lab, tmp_path: Path) -> None:
    """All but what needs kind itself: the node's folder has another name here, and so has the node."""
    cluster, folder = lab.cluster, tmp_path / "kind-data"
    for name in ("results", "data", "archive"):
        (folder / name).mkdir(parents=True)
    (install,) = documents.scripts(KIND["SLAM Hive"])
    (node,) = cluster.get("nodes")["items"]
    install = install.replace("/slamhive/", f"{folder}/", 3).replace(
        "slamhive-worker", node["metadata"]["name"]
    )
    before, middle, after = install.partition("cat > values.yaml")
    kind_desk.run(before)
    cluster.apply(stand_in(), namespace="slamhive")
    assert "synthetic-camera" in kind_desk.run(middle + after)
    for name, text in documents.files(KIND["A sweep"]).items():
        (kind_desk.folder / name).write_text(text)
    sweep, find = documents.scripts(KIND["A sweep"])
    told = kind_desk.run(sweep, timeout=1200)
    assert re.search(r"^sweep\S+first +Complete +4/4 ", told, re.MULTILINE)
    assert "docker exec slamhive-worker find /slamhive/results/runs -name trajectory.txt" in find
    assert len([*folder.glob("results/runs/**/trajectory.txt")]) == 4
    uninstall = documents.scripts(KIND["Clean up"])[0]
    kind_desk.run("".join(line for line in uninstall.splitlines(keepends=True) if "kind delete" not in line))


def test_images_of_kind_are_those_of_the_catalog() -> None:
    (build,) = documents.scripts(KIND["The images"])
    listed = subprocess.run([ROOT / "images" / "build", "--list"], capture_output=True, text=True, check=True)
    tags = dict(line.split() for line in listed.stdout.splitlines())
    named: dict[str, Any] = dict(re.findall(r"-f images/(?:algorithms/)?([\w-]+)/Dockerfile -t (\S+)", build))
    assert len(named) == 4
    assert named.items() <= tags.items()
    assert set(re.findall(r"slamhive/[\w.:-]+", build.partition("kind load")[2])) == set(named.values())
