# SPDX-License-Identifier: Apache-2.0
"""Paths and addresses of the test cluster: its programs, its state, and the networks of an instance."""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

MODULES = Path(__file__).resolve().parents[1] / "modules"
DEFAULT = "default"
INSTANCES = 60
"""Number of instances that the address range has room for."""


def home() -> Path:
    """Return the folder of everything: programs by version, and one folder for each instance."""
    fallback = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "slamhive-cluster"
    return Path(os.environ.get("SLAMHIVE_CLUSTER_HOME") or fallback).absolute()


@dataclass(frozen=True)
class Addresses:
    """Addresses of an instance within 198.18.0.0/16, a range set aside for tests of networks (RFC 2544)."""

    number: int

    @property
    def link(self) -> str:
        """The machine's end of the cable into the cluster's network namespace."""
        return f"slamhive{self.number}"

    @property
    def machine(self) -> str:
        """The machine's own address on that cable."""
        return f"198.18.{self.number}.1"

    @property
    def node(self) -> str:
        """Address of the API server and of the node."""
        return f"198.18.{self.number}.2"

    @property
    def pods(self) -> str:
        """Addresses of pods."""
        return f"198.18.{64 + self.number}.0/24"

    @property
    def services(self) -> str:
        """Addresses of Services."""
        return f"198.18.{128 + self.number}.0/24"

    @property
    def first_service(self) -> str:
        """Address of the Service `kubernetes`."""
        return f"198.18.{128 + self.number}.1"

    @property
    def cgroup(self) -> str:
        """Control group under which the kubelet makes those of pods."""
        return f"slamhive{self.number}"


@dataclass(frozen=True)
class Instance:
    """One cluster on this machine, by name."""

    name: str

    @property
    def folder(self) -> Path:
        """Everything that the instance writes."""
        return home() / f"run-{self.name}"

    @property
    def kubeconfig(self) -> Path:
        """The administrator's kubeconfig."""
        return self.folder / "admin.kubeconfig"

    @property
    def pki(self) -> Path:
        """Certificates and keys."""
        return self.folder / "pki"

    @property
    def containerd(self) -> Path:
        """Socket of the node's containerd."""
        return self.folder / "containerd.sock"

    @property
    def changed_runtime(self) -> Path:
        """Path where a test may put a program that changes containers of the runtime ``changed``."""
        return self.folder / "changed-runc"

    def addresses(self) -> Addresses:
        """Return the addresses that the instance took when it began."""
        return Addresses(int((self.folder / "number").read_text()))


@contextmanager
def locked(name: str) -> Iterator[None]:
    """Hold a lock of the folder; another process that wants it waits."""
    home().mkdir(parents=True, exist_ok=True)
    with (home() / f"{name}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
