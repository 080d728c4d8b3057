# SPDX-License-Identifier: Apache-2.0
"""Helpers of the operator's benchmarks: a cluster of their own, its CPU time, an operator's process."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parents[1] / "cluster"))

from testcluster import missing
from testcluster.access import until
from testcluster.fixtures import CRDS
from testcluster.kwok import POOL
from testcluster.lab import algorithm, dataset, volumes
from testcluster.local import Local

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from testcluster.access import Cluster

TICKS = os.sysconf("SC_CLK_TCK")
PROGRAMS = ("kube-apiserver", "etcd", "kube-controller-manager", "kube-scheduler", "kwok")


def report(what: str, ours: str, peer: str) -> None:
    """Print one figure."""
    print(f"{what} · {ours} · {peer}", flush=True)


def load() -> str:
    """Say how busy the machine is."""
    return f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores"


def lacking() -> str | None:
    """Return a line about why there can be no cluster here, None where there can be one."""
    problems = missing.missing()
    return f"no test cluster can be had here, so no figures: {'; '.join(problems)}" if problems else None


@contextmanager
def cluster(name: str, *, node: bool) -> Iterator[Cluster]:
    """Have a cluster of this name for as long as the context or this process lasts, with our kinds."""
    local = Local.named(name)
    reading, writing = os.pipe()
    try:
        access = local.up(node=node, owner=reading)
        access.apply_files(CRDS)
        access.await_kinds(f"{path.stem.partition('_')[2]}.slamhive.io" for path in CRDS)
        yield access
    finally:
        local.down()
        os.close(reading)
        os.close(writing)


def namespace(access: Cluster, name: str) -> str:
    """Make a namespace that enforces restricted Pod Security and holds volumes and a catalog."""
    labels = {"pod-security.kubernetes.io/enforce": "restricted"}
    access.apply({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name, "labels": labels}})
    access.apply(*volumes(name), algorithm(), dataset(), namespace=name)
    return name


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def cpu_by_program(access: Cluster) -> Counter[str]:
    """Return the CPU seconds of the programs of a cluster so far."""
    used: Counter[str] = Counter()
    mark = str(access.kubeconfig.parent)
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = path.read_bytes().decode(errors="replace").split("\0")
            name = Path(words[0]).name
            if name in PROGRAMS and any(mark in word for word in words):
                used[name] += cpu_seconds(int(path.parent.name))  # type: ignore[assignment]
    return used


def memory_mib(pid: int, field: str) -> float:
    """Return a field of a process's memory, such as Pss."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return int(text.partition(f"\n{field}:")[2].split()[0]) / 1024


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


class OperatorProcess:
    """An operator's process."""

    def __init__(self, process: subprocess.Popen[bytes], metrics_port: int) -> None:
        self.pid = process.pid
        self._address = f"http://127.0.0.1:{metrics_port}/metrics"

    @property
    def cpu(self) -> float:
        """CPU seconds so far."""
        return cpu_seconds(self.pid)

    def calls(self) -> Counter[str]:
        """Return how often it has called the API so far, by verb and resource."""
        return self._series("slamhive_api_calls_total", "verb", "resource")

    def reconciled(self) -> Counter[str]:
        """Return how often it has looked at an object so far, by kind."""
        return self._series("slamhive_reconcile_seconds_count", "kind")

    def _series(self, name: str, *labels: str) -> Counter[str]:
        with urllib.request.urlopen(self._address, timeout=10) as answer:  # noqa: S310 - of this machine
            lines = answer.read().decode().splitlines()
        found: Counter[str] = Counter()
        for line in lines:
            if line.startswith(f"{name}{{"):
                pairs = line.partition("{")[2].rpartition("}")
                values = dict(pair.split("=", 1) for pair in pairs[0].split(","))
                key = " ".join(values[label].strip('"') for label in labels)
                found[key] += int(float(pairs[2]))
        return found


@contextmanager
def operator(access: Cluster, where: str, pods: dict[str, Any], **changes: Any) -> Iterator[OperatorProcess]:
    """Run an operator for a namespace as a process of its own."""
    metrics, health = _free_port(), _free_port()
    settings = {
        "namespaces": [where],
        "image": "example.test/slamhive:1",
        "volumes": {"results": {"claim": "results"}, "data": {"claim": "data"}},
        "pods": pods,
        "metrics": {"port": metrics},
        "health": {"port": health},
    } | changes
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "operator.yaml"
        file.write_text(json.dumps(settings))
        command = [sys.executable, "-P", "-m", "slamhive.kube", "--settings", str(file)]
        with (Path(folder) / "log").open("wb") as log:
            process = subprocess.Popen(
                [*command, "--kubeconfig", str(access.kubeconfig)], stdout=log, stderr=log
            )
        try:
            until(lambda: _ready(process, health), "the operator to be ready", 60, 0.1)
            yield OperatorProcess(process, metrics)
        except BaseException:
            sys.stderr.write((Path(folder) / "log").read_text()[-4000:])
            raise
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(30)


def _ready(process: subprocess.Popen[bytes], port: int) -> bool:
    if process.poll() is not None:
        raise SystemExit(f"the operator ended with exit code {process.returncode}")
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=2) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def settled(read: Callable[[], int], seconds: float = 3.0) -> None:
    """Wait until a counter hasn't changed for some seconds."""
    last, since = read(), time.monotonic()
    while time.monotonic() - since < seconds:
        time.sleep(0.2)
        if (now := read()) != last:
            last, since = now, time.monotonic()


def played_pods(pool: str) -> dict[str, Any]:
    """Return what sends pods to a pool of played nodes."""
    toleration = {"key": POOL, "operator": "Equal", "value": pool, "effect": "NoSchedule"}
    return {"nodeSelector": {POOL: pool}, "tolerations": [toleration]}
