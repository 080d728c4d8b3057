# SPDX-License-Identifier: Apache-2.0
"""A real API server takes the golden manifests, and restricted Pod Security their pods."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from testcluster.access import until

if TYPE_CHECKING:
    from testcluster.access import Cluster

MANIFESTS = sorted((Path(__file__).parent / "golden").glob("*-job.yaml"))
NOT_HERE = ("priorityClassName", "runtimeClassName")


def test_all_are_accepted(control_plane: Cluster, namespace: str) -> None:
    assert len(MANIFESTS) == 9
    until(
        lambda: not control_plane.run("-n", namespace, "get", "serviceaccount", "default").returncode,
        "the namespace's account",
    )
    objects = []
    for path in MANIFESTS:
        job = yaml.safe_load(path.read_text(encoding="utf-8"))
        template = job["spec"]["template"]
        template["spec"] = {key: value for key, value in template["spec"].items() if key not in NOT_HERE}
        name = path.stem
        pod = {"apiVersion": "v1", "kind": "Pod", "spec": template["spec"]}
        pod["metadata"] = template["metadata"] | {"name": name, "namespace": namespace}
        job["metadata"] |= {"name": name, "namespace": namespace}
        objects += [job, pod]
    body = json.dumps({"apiVersion": "v1", "kind": "List", "items": objects})
    told = control_plane.run("create", "--dry-run=server", "--validate=strict", "-f", "-", stdin=body)
    assert not told.returncode, told.stderr
    assert told.stdout.count("created (server dry run)") == len(objects)
    assert not told.stderr
