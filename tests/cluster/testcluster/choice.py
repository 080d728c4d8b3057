# SPDX-License-Identifier: Apache-2.0
"""Choice of the tests' cluster: the one that SLAMHIVE_TEST_CLUSTER names, or what the machine offers."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from testcluster import kind, missing, programs
from testcluster.access import Cluster
from testcluster.errors import ClusterError
from testcluster.local import Local

if TYPE_CHECKING:
    from collections.abc import Mapping

VARIABLE = "SLAMHIVE_TEST_CLUSTER"
MODES = ("none", "local", "kind", "current")


@dataclass(frozen=True)
class Choice:
    """A mode, whether somebody asked for it, and why it can't be had."""

    mode: str
    asked: bool
    problems: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Say in one line which cluster tests use, and how to have one."""
        if not self.problems:
            return (
                "tests run without a cluster"
                if self.mode == "none"
                else f"tests run on a {self.mode} cluster"
            )
        return "no test cluster: " + "; ".join(self.problems)


def asked(environment: Mapping[str, str] = os.environ) -> str:
    """Return the mode that somebody asked for, empty when nobody did.

    Raises:
        ClusterError: there is no such mode.
    """
    mode = environment.get(VARIABLE, "")
    if mode and mode not in MODES:
        raise ClusterError(f"{VARIABLE}={mode}: expected one of {', '.join(MODES)}")
    return mode


def choose(environment: Mapping[str, str] = os.environ, *, building: bool = False) -> Choice:
    """Choose a mode; an explicit one is kept, with what it lacks.

    Args:
        environment: where the variable is looked up.
        building: whether programs that have not been built are about to be.
    """
    mode = asked(environment)
    if mode:
        return Choice(mode, asked=True, problems=_problems(mode, building=building))
    local = _problems("local", building=building)
    if not local:
        return Choice("local", asked=False)
    if not _problems("kind", building=building):
        return Choice("kind", asked=False)
    return Choice("none", asked=False, problems=local)


def _problems(mode: str, *, building: bool) -> tuple[str, ...]:
    match mode:
        case "local":
            found = missing.missing()
            absent = programs.absent_for_a_cluster()
            if not found and absent and not building:
                found = [f"its programs are not built ({', '.join(absent)}): make cluster-build"]
            return tuple(found)
        case "kind":
            return tuple(kind.missing())
        case "current":
            return () if shutil.which("kubectl") else ("it needs kubectl on the PATH",)
    return ()


@dataclass(frozen=True)
class Current:
    """Somebody's cluster, which is used only when asked for and is neither started nor ended."""

    def alive(self) -> bool:
        """Tell whether it answers."""
        return self.access().run("get", "--raw", "/readyz").returncode == 0

    def access(self) -> Cluster:
        """Return the cluster of the KUBECONFIG."""
        default = Path.home() / ".kube" / "config"
        kubeconfig = Path(os.environ.get("KUBECONFIG") or default)
        return Cluster("current", kubeconfig, shutil.which("kubectl") or "kubectl", _refuse)

    def up(self, *, node: bool = True, owner: int | None = None) -> Cluster:
        """Insist that it answers."""
        del node, owner
        if not self.alive():
            raise ClusterError(f"the cluster of {self.access().kubeconfig} does not answer")
        return self.access()

    def down(self) -> None:
        """Leave it alone."""


def _refuse(name: str) -> None:
    raise ClusterError(f"cannot load {name} into somebody's cluster: push it to a registry that it reads")


def cluster(name: str, environment: Mapping[str, str] = os.environ) -> Local | kind.Kind | Current:
    """Return the cluster of the chosen mode.

    Raises:
        ClusterError: there is none on this machine.
    """
    chosen = choose(environment, building=True)
    match chosen.mode:
        case "local":
            return Local.named(name)
        case "kind":
            return kind.Kind(name)
        case "current":
            return Current()
    raise ClusterError(chosen.sentence())
