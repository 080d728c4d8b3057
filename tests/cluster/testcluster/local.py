# SPDX-License-Identifier: Apache-2.0
"""A real Kubernetes of plain processes in namespaces of its own: one node, no Docker, no registry."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from testcluster import components, images, init, missing, pki
from testcluster.access import Cluster, until
from testcluster.errors import ClusterError
from testcluster.places import DEFAULT, INSTANCES, Addresses, Instance, home, locked
from testcluster.programs import CONTROL_PLANE, NODE, build, path_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

_PATH_LIMIT = 80
_TELL_ETCD = """
import sys, urllib.request
for line in sys.stdin:
    request = urllib.request.Request(f"http://127.0.0.1:2379/v3/{sys.argv[1]}", line.encode())
    urllib.request.build_opener(urllib.request.ProxyHandler({})).open(request).read()
"""


def _ip(*arguments: str) -> str:
    result = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if result.returncode:
        raise ClusterError(f"ip {' '.join(arguments)}: {result.stderr.strip()}")
    return result.stdout


def _processes(folder: Path) -> dict[str, list[int]]:
    """Return the ids of an instance's first processes, by the program that they are: unshare and python."""
    found: dict[str, list[int]] = {"unshare": [], "init": []}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = path.read_bytes().decode(errors="replace").split("\0")
            if str(folder) in words and any(word.endswith("testcluster/init.py") for word in words):
                kind = "unshare" if Path(words[0]).name == "unshare" else "init"
                found[kind].append(int(path.parent.name))
    return found


@dataclass(frozen=True)
class Local:
    """One local cluster, running or not."""

    instance: Instance

    @classmethod
    def named(cls, name: str = DEFAULT) -> Local:
        """Return the cluster of a name."""
        return cls(Instance(name))

    def ask(self, **request: Any) -> Any:
        """Ask the cluster's first process.

        Raises:
            ClusterError: there is none, or it could not do it.
        """
        try:
            descriptor, path = init.socket_path(self.instance.folder)
            try:
                with socket.socket(socket.AF_UNIX) as connection, connection.makefile("rw") as stream:
                    connection.settimeout(20)
                    connection.connect(path)
                    stream.write(json.dumps(request) + "\n")
                    stream.flush()
                    answer = json.loads(stream.readline())
            finally:
                os.close(descriptor)
        except (OSError, ValueError) as error:
            raise ClusterError(f"the cluster {self.instance.name} is not up ({error})") from None
        if "error" in answer:
            raise ClusterError(f"{request['do']} failed: {answer['error']}")
        return answer

    def alive(self) -> bool:
        """Tell whether the cluster's first process answers."""
        try:
            return bool(self.ask(do="state"))
        except ClusterError:
            return False

    def access(self) -> Cluster:
        """Return the running cluster as tests see it."""
        return Cluster(
            "local",
            self.instance.kubeconfig,
            str(path_of("kubectl")),
            lambda name: images.load_built(self.instance, name),
            self.instance.name,
        )

    def up(self, *, node: bool = True, owner: int | None = None) -> Cluster:
        """Start the cluster, or what is missing of a running one.

        Args:
            node: whether to have the node too, or the control plane alone.
            owner: a pipe's reading end; the cluster ends when the writing end closes.

        Raises:
            ClusterError: the machine lacks something, or a program didn't start.
        """
        if problems := missing.missing():
            raise ClusterError("\n".join(problems))
        build(CONTROL_PLANE + (NODE if node else ()))
        with locked("instances"):
            begun = self.alive()
            try:
                if not begun:
                    self._clear()
                    self._begin(owner)
                self._control_plane()
                if node:
                    self._node()
            except BaseException:
                if not begun:
                    self._clear()
                raise
        return self.access()

    def down(self) -> None:
        """End the cluster and leave nothing of it; also what a killed `up` or `down` left."""
        with locked("instances"):
            folder = self.instance.folder
            addresses = self.instance.addresses() if (folder / "number").exists() else None
            with contextlib.suppress(ClusterError):
                self.ask(do="end")
                until(lambda: not any(_processes(folder).values()), "the end", 30, 0.05)
            self._clear(addresses)

    def stop(self, component: str) -> None:
        """Kill one program, such as the kubelet or the API server, as a fault does."""
        self.ask(do="signal", name=component, number=int(signal.SIGKILL))
        until(lambda: component not in self.ask(do="state")["running"], f"the end of {component}", pause=0.02)

    def start(self, component: str) -> None:
        """Start one program again.

        Raises:
            ClusterError: it ended at once.
        """
        function = getattr(components, component.replace("-", "_"))
        environment = {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
        self.ask(do="start", name=component, command=function(self.instance), environment=environment)

    def tell_etcd(self, method: str, bodies: Iterable[dict[str, Any]]) -> None:
        """Call etcd itself, behind the API server's back.

        Args:
            method: path of its JSON gateway, such as ``kv/put``.
            bodies: what is sent, a call each.
        """
        lines = "\n".join(map(json.dumps, bodies))
        self._inside(sys.executable, "-c", _TELL_ETCD, method, text=lines)

    def _inside(self, *command: str, text: str = "") -> None:
        """Run a program in the cluster's network, with a text for it to read."""
        enter = ["nsenter", "--net", "--target", str(_processes(self.instance.folder)["init"][0])]
        subprocess.run([*enter, *command], input=text, text=True, check=True, capture_output=True)

    def _clear(self, addresses: Addresses | None = None) -> None:
        folder = self.instance.folder
        for pid in (pid for found in _processes(folder).values() for pid in found):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        until(lambda: not any(_processes(folder).values()), "the end of its processes", 30, 0.05)
        if addresses is None and (folder / "number").exists():
            addresses = self.instance.addresses()
        if addresses is not None:
            # The kernel takes its time to notice that a network is used no more.
            with contextlib.suppress(ClusterError):
                _ip("link", "delete", addresses.link)
            cgroup = addresses.cgroup
            until(lambda: not init.remove_cgroups(cgroup), "its control groups", 30, 0.05)
        shutil.rmtree(folder, ignore_errors=True)

    def _begin(self, owner: int | None) -> None:
        """Make the namespaces and the cable into them."""
        folder = self.instance.folder
        if len(str(folder)) > _PATH_LIMIT:
            raise ClusterError(
                f"{folder}: too long for the sockets in it; set SLAMHIVE_CLUSTER_HOME to a shorter path"
            )
        addresses = self._number()
        (folder / "log").mkdir()
        pki.make(self.instance)
        descriptors = () if owner is None else (owner,)
        with (folder / "log" / "init.log").open("wb") as log:
            subprocess.run(
                [
                    *("setsid", "--fork"),
                    *("unshare", "--net", "--mount", "--pid", "--fork", "--kill-child=KILL"),
                    *(sys.executable, str(Path(init.__file__).resolve()), str(folder), addresses.cgroup),
                    *map(str, descriptors),
                ],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=descriptors,
                cwd="/",
                check=True,
            )
        with self._explained("init"):
            until(self.alive, "the cluster's first process", 20, 0.02)
        self._connect(addresses)

    def _number(self) -> Addresses:
        taken = {path.read_text() for path in home().glob("run-*/number")}
        taken |= set(re.findall(r"slamhive(\d+)", _ip("-o", "link", "show")))
        free = [number for number in range(INSTANCES) if str(number) not in taken]
        if not free:
            raise ClusterError(f"{INSTANCES} clusters run on this machine already")
        self.instance.folder.mkdir(parents=True)
        (self.instance.folder / "number").write_text(str(free[0]))
        return Addresses(free[0])

    def _connect(self, addresses: Addresses) -> None:
        inside = str(_processes(self.instance.folder)["init"][0])
        _ip("link", "add", addresses.link, "type", "veth", "peer", "name", "node0", "netns", inside)
        _ip("address", "add", f"{addresses.machine}/30", "dev", addresses.link)
        _ip("link", "set", addresses.link, "up")
        for command in (
            ("address", "add", f"{addresses.node}/30", "dev", "node0"),
            ("link", "set", "node0", "up"),
            ("route", "add", addresses.services, "via", addresses.machine),
        ):
            self._inside("ip", *command)
        for network in (addresses.pods, addresses.services):
            _ip("route", "add", network, "via", addresses.node)

    def _control_plane(self) -> None:
        self._ensure("etcd")
        self._ensure("apiserver")
        access = self.access()
        self._wait("apiserver", lambda: access.run("get", "--raw", "/readyz").returncode == 0)
        self._ensure("controller-manager")
        self._ensure("scheduler")
        self._wait(
            "controller-manager", lambda: access.run("get", "serviceaccount", "default").returncode == 0
        )

    def _node(self) -> None:
        instance, access = self.instance, self.access()
        if self._ensure("containerd"):
            command = ["ctr", "-a", str(instance.containerd), "version"]
            self._wait(
                "containerd",
                lambda: subprocess.run(command, capture_output=True, check=False).returncode == 0,
            )
            images.load(instance, images.pause())
        self._ensure("kubelet")
        self._ensure("proxy")
        if self._ensure("metrics-server"):
            access.apply(*components.metrics_objects(instance))
        self._wait("kubelet", lambda: _ready(access))

    def _ensure(self, component: str) -> bool:
        if component in self.ask(do="state")["running"]:
            return False
        self.start(component)
        return True

    def _wait(self, component: str, condition: Callable[[], bool]) -> None:
        """Wait for a program to be of use; where it never is, the end of its log says why."""

        def useful() -> bool:
            if component in self.ask(do="state")["ended"]:
                raise ClusterError(f"{component} ended")
            return condition()

        with self._explained(component):
            until(useful, component, 120, 0.1)

    @contextlib.contextmanager
    def _explained(self, component: str) -> Iterator[None]:
        """Add the last lines of a program's log to an error."""
        try:
            yield
        except ClusterError as error:
            log = self.instance.folder / "log" / f"{component}.log"
            tail = "\n".join(log.read_text(errors="replace").splitlines()[-8:]) if log.exists() else ""
            raise ClusterError(f"{error}; the end of {log}:\n{tail}") from None


def _ready(access: Cluster) -> bool:
    path = "jsonpath={.status.conditions[?(@.type=='Ready')].status}"
    return access.run("get", "node", pki.NODE, "-o", path).stdout == "True"
