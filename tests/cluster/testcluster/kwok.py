# SPDX-License-Identifier: Apache-2.0
"""Nodes and pods that are only played: runs by the thousand, each ending as a real one would tell it."""

from __future__ import annotations

import json
import subprocess
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from testcluster.access import until
from testcluster.errors import ClusterError
from testcluster.programs import build, path_of

from slamhive.jobs.messages import described
from slamhive.monitor.measuring.accounting import MeasuredCpu, MeasuredMemory, MeasuredUsage
from slamhive.monitor.pod.termination import termination_message
from slamhive.monitor.summary import RunSummary

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from testcluster.access import Cluster

POOL = "slamhive.io/kwok"
NOW = "{{ $now }}"
"""The time at which a pod is played, as kwok writes it into its templates."""
_GROUP = "kwok.x-k8s.io/v1alpha1"
_DIGEST = "0123456789abcdef" * 4
IMAGE_ID = f"localhost/played@sha256:{_DIGEST}"


@dataclass(frozen=True)
class Pool:
    """A pool of played nodes; pods go there by its selector and toleration.

    Attributes:
        name: name of the pool.
        nodes: names of its nodes.
    """

    name: str
    nodes: tuple[str, ...]

    @property
    def node_selector(self) -> dict[str, str]:
        """The label of its nodes."""
        return {POOL: self.name}

    @property
    def tolerations(self) -> list[dict[str, str]]:
        """Tolerations of what keeps other pods away."""
        return [{"key": POOL, "operator": "Equal", "value": self.name, "effect": "NoSchedule"}]


def run_message(**changes: Any) -> str:
    """Return the monitor's message on a run that succeeded, with some fields changed."""
    usage = MeasuredUsage(
        cpu=MeasuredCpu(
            mean_cores=0.8, max_cores=1.0, seconds=8.0, seconds_per_data_second=0.4, total_seconds=8.0
        ),
        memory=MeasuredMemory(
            peak_bytes=200 << 20,
            mean_bytes=150.0 * 2**20,
            anonymous_peak_bytes=180 << 20,
            working_set_peak_bytes=190 << 20,
            kernel_peak_bytes=210 << 20,
        ),
        wall_seconds=10.0,
        throttled_seconds=0.0,
        contended_seconds=0.0,
        reader_cpu_seconds=None,
        reader_share=None,
        samples=100,
        source="cgroup",
        includes_reader=False,
        max_includes_reader=False,
    )
    summary = RunSummary(
        exit_code=None,
        signal=None,
        reason=None,
        message="",
        started_at=None,
        finished_at=None,
        usage=usage,
        log_tail="",
    )
    trajectory = {"poses": 200, "durationSeconds": 20.0, "sha256": _DIGEST, "path": "output/trajectory.txt"}
    told = summary.as_json() | {"startedAt": NOW, "finishedAt": NOW, "trajectory": trajectory}
    told |= {"frames": {"offered": 200, "processed": 200, "dropped": 0}, "cpuModel": "played"}
    return termination_message(told | changes).decode()


def description(roles: Mapping[str, Mapping[str, Any]] | None = None, **changes: Any) -> dict[str, Any]:
    """Return the description of a variant with a LiDAR and an IMU, or with other sensors by role."""
    shown = roles or {
        "lidar": {"name": "lidar", "type": "Lidar", "topic": "/points", "rate": 10.0},
        "imu": {"name": "imu", "type": "Imu", "topic": "/imu", "rate": 200.0},
    }
    return {
        "folder": "played",
        "format": "Rosbag1",
        "recording": "recording.bag",
        "sensors": {role: dict(view) for role, view in shown.items()},
        "startTime": 1.6e9,
        "durationSeconds": 20.0,
        "frameRate": 10.0,
        "resolution": 1.0,
        "frames": 200,
        "key": "played",
        "sourceSha256": _DIGEST,
        "datasetSha256": _DIGEST,
        "sizeBytes": 1 << 20,
        "groundTruth": "poses",
        "T_body_frame": None,
        "extrinsics": {},
        "preparationVersion": 1,
    } | changes


@dataclass(frozen=True)
class Play:
    """Script for played pods: how long they run, how they end and what their monitors say.

    Attributes:
        run: what the monitor of a run says; None leaves it silent.
        exit_code: exit code of the algorithm.
        hold: runs go on for ever.
        variant: description that a preparation tells.
        delay_milliseconds: how long a pod runs at least.
        ends: by role, how pods end that end otherwise, as ``ended`` makes it.
    """

    run: str | None = None
    exit_code: int = 0
    hold: bool = False
    variant: Mapping[str, Any] | None = None
    delay_milliseconds: int = 0
    ends: Mapping[str, Moment] = field(default_factory=dict)


@dataclass(frozen=True)
class Moment:
    """Status of a played pod from some moment on: its phase and the states of its containers.

    Attributes:
        phase: the pod's phase.
        main: state of its containers.
        first: state of those that begin before them, its monitor among them.
        delay_milliseconds: how long after the pod's beginning.
    """

    phase: str
    main: dict[str, Any]
    first: dict[str, Any]
    delay_milliseconds: int = 0


def moment_of(play: Play, role: str) -> Moment:
    """Return the end of a role's pod, or the moment from which it goes on; times in it are ``NOW``."""
    if role in play.ends:
        return play.ends[role]
    if role == "prepare":
        told = _terminated(0, described(play.variant or description()))
        return Moment("Succeeded", told, told)
    if role != "run":
        ended = _terminated(play.exit_code)
        return Moment("Succeeded", ended, ended)
    if play.hold:
        running = {"running": {"startedAt": NOW}}
        return Moment("Running", running, running)
    watched = _terminated(0, play.run or run_message())
    phase = "Failed" if play.exit_code else "Succeeded"
    return Moment(phase, _terminated(play.exit_code), watched, play.delay_milliseconds)


def ended(exit_code: int, message: str | None = None) -> Moment:
    """Return the end of a pod, all of its containers alike."""
    told = _terminated(exit_code, message)
    return Moment("Failed" if exit_code else "Succeeded", told, told)


def _terminated(exit_code: int, message: str | None = None) -> dict[str, Any]:
    state = {"exitCode": exit_code, "reason": "Error" if exit_code else "Completed"}
    said = {} if message is None else {"message": message}
    return {"terminated": state | {"startedAt": NOW, "finishedAt": NOW} | said}


def stages(play: Play) -> str:
    """Return kwok's stages: nodes that are ready, pods that run, end and go when they are deleted."""
    items = [
        _stage("node-initialize", "Node", _NODE_UNREADY, _NODE_STATUS),
        _stage("pod-delete", "Pod", _when("Exists"), None),
    ]
    roles = sorted({"prepare", "run", *play.ends})
    for role in (*roles, "other"):
        where = _where_role("NotIn", *roles) if role == "other" else _where_role("In", role)
        told = moment_of(play, role)
        items.append(_stage(f"pod-{role}", "Pod", _UNPLAYED + where, _pod(told), told.delay_milliseconds))
    return "---\n".join(json.dumps(item) + "\n" for item in items)


def _when(deleted: str) -> list[dict[str, Any]]:
    return [{"key": ".metadata.deletionTimestamp", "operator": deleted}]


def _where_role(operator: str, *roles: str) -> list[dict[str, Any]]:
    return [{"key": '.metadata.labels["slamhive.io/role"]', "operator": operator, "values": [*roles]}]


_UNPLAYED = [
    *_when("DoesNotExist"),
    {"key": ".status.phase", "operator": "NotIn", "values": ["Running", "Succeeded", "Failed"]},
]
_NODE_UNREADY = [
    {
        "key": '.status.conditions.[] | select( .type == "Ready" ) | .status',
        "operator": "NotIn",
        "values": ["True"],
    }
]
_ROOM = '{cpu: "100000", memory: 1000Ti, pods: "1000000"}'
_NODE_STATUS = f"""\
{{{{ $now := Now }}}}
conditions:
- {{type: Ready, status: "True", reason: KubeletReady, message: played, lastHeartbeatTime: "{NOW}", \
lastTransitionTime: "{NOW}"}}
capacity: {_ROOM}
allocatable: {_ROOM}
"""


def _statuses(field: str, source: str, state: dict[str, Any], *, running: bool) -> str:
    ready = str(running).lower()
    return f"""\
{{{{ if .spec.{source} }}}}
{field}:
{{{{ range .spec.{source} }}}}
- name: {{{{ .name | Quote }}}}
  image: {{{{ .image | Quote }}}}
  imageID: "{IMAGE_ID}"
  containerID: "kwok://{{{{ .name }}}}"
  ready: {ready}
  started: {ready}
  restartCount: 0
  state: {json.dumps(state)}
{{{{ end }}}}
{{{{ end }}}}
"""


def _pod(told: Moment) -> str:
    """Return the template of a pod's status; kwok fills in times and containers."""
    running = told.phase == "Running"
    return (
        f"""\
{{{{ $now := Now }}}}
phase: {told.phase}
startTime: "{NOW}"
conditions:
- {{type: Initialized, status: "True", lastTransitionTime: "{NOW}"}}
- {{type: Ready, status: "{running}", lastTransitionTime: "{NOW}"}}
"""
        + _statuses("containerStatuses", "containers", told.main, running=running)
        + _statuses("initContainerStatuses", "initContainers", told.first, running=running)
    )


def _stage(
    name: str, kind: str, expressions: list[dict[str, Any]], template: str | None, delay: int = 0
) -> dict[str, Any]:
    then = (
        {"finalizers": {"empty": True}, "delete": True} if template is None else {"statusTemplate": template}
    )
    spec: dict[str, Any] = {
        "resourceRef": {"apiGroup": "v1", "kind": kind},
        "selector": {"matchExpressions": expressions},
        "next": then,
    }
    if delay:
        spec["delay"] = {"durationMilliseconds": delay}
    return {"apiVersion": _GROUP, "kind": "Stage", "metadata": {"name": name}, "spec": spec}


def node(name: str, pool: str) -> dict[str, Any]:
    """Return a node of a pool, which keeps other pods away."""
    return {
        "apiVersion": "v1",
        "kind": "Node",
        "metadata": {
            "name": name,
            "labels": {POOL: pool, "kubernetes.io/hostname": name},
            "annotations": {POOL: pool},
        },
        "spec": {"taints": [{"key": POOL, "value": pool, "effect": "NoSchedule"}]},
    }


@dataclass(frozen=True)
class Kwok:
    """Plays nodes on a cluster."""

    cluster: Cluster

    @contextmanager
    def play(self, how: Play | None = None, *, pool: str = "played", nodes: int = 1) -> Iterator[Pool]:
        """Have a pool of nodes whose pods end as asked, as long as the context lasts.

        Args:
            how: how pods end; at once and with success by default.
            pool: name of the pool; one of each name at a time.
            nodes: number of nodes, each with room for all pods.
        """
        build(("kwok",))
        names = tuple(f"{pool}-{number}" for number in range(nodes))
        with (
            tempfile.TemporaryDirectory() as folder,
            _running(self.cluster, Path(folder), how or Play(), pool),
        ):
            try:
                self.cluster.apply(*(node(name, pool) for name in names))
                until(lambda: self._ready(pool) == nodes, f"{nodes} played nodes", 240)
                yield Pool(pool, names)
            finally:
                self.cluster.kubectl(
                    "delete", "node", "-l", f"{POOL}={pool}", "--ignore-not-found", "--wait=false"
                )

    def _ready(self, pool: str) -> int:
        nodes = self.cluster.get("nodes", "-l", f"{POOL}={pool}")["items"]
        conditions = [item for node in nodes for item in node.get("status", {}).get("conditions", [])]
        return sum(item["type"] == "Ready" and item["status"] == "True" for item in conditions)


@contextmanager
def _running(cluster: Cluster, folder: Path, how: Play, pool: str) -> Iterator[None]:
    config, log = folder / "stages.yaml", folder / "kwok.log"
    config.write_text(stages(how))
    with log.open("wb") as output:
        # A killed test session takes its children along.
        process = subprocess.Popen(
            [
                *("setpriv", "--pdeathsig", "KILL", str(path_of("kwok")), f"--config={config}"),
                *(f"--kubeconfig={cluster.kubeconfig}", "--node-lease-duration-seconds=40"),
                f"--manage-nodes-with-annotation-selector={POOL}={pool}",
            ],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
        )
        try:
            yield
        except ClusterError as error:
            tail = log.read_text(errors="replace")[-1500:]
            raise ClusterError(f"{error}; the end of kwok's log:\n{tail}") from None
        finally:
            process.terminate()
            process.wait(30)
