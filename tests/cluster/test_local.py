# SPDX-License-Identifier: Apache-2.0
"""The local cluster runs pods as a real one does, and leaves nothing on the machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from testcluster import choice, machine
from testcluster.access import until
from testcluster.components import PAUSE_IMAGE

if TYPE_CHECKING:
    from testcluster.access import Cluster
    from testcluster.local import Local

PROGRAM = Path(machine.__file__)


@pytest.fixture(scope="session")
def local_mode() -> None:
    """Skip where there is no local cluster."""
    chosen = choice.choose()
    if chosen.mode != "local" or chosen.problems:
        pytest.skip(f"only a local cluster is looked at: {chosen.sentence()}")


@pytest.mark.cluster
@pytest.mark.parametrize("mode", ["down", "killed", "half", "owner"])
def test_nothing_is_left_on_the_machine(local_mode: None, mode: str) -> None:
    result = subprocess.run(
        [
            *("unshare", "--net", "--mount", "--propagation", "private"),
            *(sys.executable, str(PROGRAM), mode, f"{mode}{os.getpid()}"),
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["after"] == found["before"]
    assert found["before"]["processes"] == found["before"]["state"] == []


def _pod(name: str, **more: Any) -> dict[str, Any]:
    container = {"name": "x", "image": PAUSE_IMAGE, "securityContext": machine._RESTRICTED}
    spec = {"terminationGracePeriodSeconds": 1, "containers": [container | more]}
    return {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": name}, "spec": spec}


def test_pods_run_restricted(node_cluster: Cluster, namespace: str) -> None:
    node_cluster.apply(_pod("x"), namespace=namespace)
    node_cluster.kubectl("wait", "--for=condition=Ready", "pod/x", "-n", namespace, "--timeout=240s")
    result = node_cluster.run(
        *("apply", "-n", namespace, "-f", "-"),
        stdin=json.dumps(_pod("y", securityContext={"privileged": True})),
    )
    assert result.returncode == 1
    assert 'violates PodSecurity "restricted' in result.stderr


def test_the_metrics_api_answers(node_cluster: Cluster) -> None:
    assert node_cluster.mode != "local" or until(
        lambda: node_cluster.run("top", "node").returncode == 0, "the metrics API", 120, 1
    )


def test_the_node_has_control_groups_of_its_own(local_cluster: Local, namespace: str) -> None:
    access = local_cluster.access()
    access.apply(_pod("x"), namespace=namespace)
    access.kubectl("wait", "--for=condition=Ready", "pod/x", "-n", namespace, "--timeout=240s")
    uid = access.get("pod", "x", "-n", namespace)["metadata"]["uid"]
    name = local_cluster.instance.addresses().cgroup
    assert list(Path("/sys/fs/cgroup").glob(f"**/{name}/kubepods/*/pod{uid}"))


def test_programs_can_fail_and_come_back(local_cluster: Local, namespace: str) -> None:
    access = local_cluster.access()
    local_cluster.stop("apiserver")
    assert access.run("get", "ns", "--request-timeout=2s").returncode != 0
    local_cluster.start("apiserver")
    until(lambda: access.run("get", "ns", namespace).returncode == 0, "the API server")
