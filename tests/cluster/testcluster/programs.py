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
    "kueue": ("kueue", "sigs.k8s.io/kueue/cmd/kueue"),
}
"""Module folder and package of each program."""
BUILT_LATE = ("kueue",)
"""Programs of few tests, which build them where `make cluster-build` has not: minutes."""
_FILES = {"kueue": ("sigs.k8s.io/kueue", "config/components/crd/bases")}
"""Folders of modules that are kept beside a program."""
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


def files_of(program: str) -> Path:
    """Return the folder of what a program's module brings along."""
    return path_of(program).with_name(f"{program}.files")


def absent(programs: tuple[str, ...] | None = None) -> list[str]:
    """Return the programs that have not been built yet."""
    return [name for name in programs or tuple(PROGRAMS) if not path_of(name).exists()]


def absent_for_a_cluster() -> list[str]:
    """Return the programs that any cluster needs and that have not been built yet."""
    return absent(tuple(name for name in PROGRAMS if name not in BUILT_LATE))


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

    def run(*words: str) -> str:
        result = subprocess.run(
            words, cwd=MODULES / module, env=environment, capture_output=True, text=True, check=False
        )
        if result.returncode:
            raise ClusterError(f"building {name} failed: {result.stderr.strip()[-2000:]}")
        return result.stdout.strip()

    run(*command)
    if name in _FILES:
        origin, folder = _FILES[name]
        place = run(go, "list", "-m", "-f", "{{.Dir}}", origin)
        shutil.copytree(
            f"{place}/{folder}", files_of(name), dirs_exist_ok=True, copy_function=shutil.copyfile
        )
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
