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
MEMORY_LIMIT_MIB = 200
"""Of the operator."""
NEW_KINDS_SECONDS = 35.0
"""After that the cluster's garbage collector has noticed our kinds; until then it tries again and again."""
PROGRAMS = ("kube-apiserver", "etcd", "kube-controller-manager", "kube-scheduler", "kwok", "kueue")


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


class ProgramTimes:
    """CPU time of the programs of a cluster, those that were killed included as far as they were seen."""

    def __init__(self, access: Cluster) -> None:
        self._mark = str(access.kubeconfig.parent)
        self._seen: dict[tuple[str, str], float] = {}

    def read(self) -> Counter[str]:
        """Return the CPU seconds of each program so far."""
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with suppress(OSError):
                words = path.read_bytes().decode(errors="replace").split("\0")
                name = Path(words[0]).name
                if name in PROGRAMS and any(self._mark in word for word in words):
                    self._seen[name, path.parent.name] = cpu_seconds(int(path.parent.name))
        used: Counter[str] = Counter()
        for (name, _), seconds in self._seen.items():
            used[name] += seconds  # type: ignore[assignment]
        return used


def memory_mib(pid: int, field: str) -> float:
    """Return a field of a process's memory, such as Pss."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return int(text.partition(f"\n{field}:")[2].split()[0]) / 1024


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


class OperatorProcess:
    """An operator's process, which can be killed and started again.

    Args:
        command: what is started.
        log: file for what it says.
        metrics_port: where it shows its figures.
        health_port: where it says whether it is ready.
    """

    def __init__(self, command: list[str], log: Path, metrics_port: int, health_port: int) -> None:
        self._command = command
        self._log = log
        self._address = f"http://127.0.0.1:{metrics_port}/metrics"
        self._health_port = health_port
        self._process: subprocess.Popen[bytes] | None = None
        self._former_cpu = 0.0

    @property
    def pid(self) -> int:
        """Its process id.

        Raises:
            ProcessLookupError: it does not run now.
        """
        if self._process is None:
            raise ProcessLookupError("the operator is not running")
        return self._process.pid

    @property
    def cpu(self) -> float:
        """CPU seconds so far, those of killed processes included."""
        return self._former_cpu + (cpu_seconds(self._process.pid) if self._process else 0.0)

    def start(self, seconds: float = 60) -> None:
        """Start it and wait until it is ready."""
        with self._log.open("ab") as log:
            process = subprocess.Popen(self._command, stdout=log, stderr=log)
        self._process = process
        until(lambda: _ready(process, self._health_port), "the operator to be ready", seconds, 0.1)

    def end(self, number: int = signal.SIGTERM) -> None:
        """Send it a signal and wait for its end."""
        process = self._process
        if process is not None:
            self._former_cpu, self._process = self.cpu, None
            process.send_signal(number)
            process.wait(30)

    def said(self) -> str:
        """Return the last of what it said."""
        return self._log.read_text(errors="replace")[-4000:]

    def calls(self) -> Counter[str]:
        """Return the number of its calls of the API so far, by verb and resource."""
        return self._series("slamhive_api_calls_total", "verb", "resource")

    def reconciled(self) -> Counter[str]:
        """Return the number of its looks at objects so far, by kind."""
        return self._series("slamhive_reconcile_seconds_count", "kind")

    def queued(self) -> Counter[str]:
        """Return the number of objects that wait for a look or get one now, by state."""
        return self._series("slamhive_queue_depth", "state")

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
def operator(
    access: Cluster,
    where: str,
    pods: dict[str, Any],
    *,
    program: str = "slamhive.kube",
    kubeconfig: Path | None = None,
    **changes: Any,
) -> Iterator[OperatorProcess]:
    """Run an operator for a namespace as a process of its own.

    Args:
        access: the cluster.
        where: the namespace.
        pods: settings of all pods.
        program: module that is run.
        kubeconfig: how it reaches the cluster; default: as its administrator does.
        changes: further settings.
    """
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
        # Without -P the folder that it is started in would be a place of modules too.
        command = [sys.executable, "-P", "-m", program, "--settings", str(file)]
        command += ["--kubeconfig", str(kubeconfig or access.kubeconfig)]
        process = OperatorProcess(command, Path(folder) / "log", metrics, health)
        try:
            process.start()
            yield process
        except BaseException:
            sys.stderr.write(process.said())
            raise
        finally:
            process.end()


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
    """Return the fields that send pods to a pool of played nodes."""
    toleration = {"key": POOL, "operator": "Equal", "value": pool, "effect": "NoSchedule"}
    return {"nodeSelector": {POOL: pool}, "tolerations": [toleration]}
