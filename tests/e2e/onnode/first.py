# SPDX-License-Identifier: Apache-2.0
"""The sweep of docs/kubernetes.md: on the cluster, under Prometheus' eyes, and by `slamhive run`."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from onnode import documents
from onnode.documents import ROOT
from onnode.lab import OPERATOR, Lab, manifest, stand_in
from onnode.prometheus import scraping
from testcluster.access import until

if TYPE_CHECKING:
    from onnode.prometheus import Series

NAME = "first"
LONG = "long"
GAUGES = ("slamhive_run_cpu_cores", "slamhive_run_memory_bytes")


@dataclass
class First:
    """Results of the first sweep of docs/kubernetes.md, on the cluster and by `slamhive run`.

    Attributes:
        told: what the document's commands printed.
        status: the Sweep's status.
        runs: its runs in the order of its points.
        long: a run on a fortieth of a core, which takes longer than a minute.
        local: rows of the same sweep by `slamhive run`.
        gauges: what Prometheus saw of each live gauge; empty without Prometheus.
        before: the operator's series before the begin.
        metrics: the same after the end.
        anew: how the operator ended that was started anew meanwhile; empty where it went on.
    """

    told: str
    status: dict[str, Any]
    runs: list[dict[str, Any]]
    long: dict[str, Any]
    local: list[dict[str, Any]]
    gauges: dict[str, list[Series]] = field(default_factory=dict)
    before: str = ""
    metrics: str = ""
    anew: str = ""


def follow(lab: Lab, folder: Path) -> First:
    """Do what the document says, and the same on this machine at the same time."""
    section = documents.sections("kubernetes.md")["The first sweep"]
    for name, text in documents.files(section).items():
        (lab.desk.folder / name).write_text(text)
    commands = documents.scripts(section)[0]
    local, before, starts = Here(folder, lab.desk.folder / "sweep.yaml"), metrics(lab), operators(lab)
    with ExitStack() as stack:
        prometheus = None
        if shutil.which("prometheus"):
            prometheus = stack.enter_context(scraping(lab.cluster, lab.namespace, folder / "prometheus"))
        lab.apply(long_sweep(lab))
        local.begin()
        told = lab.desk.run(commands, timeout=1800)
        rows = local.end()
        lab.completed(LONG, 1200)
        for name, count in ((NAME, len(rows)), (LONG, 1)):
            until(lambda name=name, count=count: _evaluated(lab, name) == count, f"results of {name}", 240)
        found = First(
            told,
            status=lab.get("sweep", NAME)["status"],
            runs=lab.runs(NAME),
            long=lab.runs(LONG)[0],
            local=rows,
            before=before,
            metrics=metrics(lab),
            anew="" if operators(lab) == starts else endings(lab),
        )
        if prometheus is not None:
            found.gauges = {name: prometheus.samples(name) for name in GAUGES}
    return found


def long_sweep(lab: Lab) -> dict[str, Any]:
    """Return a Sweep of one run that takes longer than a minute."""
    slow = {"resources": {"cpu": "25m", "memory": "512Mi"}, "input": {"frameRate": 10}, "timeout": "20m"}
    template = {"spec": lab.run(LONG, "kiss-icp", **slow)["spec"]}
    return manifest(
        "Sweep", LONG, template=template, matrix=[{"path": "parameters.maxRange", "values": [30]}]
    )


def metrics(lab: Lab) -> str:
    """Return the operator's series as it shows them now."""
    service = f"/api/v1/namespaces/{lab.namespace}/services/slamhive-metrics:metrics/proxy/metrics"
    return lab.kubectl("get", "--raw", service)


def operators(lab: Lab) -> dict[str, int]:
    """Return the number of times that the operator was started anew, by the uid of its pod."""
    pods = lab.get("pods", *OPERATOR)["items"]
    return {pod["metadata"]["uid"]: pod["status"]["containerStatuses"][0]["restartCount"] for pod in pods}


def endings(lab: Lab) -> str:
    """Return the last ends of the operator's containers, and the warnings about its pods."""
    pods = lab.get("pods", *OPERATOR)["items"]
    last = [pod["status"]["containerStatuses"][0]["lastState"] for pod in pods]
    events = lab.get("events", "--field-selector", "type=Warning,involvedObject.kind=Pod")["items"]
    told = [one["message"] for one in events if one["involvedObject"]["name"].startswith("slamhive-operator")]
    return json.dumps([last, told])


def _evaluated(lab: Lab, sweep: str) -> int:
    return int(lab.get("sweep", sweep)["status"].get("evaluated") or 0)


class Here:
    """The same sweep by `slamhive run`, in a home whose environments outlive the session.

    Args:
        folder: where the home is made.
        sweep: the Sweep's file.
    """

    def __init__(self, folder: Path, sweep: Path) -> None:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
        environments = cache / "slamhive-tests" / "environments"
        environments.mkdir(parents=True, exist_ok=True)
        self._home = folder / "home"
        (self._home / "datasets").mkdir(parents=True)
        (self._home / "environments").symlink_to(environments)
        dataset = self._home / "datasets" / "synthetic-lidar" / "dataset.yaml"
        dataset.parent.mkdir()
        dataset.write_text(yaml.safe_dump(stand_in()))
        self._sweep = sweep
        self._done: subprocess.CompletedProcess[str] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def begin(self) -> None:
        """Begin it in the background."""
        self._thread.start()

    def end(self) -> list[dict[str, Any]]:
        """Wait for its end and return its rows."""
        self._thread.join()
        assert self._done is not None
        assert self._done.returncode == 0, self._done.stdout + self._done.stderr
        exported = self._slamhive("results", "export", "--sweep", NAME, "--format", "json")
        rows: list[dict[str, Any]] = json.loads(exported.stdout)
        return rows

    def _run(self) -> None:
        self._done = self._slamhive("run", str(self._sweep))

    def _slamhive(self, *words: str) -> subprocess.CompletedProcess[str]:
        variables = {name: value for name, value in os.environ.items() if not name.startswith("SLAMHIVE_")}
        return subprocess.run(
            [str(Path(sys.executable).with_name("slamhive")), *words],
            env=variables | {"SLAMHIVE_HOME": str(self._home)},
            capture_output=True,
            text=True,
            check=False,
            timeout=1800,
            cwd=ROOT,
        )
