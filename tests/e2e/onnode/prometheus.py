# SPDX-License-Identifier: Apache-2.0
"""Debian's Prometheus as a process that scrapes the operator's metrics through kubectl's proxy."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import urllib.parse
import urllib.request
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import yaml
from testcluster.access import until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from testcluster.access import Cluster

Series = tuple[dict[str, str], list[tuple[float, float]]]


class Prometheus:
    """A running Prometheus.

    Args:
        port: where it listens on this machine.
    """

    def __init__(self, port: int) -> None:
        self._address = f"http://127.0.0.1:{port}"

    def ask(self, path: str, **parameters: Any) -> Any:
        """Return the answer of its HTTP API."""
        address = f"{self._address}/api/v1/{path}?{urllib.parse.urlencode(parameters)}"
        with urllib.request.urlopen(address, timeout=10) as answer:  # noqa: S310 - our own process
            return json.load(answer)["data"]

    def is_scraping(self) -> bool:
        """Tell whether it gets the operator's metrics."""
        try:
            return any(target["health"] == "up" for target in self.ask("targets")["activeTargets"])
        except OSError:
            return False

    def samples(self, selector: str, hours: int = 2) -> list[Series]:
        """Return labels and (time in s, value) of all that was scraped of some series."""
        result = self.ask("query", query=f"{selector}[{hours}h]")["result"]
        return [(one["metric"], [(t, float(v)) for t, v in one["values"]]) for one in result]


@contextmanager
def scraping(cluster: Cluster, namespace: str, folder: Path) -> Iterator[Prometheus]:
    """Have the operator of a namespace scraped every 2 s."""
    program = shutil.which("prometheus")
    assert program is not None
    service = f"/api/v1/namespaces/{namespace}/services/slamhive-metrics:metrics/proxy/metrics"
    command = [cluster.kubectl_path, "proxy", "--port=0", f"--accept-paths=^{service}$"]
    with subprocess.Popen(command, env=cluster.environment, stdout=subprocess.PIPE, text=True) as proxy:
        try:
            assert proxy.stdout is not None
            address = re.findall(r"127\.0\.0\.1:\d+", proxy.stdout.readline())[0]
            job = {
                "job_name": "slamhive",
                "metrics_path": service,
                "static_configs": [{"targets": [address]}],
                "honor_labels": True,
            }
            folder.mkdir(parents=True)
            (folder / "prometheus.yml").write_text(
                yaml.safe_dump(
                    {"global": {"scrape_interval": "2s", "scrape_timeout": "2s"}, "scrape_configs": [job]}
                )
            )
            with _prometheus(program, folder) as found:
                yield found
        finally:
            proxy.terminate()


@contextmanager
def _prometheus(program: str, folder: Path) -> Iterator[Prometheus]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [
        program,
        f"--config.file={folder / 'prometheus.yml'}",
        f"--storage.tsdb.path={folder / 'data'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]
    with (folder / "log").open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as process:
        try:
            found = Prometheus(port)
            until(found.is_scraping, "Prometheus to scrape the operator")
            yield found
        finally:
            process.terminate()
