# SPDX-License-Identifier: Apache-2.0
"""The cluster's programs, built from Go modules whose versions and checksums are pinned in modules/.

A program is kept under the digest of what it is built from, so another checkout with the same pins finds it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from testcluster.errors import ClusterError
from testcluster.places import MODULES, home, locked

if TYPE_CHECKING:
    from pathlib import Path

KUBERNETES = "v1.34.4"
PROGRAMS: dict[str, tuple[str, str]] = {
    "etcd": ("kubernetes", "go.etcd.io/etcd/server/v3"),
    **{
        name: ("kubernetes", f"k8s.io/kubernetes/cmd/{name}")
        for name in (
            "kube-apiserver",
            "kube-controller-manager",
            "kube-scheduler",
            "kubectl",
            "kubelet",
            "kube-proxy",
        )
    },
    "pause": ("pause", "."),
    "kwok": ("kwok", "sigs.k8s.io/kwok/cmd/kwok"),
    "metrics-server": ("metrics-server", "sigs.k8s.io/metrics-server/cmd/metrics-server"),
    "helm": ("helm", "helm.sh/helm/v3/cmd/helm"),
}
"""Module folder and package of each program."""
CONTROL_PLANE = ("etcd", "kube-apiserver", "kube-controller-manager", "kube-scheduler", "kubectl")
NODE = ("kubelet", "kube-proxy", "metrics-server", "pause")
_FLAGS = "-s -w" + "".join(
    f" -X k8s.io/component-base/version.git{name}={value}"
    for name, value in zip(
        ("Version", "Major", "Minor"), (KUBERNETES, *KUBERNETES[1:].split(".")), strict=False
    )
)


def _digest(module: str) -> str:
    found = hashlib.sha256(_FLAGS.encode())
    for path in sorted((MODULES / module).iterdir()):
        found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()[:12]


def path_of(program: str) -> Path:
    """Return the path of a program once it has been built."""
    module, _ = PROGRAMS[program]
    return home() / "programs" / f"{module}-{_digest(module)}" / program


def absent(programs: tuple[str, ...] | None = None) -> list[str]:
    """Return the programs that have not been built yet."""
    return [name for name in programs or tuple(PROGRAMS) if not path_of(name).exists()]


def build(programs: tuple[str, ...] | None = None) -> None:
    """Build what is absent, one process at a time; the others wait and find it done.

    Raises:
        ClusterError: Go is missing or a build failed.
    """
    if absent(programs):
        with locked("programs"):
            for name in absent(programs):
                _build(name)
    for name in programs or tuple(PROGRAMS):
        _link(name)


def _build(name: str) -> None:
    go = shutil.which("go")
    if go is None:
        raise ClusterError("no Go to build the test cluster with: install Go 1.21 or newer (go.dev/dl)")
    module, package = PROGRAMS[name]
    target = path_of(name)
    target.parent.mkdir(parents=True, exist_ok=True)
    sys.stderr.write(f"building {name} ... ")
    sys.stderr.flush()
    begun = time.monotonic()
    work = target.with_name(f".{name}")
    command = [go, "build", "-trimpath", "-ldflags", _FLAGS, "-o", str(work), package]
    environment = os.environ | {
        "CGO_ENABLED": "0",
        "GOFLAGS": "-mod=readonly -buildvcs=false",
        "GOWORK": "off",
    }
    result = subprocess.run(
        command, cwd=MODULES / module, env=environment, capture_output=True, text=True, check=False
    )
    if result.returncode:
        raise ClusterError(f"building {name} failed: {result.stderr.strip()[-2000:]}")
    work.replace(target)
    sys.stderr.write(f"{time.monotonic() - begun:.0f} s\n")


def _link(name: str) -> None:
    """Give people one folder for their PATH."""
    folder = home() / "bin"
    folder.mkdir(parents=True, exist_ok=True)
    link, target = folder / name, path_of(name)
    if not link.is_symlink() or link.readlink() != target:
        work = folder / f".{name}.{os.getpid()}"
        work.unlink(missing_ok=True)
        work.symlink_to(target)
        work.replace(link)
