# SPDX-License-Identifier: Apache-2.0
"""Snapshots of a machine before and after a cluster, to find what it left: ``python machine.py MODE NAME``.

Runs in a network and a mount namespace of its own, which stand for a machine on which nothing else happens.
MODE says how the cluster ends: `down`, `killed` (its first process, then `down`), `half` (killed while it
starts, then `down`), or `owner` (the process that asked for it dies, and nobody calls `down`).
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from testcluster import local
from testcluster.access import until
from testcluster.components import PAUSE_IMAGE
from testcluster.local import Local

_OWN = ("/run", "/opt", "/var/lib", "/var/log")
_CGROUPS = Path("/sys/fs/cgroup")
_SETTINGS = (
    *("vm/overcommit_memory", "vm/panic_on_oom", "kernel/panic", "kernel/panic_on_oops"),
    *("kernel/keys/root_maxkeys", "kernel/keys/root_maxbytes"),
    *("fs/inotify/max_user_instances", "fs/inotify/max_user_watches"),
    *("net/ipv4/ip_forward", "net/ipv4/conf/all/route_localnet", "net/netfilter/nf_conntrack_max"),
)
_RESTRICTED = {
    "allowPrivilegeEscalation": False,
    "capabilities": {"drop": ["ALL"]},
    "runAsNonRoot": True,
    "runAsUser": 65532,
    "seccompProfile": {"type": "RuntimeDefault"},
}
_POD = {
    "apiVersion": "v1",
    "kind": "Pod",
    "metadata": {"name": "x", "namespace": "default"},
    "spec": {
        "terminationGracePeriodSeconds": 1,
        "containers": [{"name": "x", "image": PAUSE_IMAGE, "securityContext": _RESTRICTED}],
    },
}


def _output(*command: str) -> list[str]:
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return sorted(re.sub(r"\[\d+:\d+\]", "", line) for line in text.splitlines() if line[:1] != "#")


def snapshot(folder: Path) -> dict[str, Any]:
    """Return the links, filters, mounts, control groups, processes, settings and files that there are."""
    processes = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            text = (path / "cmdline").read_text() + str((path / "cwd").readlink())
        except OSError:
            continue
        if str(folder) in text and path.name != str(os.getpid()):
            processes.append(text)
    settings = [path for name in _SETTINGS if (path := Path("/proc/sys") / name).exists()]
    return {
        "filters": _output("iptables-save") + _output("ip6tables-save"),
        "links": re.findall(r"^\d+: ([^:@]+)", "\n".join(_output("ip", "-o", "link")), re.MULTILINE),
        "addresses": _output("ip", "-brief", "address"),
        "routes": _output("ip", "route", "show", "table", "all"),
        "namespaces": _output("ip", "netns"),
        "mounts": sorted(Path("/proc/self/mounts").read_text().splitlines()),
        "cgroups": sorted(map(str, {*_CGROUPS.glob("slamhive*"), *_CGROUPS.glob("*/slamhive*")})),
        "processes": processes,
        "settings": {str(path): path.read_text().split() for path in settings},
        "files": sorted(str(path) for place in _OWN for path in Path(place).rglob("*")),
        "state": [str(folder)] if folder.exists() else [],
    }


def _up(name: str, *more: str) -> subprocess.Popen[bytes]:
    code = f"import os; from testcluster.local import Local; Local.named({name!r}).up({', '.join(more)})"
    return subprocess.Popen(
        [sys.executable, "-c", f"{code}; print('up', flush=True); import time; time.sleep(600)"],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
        stdout=subprocess.PIPE,
    )


def _run(cluster: Local) -> None:
    access = cluster.up()
    access.apply(_POD)
    access.kubectl("wait", "--for=condition=Ready", "pod/x", "--timeout=240s")


def play(mode: str, name: str) -> str:
    """Have a cluster and end it; return the name of its control groups."""
    cluster = Local.named(name)
    folder = cluster.instance.folder
    if mode == "half":
        process = _up(name)
        until(cluster.instance.containerd.exists, "containerd", 60, 0.02)
    elif mode == "owner":
        process = _up(name, "owner=os.pipe()[0]")
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
    else:
        _run(cluster)
    cgroup = cluster.instance.addresses().cgroup
    if mode in {"half", "owner"}:
        process.kill()
        process.communicate()
    if mode == "killed":
        for pid in local._processes(folder)["init"]:
            os.kill(pid, signal.SIGKILL)
    if mode == "owner":
        until(lambda: not folder.exists(), "the end", 240)
        until(lambda: not any(local._processes(folder).values()), "the end of its processes", 240)
        until(lambda: "slamhive" not in "".join(_output("ip", "-o", "link")), "its link's end", 240)
    else:
        cluster.down()
    # What a killed process had started goes with it, in its own time.
    until(lambda: not snapshot(folder)["processes"], "the end of helpers", 240)
    return cgroup


def main(mode: str, name: str) -> None:
    """Print what was there before and what is there after."""
    for place in _OWN:
        subprocess.run(["mount", "-t", "tmpfs", "machine", place], check=True)
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    folder = Local.named(name).instance.folder
    before = snapshot(folder)
    cgroup = play(mode, name)
    after = snapshot(folder)
    # Control groups and mounts of others come and go meanwhile, which is their business.
    after["mounts"] = [line for line in after["mounts"] if line not in before["mounts"]]
    after["cgroups"] = [path for path in after["cgroups"] if Path(path).name == cgroup]
    before |= {"mounts": [], "cgroups": []}
    sys.stdout.write(json.dumps({"before": before, "after": after}))


if __name__ == "__main__":
    main(*sys.argv[1:])
