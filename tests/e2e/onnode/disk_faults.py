# SPDX-License-Identifier: Apache-2.0
"""Faults of the disk in pods of a namespace: a RuntimeClass whose containers have writes that fail."""

from __future__ import annotations

import json
import shutil
import stat
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from onnode.documents import ROOT
from testcluster.local import Local

if TYPE_CHECKING:
    from collections.abc import Iterator

    from onnode.lab import Lab

sys.path.insert(0, str(ROOT / "tests" / "faults"))
from injecting import build_library, compiler

__all__ = ["Fault", "Faults", "compiler", "under_faults"]

CLASS = {
    "apiVersion": "node.k8s.io/v1",
    "kind": "RuntimeClass",
    "metadata": {"name": "disk-faults"},
    "handler": "changed",
}
PROGRAM = Path(__file__).with_name("changed_runc.py")
MOST = {"monitor": 40, "prepare": 60, "evaluate": 40}
"""About how many writes the containers make below /slamhive*, by their names."""


@dataclass(frozen=True)
class Fault:
    """A fault that was made.

    Attributes:
        container: name of the container.
        pod: name of its pod.
        call: name of the call that failed.
        path: of which file.
        how: an errno by its name, or ``short``.
    """

    container: str
    pod: str
    call: str
    path: str
    how: str


class Faults:
    """Faults to be made from now on.

    Args:
        folder: where the runtime finds its plan and leaves its notes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def plan(self, seed: int, share: float = 0.7) -> None:
        """Let a share of the containers that start from now on have a fault each."""
        plan = {"library": "shim.so", "seed": seed, "share": share, "most": MOST, "paths": "slamhive*"}
        (self._folder / "plan.json").write_text(json.dumps(plan))

    def end(self) -> None:
        """Make no more faults in new containers."""
        (self._folder / "plan.json").unlink(missing_ok=True)

    def made(self) -> list[Fault]:
        """Return the faults that were made, one a container."""
        found = []
        for file in sorted(self._folder.glob("*.log")):
            _, container, pod = file.stem.split("-", 2)
            for line in file.read_text(errors="replace").splitlines()[:1]:
                call, path, how, _ = line.split("\t")
                found.append(Fault(container, pod, call, path, how))
        return found


@contextmanager
def under_faults(lab: Lab) -> Iterator[Faults]:
    """Run the pods of a namespace on a runtime that can make faults, as long as the context lasts."""
    instance = Local.named(str(lab.cluster.instance)).instance
    folder = instance.folder / "faults"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    folder.chmod(0o755)
    build_library(folder / "shim.so")
    program = instance.changed_runtime
    program.write_text(f"#!{sys.executable} -I\n" + PROGRAM.read_text())
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    lab.cluster.apply(CLASS)
    upgrade = f"helm upgrade slamhive helm/slamhive --namespace {lab.namespace} --reuse-values --wait --set"
    lab.desk.run(f"{upgrade} runs.runtimeClassName={CLASS['metadata']['name']}")
    faults = Faults(folder)
    try:
        yield faults
    finally:
        faults.end()
        lab.desk.run(f"{upgrade} runs.runtimeClassName=")
        lab.cluster.kubectl("delete", "runtimeclass", CLASS["metadata"]["name"])
        shutil.rmtree(folder)
