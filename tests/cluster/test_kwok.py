# SPDX-License-Identifier: Apache-2.0
"""Played pods tell what real ones would."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from testcluster import kwok as played
from testcluster.access import until

from slamhive.model.variant import VariantDescription
from slamhive.monitor.pod.termination import LIMIT_BYTES

if TYPE_CHECKING:
    from testcluster.access import Cluster
    from testcluster.kwok import Kwok, Play, Pool


def _job(name: str, role: str, pool: Pool) -> dict[str, Any]:
    labels = {"slamhive.io/role": role}
    template = {
        "metadata": {"labels": labels},
        "spec": {
            "restartPolicy": "Never",
            "nodeSelector": pool.node_selector,
            "tolerations": pool.tolerations,
            "initContainers": [{"name": "monitor", "image": "monitor", "restartPolicy": "Always"}],
            "containers": [{"name": "algorithm", "image": "algorithm"}],
        },
    }
    return {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": name, "labels": labels},
        "spec": {"backoffLimit": 0, "template": template},
    }


def _pod(cluster: Cluster, namespace: str, phase: str) -> dict[str, Any]:
    def found() -> list[dict[str, Any]]:
        items = cluster.get("pods", "-n", namespace)["items"]
        return [pod for pod in items if pod["status"].get("phase") == phase]

    return until(found, f"a pod that is {phase}")[0]


@pytest.fixture
def loose(namespace: str, control_plane: Cluster) -> str:
    """A namespace that takes pods without security settings."""
    control_plane.kubectl("label", "ns", namespace, "pod-security.kubernetes.io/enforce-", "--overwrite")
    return namespace


@pytest.mark.parametrize(
    ("play", "phase", "condition"),
    [
        (played.Play(), "Succeeded", "Complete"),
        (played.Play(exit_code=3), "Failed", "Failed"),
    ],
)
def test_runs_end_with_the_monitors_word(
    kwok: Kwok, loose: str, play: Play, phase: str, condition: str
) -> None:
    with kwok.play(play) as pool:
        kwok.cluster.apply(_job("run", "run", pool), namespace=loose)
        pod = _pod(kwok.cluster, loose, phase)
        kwok.cluster.kubectl("wait", f"--for=condition={condition}", "job/run", "-n", loose, "--timeout=240s")
    monitor = pod["status"]["initContainerStatuses"][0]["state"]["terminated"]
    assert len(monitor["message"].encode()) <= LIMIT_BYTES
    told = json.loads(monitor["message"])
    assert told["v"] == 1
    assert told["trajectory"]["poses"] == 200
    assert told["startedAt"][:19] == monitor["startedAt"][:19]
    algorithm = pod["status"]["containerStatuses"][0]["state"]["terminated"]
    assert algorithm["exitCode"] == play.exit_code


def test_runs_can_go_on_for_ever(kwok: Kwok, loose: str) -> None:
    with kwok.play(played.Play(hold=True), nodes=2) as pool:
        kwok.cluster.apply(_job("run", "run", pool), namespace=loose)
        pod = _pod(kwok.cluster, loose, "Running")
        assert "running" in pod["status"]["containerStatuses"][0]["state"]
        assert pod["spec"]["nodeName"] in pool.nodes


def test_preparations_tell_a_description_that_the_operator_reads(kwok: Kwok, loose: str) -> None:
    with kwok.play() as pool:
        kwok.cluster.apply(_job("prepare", "prepare", pool), namespace=loose)
        pod = _pod(kwok.cluster, loose, "Succeeded")
    message = pod["status"]["containerStatuses"][0]["state"]["terminated"]["message"]
    assert message == played.described(played.description())
    assert VariantDescription.model_validate(played.description()).frames == 200


def test_other_pods_keep_away_from_played_nodes(kwok: Kwok, loose: str) -> None:
    pod = _job("x", "other", played.Pool("played", ()))["spec"]["template"]
    pod["spec"] |= {"nodeSelector": {played.POOL: "played"}, "tolerations": []}
    with kwok.play():
        body = {"apiVersion": "v1", "kind": "Pod", **pod, "metadata": {"name": "stray"}}
        kwok.cluster.apply(body, namespace=loose)
        path = "jsonpath={.status.conditions[?(@.type=='PodScheduled')].reason}"
        reason = until(
            lambda: kwok.cluster.kubectl("get", "pod", "stray", "-n", loose, "-o", path), "a decision"
        )
    assert reason == "Unschedulable"
