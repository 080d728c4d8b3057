# SPDX-License-Identifier: Apache-2.0
"""Cluster as an executor: a Sweep applied with kubectl, its runs fetched by `slamhive fetch`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from executors.process import TINY

from slamhive.local.home.folder import Home

if TYPE_CHECKING:
    from collections.abc import Mapping

    from onnode.lab import Lab

SECONDS = 900.0
TOGETHER = 5


def in_image(image: str, text: str) -> dict[str, Any]:
    """Return the fields of an Algorithm's spec that say how Python text is run in an image with python3."""
    # A word of a command has at most 4 KiB.
    parts = [text[begin : begin + 4000] for begin in range(0, len(text), 4000)]
    join = "import sys; exec(''.join(sys.argv[1:]))"
    return {"image": image, "command": ["python3", "-ISc", join, *parts]}


class OnCluster:
    """Runs sweeps in a namespace in which SLAM Hive is installed.

    Args:
        lab: the namespace.
        home: where the runs are fetched to.
        image: one that has python3, which ours has.
    """

    name = "cluster"

    def __init__(self, lab: Lab, home: Path, image: str = "slamhive/slamhive:0.1.0") -> None:
        self._lab = lab
        self._home = home
        self._image = image

    def program(self, text: str) -> dict[str, Any]:
        return in_image(self._image, text)

    def delete(self, *objects: Mapping[str, Any]) -> None:
        """Delete what was made for these objects, the last one first, and the dataset."""
        for item in (*objects[::-1], yaml.safe_load(TINY.read_text())):
            name = f"{item['kind'].lower()}s.slamhive.io/{item['metadata']['name']}"
            self._lab.kubectl("delete", name, "--ignore-not-found", timeout=SECONDS)

    def run(self, algorithm: Mapping[str, Any], sweep: Mapping[str, Any]) -> str:
        name, lab = sweep["metadata"]["name"], self._lab
        lab.apply(yaml.safe_load(TINY.read_text()), dict(algorithm))
        lab.apply({**sweep, "spec": {**sweep["spec"], "parallelism": TOGETHER}})
        lab.completed(name, SECONDS)
        home = {"SLAMHIVE_HOME": str(self._home)}
        subprocess.run(
            [Path(sys.executable).with_name("slamhive"), "fetch", name, "--namespace", lab.namespace],
            env={name: value for name, value in lab.cluster.environment.items() if name != "SLAMHIVE_ARCHIVE"}
            | home,
            stdout=2,  # what show.py prints is the table alone
            check=True,
            timeout=300,
        )
        return Home.at(self._home).archive_url

    def faults(self, sweep: str) -> dict[str, int]:
        found = {run["spec"]["parameters"]["behaviour"]: run["status"] for run in self._lab.runs(sweep)}
        return {name: status["faults"] for name, status in found.items() if status.get("faults")}
