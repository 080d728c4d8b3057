# SPDX-License-Identifier: Apache-2.0
"""Samples of what a large Sweep takes: objects, sizes, memory and CPU time over its course."""

from __future__ import annotations

import csv
import json
import time
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import httpx
import operating
from scaling.storing import open_engine
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError

from slamhive.archive import schema

if TYPE_CHECKING:
    from pathlib import Path

    from testcluster.access import Cluster

PLURALS = {
    "mappingruns": "/apis/slamhive.io/v1alpha1/namespaces/{}/mappingruns",
    "jobs": "/apis/batch/v1/namespaces/{}/jobs",
    "pods": "/api/v1/namespaces/{}/pods",
}
"""Kinds that are counted, each with its address in a namespace."""


@dataclass(frozen=True)
class Sample:
    """Measurements of a running Sweep at one moment: objects, sizes, memory and CPU time.

    Attributes:
        seconds: since the Sweep was made, without the time of the loops of Jobs.
        ended: runs that have ended, by the Sweep's status.
        running: runs in flight, by the same.
        mappingruns: objects there are.
        jobs: objects there are.
        pods: objects there are.
        status_bytes: size of the Sweep's status as JSON.
        queued: keys of the operator's queue that are ready to be looked at.
        delayed: keys of it that wait for a later time.
        archived: rows of runs in the archive.
        operator_mib: resident memory of the operator.
        operator_cpu: its CPU seconds so far.
        apiserver_cpu: CPU seconds of the API server so far.
        etcd_cpu: CPU seconds of etcd so far.
        etcd_mib: size of etcd's database.
        calls: calls of the operator to the API so far.
        looks: objects that it has looked at so far.
    """

    seconds: float
    ended: int
    running: int
    mappingruns: int
    jobs: int
    pods: int
    status_bytes: int
    queued: int
    delayed: int
    archived: int
    operator_mib: float
    operator_cpu: float
    apiserver_cpu: float
    etcd_cpu: float
    etcd_mib: float
    calls: int
    looks: int


class Sampler:
    """Takes samples.

    Args:
        access: the cluster.
        process: the operator.
        where: its namespace.
        url: its archive.
        folder: where ``samples.csv`` goes, each sample as it is taken: hours that break off leave theirs.
    """

    def __init__(
        self, access: Cluster, process: operating.OperatorProcess, where: str, url: str, folder: Path
    ) -> None:
        # A kubectl for each question would take a tenth of the machine from the Sweep, not from its peers.
        address, context = access.server()
        self._client = httpx.Client(base_url=address, verify=context, timeout=60)
        self._database = access.kubeconfig.parent / "etcd" / "member" / "snap" / "db"
        self._process = process
        self._where = where
        self._engine = open_engine(url)
        self.times = operating.ProgramTimes(access)
        self.taken: list[Sample] = []
        folder.mkdir(parents=True, exist_ok=True)
        self._file = (folder / "samples.csv").open("w", newline="", encoding="utf-8")
        self._table = csv.DictWriter(self._file, [field.name for field in fields(Sample)])
        self._table.writeheader()

    def close(self) -> None:
        """Let the API server, the archive and the file go."""
        self._client.close()
        self._engine.dispose()
        self._file.close()

    def raw(self, path: str) -> str | None:
        """Return the API server's answer, None where it gives none."""
        try:
            answer = self._client.get(path)
        except httpx.HTTPError:
            return None
        return answer.text if answer.is_success else None

    def sweep(self, name: str) -> dict[str, Any] | None:
        """Return a Sweep, None where the API server doesn't answer."""
        text = self.raw(f"/apis/slamhive.io/v1alpha1/namespaces/{self._where}/sweeps/{name}")
        return json.loads(text) if text else None

    def take(self, sweep: dict[str, Any], seconds: float) -> Sample | None:
        """Take a sample; None where a part doesn't answer now."""
        status = sweep.get("status") or {}
        try:
            counts = {plural: self._count(path) for plural, path in PLURALS.items()}
            queue, used = self._process.queued(), self.times.read()
            sample = Sample(
                seconds=round(seconds, 1),
                ended=(status.get("succeeded") or 0) + (status.get("failed") or 0),
                running=status.get("running") or 0,
                **counts,
                status_bytes=len(json.dumps(status, separators=(",", ":"))),
                queued=queue["ready"],
                delayed=queue["delayed"],
                archived=self._archived(sweep["metadata"]["uid"]),
                operator_mib=round(operating.memory_mib(self._process.pid, "Rss"), 1),
                operator_cpu=round(self._process.cpu, 2),
                apiserver_cpu=round(used["kube-apiserver"], 2),
                etcd_cpu=round(used["etcd"], 2),
                etcd_mib=round(self._database.stat().st_size / 2**20, 1),
                calls=self._process.calls().total(),
                looks=self._process.reconciled().total(),
            )
        except (OSError, LookupError, TypeError, ValueError, AttributeError, SQLAlchemyError):
            return None
        self.taken.append(sample)
        self._table.writerow(asdict(sample))
        self._file.flush()
        return sample

    def live(self, uid: str) -> list[dict[str, Any]]:
        """Return the runs of a Sweep that have objects."""
        items = json.loads(self.raw(PLURALS["mappingruns"].format(self._where)) or '{"items": []}')["items"]
        return [
            run
            for run in items
            if uid in {owner["uid"] for owner in run["metadata"].get("ownerReferences") or ()}
        ]

    def _count(self, path: str) -> int:
        listed = json.loads(self.raw(f"{path.format(self._where)}?limit=1") or "null")
        return len(listed["items"]) + int(listed["metadata"].get("remainingItemCount") or 0)

    def _archived(self, uid: str) -> int:
        query = select(func.count()).select_from(schema.runs).where(schema.runs.c.sweep_uid == uid)
        with self._engine.connect() as connection:
            return int(connection.execute(query).scalar_one())


class Clock:
    """Seconds since a beginning, which can be held."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._held = 0.0

    @property
    def seconds(self) -> float:
        """Return the seconds that count."""
        return time.monotonic() - self._began - self._held

    def leave_out(self, seconds: float) -> None:
        """Leave seconds out that have passed."""
        self._held += seconds


def write(samples: list[Sample], figures: dict[str, Any], folder: Path) -> None:
    """Write all figures as JSON."""
    text = json.dumps(figures | {"samples": [asdict(sample) for sample in samples]}, indent=1)
    (folder / "scale.json").write_text(text + "\n", encoding="utf-8")
