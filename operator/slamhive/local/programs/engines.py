# SPDX-License-Identifier: Apache-2.0
"""Container engines of this machine: podman and docker, by their commands.

A command on the PATH says little: docker's may have no daemon behind it, and podman may be installed without
being allowed to run anything. So the engine is asked, and what it can't do is a sentence that says what
helps.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from slamhive.local.programs.unavailable import Unavailable
from slamhive.model.base import Choice
from slamhive.model.errors import SystemFault
from slamhive.monitor.programs.engine import COMMAND_SECONDS, EngineError, last_line, run_engine

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_ASK_SECONDS = 60.0
_LINE_LIMIT = 400
_MEMORY_AND_CORES = ("cpuset", "memory", "pids")
_INSTALL = "apt-get install podman catatonit"
_NO_SUCH = re.compile(r"no (such )?container|does not exist", re.IGNORECASE)
_RANGE = "usermod --add-subuids 100000-165535 --add-subgids 100000-165535 NAME"
_HINTS = (
    ("newuidmap", f"a user without root needs the package uidmap and a range of ids: {_RANGE}"),
    ("user namespace", "the kernel lets no user without root make containers here: run slamhive as root"),
    ("cannot clone", "the kernel lets no user without root make containers here: run slamhive as root"),
    ("permission denied", "may this user use it? For docker: usermod -aG docker NAME, then log in again"),
    ("Cannot connect to the Docker daemon", "start it: systemctl start docker"),
    ("no such file or directory", "is its service running? systemctl start docker"),
)


class ContainerChoice(Choice):
    """Container engines that a user can choose for runs on a workstation, or none."""

    PODMAN = "podman"
    DOCKER = "docker"
    NONE = "none"


@dataclass(frozen=True)
class Engine:
    """A container engine that answers and can hold a container to its limits.

    Attributes:
        name: podman or docker.
        command: what its commands begin with.
        rootless: whether its containers are of a user without root.
    """

    name: str
    command: tuple[str, ...]
    rootless: bool = False

    @property
    def is_podman(self) -> bool:
        """Tell whether it is podman, which does some things that docker doesn't."""
        return self.name == ContainerChoice.PODMAN

    @property
    def removal(self) -> tuple[str, ...]:
        """Return the words that remove a container, running or not, before its id."""
        # podman keeps a container whose network another one shares; with --depend that one goes too.
        return ("rm", "--force", "--depend") if self.is_podman else ("rm", "--force")

    def call(self, *words: str, seconds: float = COMMAND_SECONDS, given: str = "") -> str:
        """Have it do something with what it is given to read, and return what it printed.

        Raises:
            EngineError: it doesn't; the message is the last line that it printed.
        """
        return run_engine([*self.command, *words], seconds, given)

    def follow(self, *words: str, tell: Callable[[str], None]) -> None:
        """Have it do something that may take long, each line that it prints being passed on.

        Raises:
            EngineError: it doesn't.
        """
        try:
            process = subprocess.Popen(
                [*self.command, *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                start_new_session=True,
            )
        except OSError as error:
            raise EngineError(error.strerror or str(error)) from None
        last = ""
        with process:
            try:
                for line in process.stdout or ():
                    if line.strip():
                        last = line.strip()[:_LINE_LIMIT]
                        tell(last)
            except BaseException:
                process.kill()
                raise
        if process.returncode != 0:
            raise EngineError(last_line(last))

    def remove(self, identity: str) -> None:
        """Remove a container, running or not; one that isn't there is no error.

        Raises:
            SystemFault: it can't be removed.
        """
        try:
            self.call(*self.removal, identity)
        except EngineError as error:
            if not _NO_SUCH.search(str(error)):
                raise SystemFault(f"{self.name}: a container can't be removed: {error}") from None

    def labelled(self, label: str) -> list[str]:
        """Return the ids of all containers with a label, running or not.

        Raises:
            EngineError: it doesn't say.
        """
        listed = self.call("ps", "--all", "--quiet", "--no-trunc", "--filter", f"label={label}")
        return listed.split()


def find_engine(wanted: ContainerChoice | None = None) -> Engine:
    """Return the engine to use: the one that is wanted, else the first that answers.

    Raises:
        Unavailable: there is none that can be used; the message says why and what helps.
    """
    if wanted is ContainerChoice.NONE:
        raise Unavailable("has a container image only, and containers are turned off (--container none)")
    names = [wanted] if wanted is not None else [ContainerChoice.PODMAN, ContainerChoice.DOCKER]
    problems = []
    for name in names:
        found = _asked(name.value, os.environ.get("PATH", ""))
        if isinstance(found, Engine):
            return found
        problems.append(found)
    known = [problem for problem in problems if problem is not None]
    if known:
        raise Unavailable(f"needs a container engine: {'; '.join(known)}")
    missing = " or ".join(name.value for name in names)
    raise Unavailable(f"needs a container engine, and {missing} isn't installed: {_INSTALL}")


def engine_named(name: str) -> Engine | None:
    """Return an engine by its name, None where it doesn't answer."""
    found = _asked(name, os.environ.get("PATH", ""))
    return found if isinstance(found, Engine) else None


@cache
def _asked(name: str, path: str) -> Engine | str | None:
    """Return an engine, why it can't be used, or None where it isn't installed; asked once a program."""
    if shutil.which(name, path=path) is None:
        return None
    try:
        if name == ContainerChoice.PODMAN:
            return _podman(json.loads(run_engine([name, "info", "--format", "json"], _ASK_SECONDS)))
        return _docker(json.loads(run_engine([name, "info", "--format", "{{json .}}"], _ASK_SECONDS)))
    except EngineError as error:
        return f"{name} is installed but can't be used: {error}{_hint(str(error))}"
    except (ValueError, TypeError, KeyError, AttributeError):
        return f"{name} is installed but doesn't say what it can do: {name} info"


def _podman(info: dict[str, Any]) -> Engine | str:
    host = info["host"]
    rootless = bool(host["security"]["rootless"])
    controllers = {str(one) for one in host.get("cgroupControllers") or ()}
    missing = [one for one in _MEMORY_AND_CORES if one not in controllers]
    if missing:
        return _no_control("podman", missing, rootless=rootless, version=str(host.get("cgroupVersion")))
    if host.get("serviceIsRemote"):
        return "podman runs its containers on another machine (a remote connection); it has to be this one"
    command: tuple[str, ...] = ("podman",)
    # crun refuses limits where version 2 of control groups is mounted beside version 1; runc doesn't.
    if host["ociRuntime"]["name"] == "crun" and host.get("cgroupVersion") == "v1":
        if shutil.which("runc") is None:
            return (
                "podman's runtime crun sets no limits with control groups of version 1: apt-get install runc"
            )
        command = ("podman", "--runtime", "runc")
    return Engine("podman", command, rootless)


def _docker(info: dict[str, Any]) -> Engine | str:
    if errors := info.get("ServerErrors"):
        return f"docker is installed but can't be used: {last_line(str(errors[0]))}{_hint(str(errors[0]))}"
    if "host" in info:  # podman's own command by the name of docker
        found = _podman(info)
        return replace(found, command=("docker", *found.command[1:])) if isinstance(found, Engine) else found
    rootless = any("rootless" in str(one) for one in info.get("SecurityOptions") or ())
    able = {"memory": info["MemoryLimit"], "cpuset": info["CPUSet"], "pids": info["PidsLimit"]}
    missing = [name for name, has in able.items() if not has]
    if missing:
        version = f"v{info.get('CgroupVersion') or 1}"
        return _no_control("docker", missing, rootless=rootless, version=version)
    return Engine("docker", ("docker",), rootless)


def _no_control(name: str, missing: Sequence[str], *, rootless: bool, version: str) -> str:
    what = f"{name} has no control of {', '.join(missing)} here"
    if rootless and version == "v1":
        return f"{what}: without root it takes control groups of version 2, or run slamhive as root"
    if rootless:
        return (
            f"{what}: have systemd delegate it (Delegate=cpu cpuset memory pids for user@.service), "
            "or run slamhive as root"
        )
    return f"{what}: the kernel must offer control groups with {', '.join(missing)}"


def _hint(problem: str) -> str:
    for words, hint in _HINTS:
        if words in problem:
            return f" ({hint})"
    return ""
