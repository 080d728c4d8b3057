# SPDX-License-Identifier: Apache-2.0
"""Nodes that are emptied or go away under a run: it is done again, and nothing counts against it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from faultlab.scenarios import Scenario
from testcluster.kwok import Play
from testcluster.lab import run

from slamhive.kube.api.kinds import Label

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from faultlab.arena import Arena, Instance
    from testcluster.access import Cluster
    from testcluster.kwok import Kwok


def taint(cluster: Cluster, node: str) -> None:
    cluster.kubectl("taint", "node", node, "test=empty:NoExecute", "--overwrite")


def drain(cluster: Cluster, node: str) -> None:
    cluster.kubectl("drain", node, f"--pod-selector={Label.ROLE}=run", "--delete-emptydir-data")


def delete(cluster: Cluster, node: str) -> None:
    cluster.kubectl("delete", "node", node)


@pytest.mark.parametrize(
    "lose", [taint, drain, pytest.param(delete, marks=pytest.mark.slow)], ids=["taint", "drain", "delete"]
)
async def test_a_run_whose_node_goes_is_done_again(
    arena: Arena, kwok: Kwok, lose: Callable[[Cluster, str], None]
) -> None:
    def pods(instance: Instance) -> list[dict[str, Any]]:
        return [pod for pod in arena.seen.alive("pods", instance.namespace) if _is_running(pod)]

    def status(instance: Instance) -> dict[str, Any]:
        body = arena.seen.named("mappingruns", instance.namespace, "one") or {}
        found: dict[str, Any] = body.get("status") or {}
        return found

    async def course(instance: Instance) -> dict[str, Any]:
        instance.lab.pool = pool
        async with instance.operator():
            await instance.until(lambda: status(instance).get("phase") == "Running", "the run")
            [first] = pods(instance)
            lose(instance.lab.cluster, first["spec"]["nodeName"])
            uid = first["metadata"]["uid"]
            await instance.until(
                lambda: [pod["metadata"]["uid"] for pod in pods(instance)] not in ([], [uid]),
                "another pod",
                150,
            )
            [second] = pods(instance)
            assert second["spec"]["nodeName"] != first["spec"]["nodeName"]
            await instance.until(lambda: status(instance).get("phase") == "Running", "the run to go on")
            return status(instance)

    scenario = Scenario("lost", (run("one", retries=0),), Play(hold=True))
    with kwok.play(Play(hold=True), pool=f"lost-{lose.__name__}", nodes=2) as pool:
        found = await arena.play(scenario, course)
    assert (found["phase"], found.get("faults"), found.get("reason")) == ("Running", None, None)


def _is_running(pod: dict[str, Any]) -> bool:
    labels = pod["metadata"]["labels"]
    return labels.get(Label.ROLE) == "run" and pod["status"].get("phase") == "Running"
