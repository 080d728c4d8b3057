# SPDX-License-Identifier: Apache-2.0
"""Programs and rights that a machine lacks for a cluster of its own, and how to get each: a line for each."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from testcluster.errors import ClusterError
from testcluster.programs import absent

_OLDEST_GO = (1, 21)
_NEEDED = {
    "containerd": "containerd",
    "ctr": "containerd",
    "runc": "runc",
    "iptables": "iptables",
    "ip": "iproute2",
    "openssl": "openssl",
    "unshare": "util-linux",
    "setpriv": "util-linux",
}
"""Debian's package of each program."""
_PLUGINS = Path("/usr/lib/cni")
_PLUGIN_PACKAGE = "containernetworking-plugins"


def packages() -> list[str]:
    """Return the Debian packages that are not there."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    found = {package for program, package in _NEEDED.items() if not shutil.which(program, path=path)}
    if not all((_PLUGINS / name).exists() for name in ("bridge", "host-local", "portmap")):
        found.add(_PLUGIN_PACKAGE)
    return sorted(found)


def install() -> None:
    """Install the packages, where this is root on Debian.

    Raises:
        ClusterError: apt failed.
    """
    wanted = packages()
    if not wanted or os.geteuid() != 0 or not shutil.which("apt-get"):
        return
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
    for command in (
        ["apt-get", "update", "-q"],
        ["apt-get", "install", "-y", "-q", "--no-install-recommends", *wanted],
    ):
        result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if result.returncode:
            raise ClusterError(f"could not install {' '.join(wanted)}: {result.stderr.strip()[-500:]}")


def missing() -> list[str]:
    """Return a sentence for each thing that a cluster of processes lacks here."""
    if not sys.platform.startswith("linux"):
        return ["the local test cluster needs Linux"]
    found = []
    if os.geteuid() != 0:
        found.append("it needs root: sudo make test-cluster")
    if absent() and (problem := _problem_of_go()):
        found.append(problem)
    if wanted := packages():
        found.append(f"it needs Debian's packages: apt-get install {' '.join(wanted)}")
    if not found and (problem := _problem_of_namespaces()):
        found.append(problem)
    return found


def _problem_of_go() -> str | None:
    go = shutil.which("go")
    if go is None:
        return "it needs Go 1.21 or newer on the PATH: go.dev/dl"
    text = subprocess.run([go, "version"], capture_output=True, text=True, check=False).stdout
    found = re.search(r"go(\d+)\.(\d+)", text)
    if not found or (int(found[1]), int(found[2])) < _OLDEST_GO:
        return f"it needs Go 1.21 or newer, found {found[0] if found else 'none'}: go.dev/dl"
    return None


def _problem_of_namespaces() -> str | None:
    command = [
        "unshare",
        "--net",
        "--mount",
        "--pid",
        "--fork",
        "ip",
        "link",
        "add",
        "probe0",
        "type",
        "bridge",
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        why = (result.stderr.strip().splitlines() or ["it failed"])[-1]
        return f"it needs network and mount namespaces, which this machine refuses ({why})"
    return None
