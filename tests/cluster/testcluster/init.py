# SPDX-License-Identifier: Apache-2.0
"""The first process of a cluster's own namespaces: it starts the programs, reaps them, and takes all away.

``python init.py FOLDER CGROUP [FD]`` runs under ``unshare --net --mount --pid``. Links, packet filters,
mounts and processes live in these namespaces and vanish with them, however the end comes; only control groups
and the folder itself are the machine's, and are removed at the end. Requests come as a line of JSON over
FOLDER/control. Where FD is given, the cluster ends when its other end closes: a test session that is killed
leaves none behind.

Standard library only: nothing else is there in a process that was started this way.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

TUNABLES = {
    "vm/overcommit_memory": "1",
    "vm/panic_on_oom": "0",
    "kernel/panic": "10",
    "kernel/panic_on_oops": "1",
    "kernel/keys/root_maxkeys": "1000000",
    "kernel/keys/root_maxbytes": "25000000",
}
"""Settings of the kernel that a kubelet wants for a whole machine; it is shown these and changes nothing."""
_HIDDEN = ("/run", "/var")
_CONTROL = "control"
_PATIENCE = 20.0


def socket_path(folder: Path) -> tuple[int, str]:
    """Return a descriptor of the folder and a short path of the socket in it, as such paths have a limit."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    return descriptor, f"/proc/self/fd/{descriptor}/{_CONTROL}"


def remove_cgroups(name: str) -> list[str]:
    """Remove a control group and those below it, of every hierarchy; return those that stay."""
    left = []
    for line in Path("/proc/self/mountinfo").read_text().splitlines():
        before, _, after = line.partition(" - ")
        if after.split()[0] not in {"cgroup", "cgroup2"}:
            continue
        top = Path(before.split()[4]) / name
        for folder, _, _ in os.walk(top, topdown=False):
            with contextlib.suppress(FileNotFoundError):
                try:
                    Path(folder).rmdir()
                except OSError:
                    left.append(folder)
    return left


def make_cgroups(name: str) -> None:
    """Make a control group in every hierarchy; the kubelet asks for all of them."""
    for line in Path("/proc/self/mountinfo").read_text().splitlines():
        before, _, after = line.partition(" - ")
        if after.split()[0] in {"cgroup", "cgroup2"}:
            with contextlib.suppress(OSError):
                (Path(before.split()[4]) / name).mkdir(exist_ok=True)


class Init:
    """The programs of one cluster by name."""

    def __init__(self, folder: Path, cgroup: str, owner: int | None) -> None:
        self.folder = folder
        self.cgroup = cgroup
        self.owner = owner
        self.running: dict[str, int] = {}
        self.ended: dict[str, int] = {}
        self.ending = False

    def prepare(self) -> None:
        """Make the namespaces' own view of the machine."""
        run("mount", "-t", "proc", "proc", "/proc")
        for place, value in TUNABLES.items():
            shown = self.folder / "kernel" / place.replace("/", ".")
            shown.parent.mkdir(exist_ok=True)
            shown.write_text(value + "\n")
            if Path("/proc/sys", place).exists():
                run("mount", "--bind", str(shown), f"/proc/sys/{place}")
        kept = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY)
        for place in _HIDDEN:
            run("mount", "-t", "tmpfs", "-o", "mode=755", "slamhive", place)
        for place in ("/var/lib", "/var/log", "/var/tmp", "/run/netns"):
            Path(place).mkdir()
        if not self.folder.exists():
            self.folder.mkdir(parents=True)
            run("mount", "--bind", f"/proc/self/fd/{kept}", str(self.folder), keep=kept)
        os.close(kept)
        run("mount", "--make-rshared", "/")
        run("ip", "link", "set", "lo", "up")
        Path("/proc/sys/net/ipv4/ip_forward").write_text("1\n")
        make_cgroups(self.cgroup)

    def serve(self) -> None:
        """Answer requests until the end."""
        wake, waker = os.pipe()
        for end in (wake, waker):
            os.set_blocking(end, False)
        signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGTERM, lambda *_: setattr(self, "ending", True))
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        descriptor, path = socket_path(self.folder)
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(path)
            listener.listen()
            os.close(descriptor)
            watched = [listener.fileno(), wake, *([] if self.owner is None else [self.owner])]
            while not self.ending:
                ready = select.select(watched, [], [])[0]
                if wake in ready:
                    with contextlib.suppress(BlockingIOError):
                        os.read(wake, 4096)
                self.reap()
                if self.owner in ready and not os.read(self.owner or 0, 4096):
                    self.ending = True
                elif listener.fileno() in ready:
                    self.answer(listener.accept()[0])

    def reap(self) -> None:
        """Take leave of processes that ended, ours and those left to us."""
        with contextlib.suppress(ChildProcessError):
            while (found := os.waitpid(-1, os.WNOHANG))[0]:
                for name, pid in [*self.running.items()]:
                    if pid == found[0]:
                        del self.running[name]
                        self.ended[name] = os.waitstatus_to_exitcode(found[1])

    def answer(self, connection: socket.socket) -> None:
        """Do what one request asks."""
        with connection, connection.makefile("rw") as stream:
            connection.settimeout(5)
            try:
                request = json.loads(stream.readline())
                result = getattr(self, f"on_{request.pop('do')}")(**request)
            except Exception as error:  # noqa: BLE001 - the first process must not die of a request
                result = {"error": repr(error)}
            with contextlib.suppress(OSError):
                stream.write(json.dumps(result) + "\n")
                stream.flush()

    def on_state(self) -> dict[str, dict[str, int]]:
        """Say what runs and what ended, with process ids of this namespace and exit codes."""
        return {"running": self.running, "ended": self.ended}

    def on_start(self, name: str, command: list[str], environment: dict[str, str]) -> dict[str, int]:
        """Start a program, its output in log/NAME.log."""
        pid = os.fork()
        if pid == 0:
            try:
                os.setsid()
                log = os.open(
                    self.folder / "log" / f"{name}.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644
                )
                for target, source in ((0, os.open(os.devnull, os.O_RDONLY)), (1, log), (2, log)):
                    os.dup2(source, target)
                os.closerange(3, 4096)
                signal.set_wakeup_fd(-1)
                for number in (signal.SIGCHLD, signal.SIGTERM, signal.SIGINT):
                    signal.signal(number, signal.SIG_DFL)
                os.chdir(self.folder)
                os.execvpe(command[0], command, os.environ | environment)  # noqa: S606 - no shell is meant
            finally:
                os._exit(127)
        self.ended.pop(name, None)
        self.running[name] = pid
        return {"pid": pid}

    def on_signal(self, name: str, number: int) -> dict[str, int]:
        """Send a signal to a program."""
        pid = self.running[name]
        os.kill(pid, number)
        return {"pid": pid}

    def on_end(self) -> dict[str, int]:
        """Take all away."""
        self.ending = True
        return {}

    def end(self) -> None:
        """End every process, then remove control groups and files."""
        signal.set_wakeup_fd(-1)
        deadline = time.monotonic() + _PATIENCE
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            while True:
                os.kill(-1, signal.SIGKILL)
                os.waitpid(-1, 0)
        while remove_cgroups(self.cgroup) and time.monotonic() < deadline:
            time.sleep(0.05)
        for line in reversed(Path("/proc/self/mounts").read_text().splitlines()):
            place = line.split()[1]
            if place.startswith(f"{self.folder}/"):
                run("umount", "-l", place)
        shutil.rmtree(self.folder, ignore_errors=True)


def run(*command: str, keep: int | None = None) -> None:
    """Run a program of the system and insist that it works."""
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL, pass_fds=() if keep is None else (keep,))


def main(arguments: list[str]) -> None:
    """Begin, serve, and take away."""
    folder, cgroup, *rest = arguments
    init = Init(Path(folder), cgroup, int(rest[0]) if rest else None)
    try:
        init.prepare()
        init.serve()
    finally:
        init.end()


if __name__ == "__main__":
    main(sys.argv[1:])
