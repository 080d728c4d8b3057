# SPDX-License-Identifier: Apache-2.0
"""A sequence of a lab's own catalogue: preparations on a node fetch it once, from the lab's own mirror."""

from __future__ import annotations

import os
import re
import sys
import tarfile
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from onnode import documents
from onnode.documents import ROOT
from onnode.lab import RUNS, manifest
from testcluster.access import until
from testcluster.places import Instance

from slamhive.data.store.datasets import materialise
from slamhive.model.dataset import Dataset
from slamhive.model.loading import load_file

sys.path.insert(0, str(ROOT / "tests" / "data" / "datalab"))

from serving import Site, make_certificate, serving

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from onnode.lab import Lab

    from slamhive.data.recordings.entries import DatasetEntry

DATASET, SWEEPS = "hall", ("whole", "thinned")
OTHERS = 12 << 20
"""Bytes of what is beside the sequence in its archive."""
HELD = 6 << 20
"""Bytes after which the server waits."""
SURE = HELD - (2 << 20)
"""Bytes that are surely on the disk then: a block or two are on the way."""


@pytest.fixture
def mirror(lab: Lab, tiny: Path, tmp_path: Path) -> Iterator[Site]:
    """The lab's mirror, known to the operator as docs/kubernetes.md says."""
    dataset = load_file(ROOT / "tests" / "actor" / "tiny.yaml")[0]
    assert isinstance(dataset, Dataset)
    assert lab.cluster.instance is not None
    entry = materialise(dataset, tiny, tiny)
    served = tmp_path / "served"
    served.mkdir()
    (tmp_path / "others").write_bytes(os.urandom(OTHERS))
    with tarfile.open(served / "halls.tar", "w") as archive:
        archive.add(tmp_path / "others", "halls/others.bin")
        for name in ("recording.bag", "groundtruth.txt"):
            archive.add(entry.root / name, f"halls/{name}")
    address = Instance(lab.cluster.instance).addresses().machine
    certificate, key = make_certificate(tmp_path, f"IP:{address}")
    with serving(Site(served, held=HELD), certificate, key, address) as site:
        (tmp_path / "families").mkdir()
        (tmp_path / "families" / "ours.yaml").write_text(yaml.safe_dump(family(site, entry)))
        (tmp_path / "ca.crt").write_bytes(certificate.read_bytes())
        (commands,) = documents.scripts(documents.sections("kubernetes.md")["A mirror of your own"])
        commands = re.sub(r"--from-file=(families/|ca.crt)", rf"--from-file={tmp_path}/\1", commands)
        # Two preparations at the same time on a node of two processors.
        told = lab.desk.run(f"{commands.rstrip()} --set settings.preparation.cpu=250m")
        assert "configmap/mirror created" in told
        lab.kubectl("rollout", "status", "deployment/slamhive-operator", "--timeout=5m", timeout=400)
        yield site


def family(site: Site, entry: DatasetEntry) -> dict[str, Any]:
    """Return a family of one sequence in an archive."""
    spec = entry.dataset.spec
    return {
        "name": "ours",
        "title": "Our halls",
        "homepage": site.url,
        "license": "CC0-1.0",
        "cite": "Nobody",
        "layout": "Bag",
        "sensors": {"lidar": "Lidar"},
        "folder": "halls",
        "parts": {"archive": {"url": f"{site.url}/halls.tar", "members": ["halls"]}},
        "dataset": {
            "recording": {"format": "Rosbag1", "files": [{"path": "recording.bag"}]},
            "sensors": {name: sensor.as_json() for name, sensor in spec.sensors.items()},
            "groundTruth": {"file": "groundtruth.txt"},
        },
        "sequences": {"hall": None},
    }


def test_preparations_fetch_a_sequence_once_and_go_on_after_a_kill(lab: Lab, mirror: Site) -> None:
    lab.apply_algorithm(ROOT / "tests" / "images" / "shell-algorithm")
    lab.apply(manifest("Dataset", DATASET, catalogue="ours/hall"))
    template = lab.run("x", "shell-dead-reckoning", datasetRef={"name": DATASET}, evaluate=False)["spec"]
    rates = dict(zip(SWEEPS, (10, 5), strict=True))
    for name, rate in rates.items():
        spec = template | {"input": {"frameRate": rate}}
        lab.apply(manifest("Sweep", name, template={"spec": spec}, matrix=[]))
    archive = (mirror.folder / "halls.tar").stat().st_size
    until(lambda: mirror.sent >= HELD and len(preparing(lab)) == 2, "both preparations at the sequence", 300)
    lab.kubectl("delete", "pod", *preparing(lab), "--grace-period=0", "--force")
    mirror.held = None
    mirror.go.set()
    for name in SWEEPS:
        assert lab.completed(name)["succeeded"] == 1
    first, *later = [asked for _, asked in mirror.asked]
    starts = [int(re.findall(r"\d+", str(asked))[0]) for asked in later]
    assert first is None
    assert starts
    assert min(starts) >= SURE
    assert mirror.sent <= archive + (HELD - SURE)
    (made,) = (lab.data / "generated").glob(f"{DATASET}-*")
    assert (made / "imported" / "recording.bag").is_file()
    assert (lab.data / "groundtruth" / f"{DATASET}.txt").is_file()
    items = [run for run in lab.get(RUNS)["items"] if run["spec"]["datasetRef"]["name"] == DATASET]
    assert {run["status"]["frames"]["offered"] for run in items} == {100, 50}


def preparing(lab: Lab) -> list[str]:
    """Return the running pods of the dataset's preparations."""
    pods = lab.get("pods", "-l", f"slamhive.io/role=prepare,slamhive.io/dataset={DATASET}")["items"]
    return [pod["metadata"]["name"] for pod in pods if pod["status"]["phase"] == "Running"]
