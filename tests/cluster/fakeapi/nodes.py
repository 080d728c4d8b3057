# SPDX-License-Identifier: Apache-2.0
"""Played nodes of the fake cluster: the scheduler that sends pods there, and the kubelets that play them.

What a pod's status says is the same as on a real control plane, where kwok plays it (testcluster/kwok.py).
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING

from fakeapi.objects import ENDED, now
from fakeapi.refusals import Refusal
from fakeapi.resources import NODES, PODS
from testcluster.kwok import IMAGE_ID, NOW, POOL, Play, moment_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from fakeapi.objects import Objects
    from testcluster.kwok import Moment

    from slamhive.kube.api.kinds import Object


class Nodes:
    """Schedules pods, plays them, and takes away those that are deleted.

    Args:
        objects: what there is.
        later: calls a function in some seconds.

    Attributes:
        plays: how pods end, by pool.
        patience: whether pods that are deleted go on, as programs do that ignore SIGTERM.
    """

    def __init__(self, objects: Objects, later: Callable[[float, Callable[[], None]], object]) -> None:
        self._objects = objects
        self._later = later
        self._played: set[str] = set()
        self.plays: dict[str, Play] = {}
        self.patience = False

    def look(self) -> None:
        """Look at all pods."""
        nodes = {node["metadata"]["name"]: node for node in self._objects.of(NODES)}
        for pod in self._objects.of(PODS):
            node = nodes.get(pod["spec"].get("nodeName", ""))
            if node is None:
                self._schedule(pod, nodes)
            elif "deletionTimestamp" in pod["metadata"]:
                if not self.patience:
                    self._take_away(pod)
            elif pod["metadata"]["uid"] not in self._played:
                self._play(pod, self.plays[node["metadata"]["labels"][POOL]])

    def _schedule(self, pod: Object, nodes: dict[str, Object]) -> None:
        if "deletionTimestamp" in pod["metadata"] or pod["status"]["phase"] in ENDED:
            return
        fitting = [name for name, node in nodes.items() if _fits(pod, node)]
        name = next((name for name in fitting if self._has_room(nodes[name])), None)
        if name is None:
            why = f"{len(fitting)} Too many pods" if fitting else "none fits its selector and tolerations"
            told = {
                "status": "False",
                "reason": "Unschedulable",
                "message": f"0/{len(nodes)} nodes are available: {why}.",
            }
        else:
            told = {"status": "True"}
            self._patch(pod, {"spec": {"nodeName": name}}, "")
        scheduled = [item for item in pod["status"].get("conditions") or () if item["type"] == "PodScheduled"]
        if not scheduled or scheduled[0]["status"] != told["status"]:
            condition = {"type": "PodScheduled", "lastTransitionTime": now()} | told
            self._patch(pod, {"status": {"conditions": [condition]}})

    def _has_room(self, node: Object) -> bool:
        """Tell whether a node holds fewer pods than it says that it can; one that says nothing holds all."""
        most = ((node.get("status") or {}).get("allocatable") or {}).get("pods")
        there = (
            pod["spec"].get("nodeName") == node["metadata"]["name"] and pod["status"]["phase"] not in ENDED
            for pod in self._objects.of(PODS)
        )
        return most is None or sum(there) < int(most)

    def _play(self, pod: Object, play: Play) -> None:
        uid = pod["metadata"]["uid"]
        moment = moment_of(play, (pod["metadata"].get("labels") or {}).get("slamhive.io/role", ""))
        self._played.add(uid)
        if moment.delay_milliseconds:
            self._later(moment.delay_milliseconds / 1000, lambda: self._end(pod, moment))
        else:
            self._end(pod, moment)

    def _end(self, pod: Object, moment: Moment) -> None:
        # In the meantime it may have been deleted.
        with suppress(Refusal):
            self._patch(pod, {"metadata": {"uid": pod["metadata"]["uid"]}, "status": status_of(pod, moment)})

    def _take_away(self, pod: Object) -> None:
        metadata = pod["metadata"]
        self._patch(pod, {"metadata": {"finalizers": None}}, "")
        now_gone = {"gracePeriodSeconds": 0, "preconditions": {"uid": metadata["uid"]}}
        self._objects.delete(PODS, metadata["namespace"], metadata["name"], now_gone)

    def _patch(self, pod: Object, change: Object, subresource: str = "status") -> None:
        metadata = pod["metadata"]
        self._objects.patch(PODS, metadata["namespace"], metadata["name"], change, subresource)


def status_of(pod: Object, moment: Moment) -> Object:
    """Return the status of a played pod."""
    running = moment.phase == "Running"
    kept = [item for item in pod["status"].get("conditions") or () if item["type"] == "PodScheduled"]
    shown = [{"type": "Initialized", "status": "True"}, {"type": "Ready", "status": str(running)}]
    told = {
        "phase": moment.phase,
        "startTime": NOW,
        "conditions": kept + [item | {"lastTransitionTime": NOW} for item in shown],
    }
    for field, source, state in (
        ("containerStatuses", "containers", moment.main),
        ("initContainerStatuses", "initContainers", moment.first),
    ):
        if pod["spec"].get(source):
            told[field] = [_container(item, state, running=running) for item in pod["spec"][source]]
    status: Object = json.loads(json.dumps(told).replace(NOW, now()))
    return status


def _container(container: Object, state: Object, *, running: bool) -> Object:
    return {
        "name": container["name"],
        "image": container["image"],
        "imageID": IMAGE_ID,
        "containerID": f"fake://{container['name']}",
        "ready": running,
        "started": running,
        "restartCount": 0,
        "state": state,
    }


def _fits(pod: Object, node: Object) -> bool:
    labels = node["metadata"].get("labels") or {}
    tolerated = {
        (item.get("key"), item.get("value"), item.get("effect"))
        for item in pod["spec"].get("tolerations") or ()
    }
    taints = (node.get("spec") or {}).get("taints") or ()
    return all(
        labels.get(key) == value for key, value in (pod["spec"].get("nodeSelector") or {}).items()
    ) and all((taint["key"], taint["value"], taint["effect"]) in tolerated for taint in taints)
