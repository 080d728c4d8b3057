# SPDX-License-Identifier: Apache-2.0
"""Real processes under a real supervisor or beside a real sidecar, by cgroup and by /proc."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import slamhive
from slamhive.monitor import SupervisorSpec, end_orphans, identify, make_run_cgroup
from slamhive.monitor.measuring.hierarchy import own_hierarchies
from slamhive.monitor.measuring.processes import children

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


PACKAGES = str(Path(slamhive.__file__).parents[1])


def wait_for(condition: Callable[[], Any], seconds: float = 50.0) -> Any:
    """Poll until a condition holds and return its value."""
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, "the condition never held"
        time.sleep(0.01)
    return value


def _cgroup_name() -> str | None:
    owner = identify(os.getpid())
    group = make_run_cgroup(owner) if owner else None
    if group is None:
        return None
    name = group.source.name
    group.remove()
    return name


class Run:
    """A run folder and its supervisor."""

    def __init__(self, folder: Path, cgroup: str) -> None:
        self.folder = folder
        self.cgroup = cgroup
        self.output = folder / "output"
        self.output.mkdir(parents=True, exist_ok=True)
        self.process_json = folder / "process.json"

    def spec(self, *argv: str, **options: Any) -> SupervisorSpec:
        return SupervisorSpec(
            argv=argv,
            cwd=str(self.output),
            env={"PATH": os.environ["PATH"], "SLAMHIVE_RUN": str(self.folder)},
            log_path=str(self.folder / "log.txt"),
            usage_path=str(self.folder / "usage.csv"),
            summary_path=str(self.folder / "summary.json"),
            process_path=str(self.process_json),
            output_directory=str(self.output),
            **{"cgroup": self.cgroup, "kill_grace_seconds": 5.0, **options},
        )

    def command(self, *argv: str, **options: Any) -> list[str]:
        path = self.folder / "spec.json"
        path.write_text(self.spec(*argv, **options).to_json())
        return [sys.executable, "-m", "slamhive.monitor", "--spec", str(path)]

    def start(self, *argv: str, **options: Any) -> subprocess.Popen[bytes]:
        return subprocess.Popen(self.command(*argv, **options))

    def __call__(self, *argv: str, **options: Any) -> dict[str, Any]:
        """Run to the end and return the summary."""
        assert subprocess.run(self.command(*argv, **options), check=False, timeout=120).returncode == 0
        return self.summary()

    def python(self, code: str, **options: Any) -> dict[str, Any]:
        return self(sys.executable, "-c", code, **options)

    def summary(self) -> dict[str, Any]:
        return json.loads((self.folder / "summary.json").read_text())

    def pid(self, name: str) -> int:
        """Wait for the pid that a program of the run writes into a file of its output."""
        path = self.output / name
        return int(wait_for(lambda: path.exists() and path.read_text().strip()))

    def cgroups(self) -> list[str]:
        return json.loads(self.process_json.read_text())["cgroups"]


# As nsenter, but nsenter stops when its child is stopped.
ENTER = """
import ctypes, os, sys
for name in ('pid', 'mnt'):
    descriptor = os.open(f'/proc/{sys.argv[1]}/ns/{name}', os.O_RDONLY)
    if name == 'mnt': here = os.getcwd()
    if ctypes.CDLL(None).setns(descriptor, 0): os._exit(125)
os.chdir(here)
child = os.fork()
if child == 0: os.execvp(sys.argv[2], sys.argv[2:])
os._exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) % 256)
"""


class Pod:
    """A pause process that holds the namespace; containers are entered from outside, as runtimes do."""

    def __init__(self, folder: Path, *, accounted: bool) -> None:
        self.folder = folder
        self.output = folder / "output"
        self.output.mkdir()
        (folder / "config.in").write_text("kind: RunConfiguration\n")
        self._holder = subprocess.Popen(
            ["unshare", "--pid", "--fork", "--kill-child", "--mount-proc", "sleep", "600"]
        )
        self._pause = wait_for(lambda: children(self._holder.pid))[0]
        wait_for(lambda: b"sleep" in Path(f"/proc/{self._pause}/cmdline").read_bytes())
        me = identify(os.getpid())
        self.group = make_run_cgroup(me) if accounted and me else None
        self._entered: list[subprocess.Popen[bytes]] = []
        self.variables: dict[str, str] = {}
        """The monitor's, beside those that a cluster gives it."""

    def _enter(self, *argv: str, name: str, **variables: str) -> subprocess.Popen[bytes]:
        given = [f"{key}={value}" for key, value in variables.items()]
        command = [sys.executable, "-ISc", ENTER, str(self._pause)]
        program = ["env", "-i", f"SLAMHIVE_CONTAINER={name}", "PATH=/usr/bin:/bin", *given, *argv]
        if name == "algorithm":
            program = ["unshare", "--mount", "sh", "-ec", self._script(), "sh", *program]
        process = subprocess.Popen([*command, *program], cwd=self.output)
        self._entered.append(process)
        return process

    def _script(self) -> str:
        """Return a shell script that sets a container up as a runtime does: it sees its own cgroup alone."""
        if self.group is None:
            return 'exec "$@"'
        mounts = {tree.directory: tree for tree in own_hierarchies()}
        lines = [f"mkdir {self.folder}/cg", f"mount -t tmpfs none {self.folder}/cg"]
        for directory in self.group.directories:
            tree = mounts[os.path.dirname(directory)]  # noqa: PTH120
            place = f"{self.folder}/cg/{os.path.basename(tree.mount)}" if tree.version == 1 else ""  # noqa: PTH119
            lines += [f"mkdir -p {place}"] if place else []
            lines += [f"mount --bind {directory} {place or f'{self.folder}/cg'}"]
        lines += [f"mount --move {self.folder}/cg /sys/fs/cgroup"]
        kept = [
            f"exec {3 + k}>{directory}/cgroup.procs" for k, directory in enumerate(self.group.directories)
        ]
        joins = [f"echo 0 >&{3 + k}; exec {3 + k}>&-" for k in range(len(kept))]
        return "\n".join([*kept, *lines, *joins, 'exec "$@"'])

    def sidecar(self, *, at_once: bool = False, **options: Any) -> subprocess.Popen[bytes]:
        """Start the sidecar and return when it watches, or with `at_once` before."""
        spec = {
            "container": "algorithm",
            "runDirectory": str(self.folder),
            "configuration": str(self.folder / "config.in"),
            "terminationMessage": str(self.folder / "message"),
            **options,
        }
        argv = ["env", "--block-signal=TERM", sys.executable, "-P", "-m", "slamhive.monitor.sidecar"]
        state = self.folder / "config.yaml"  # which it copies as it begins
        before = state.stat().st_mtime_ns if state.exists() else 0
        given = {"SLAMHIVE_SIDECAR": json.dumps(spec), "NODE_NAME": "n1", "PYTHONPATH": PACKAGES}
        started = self._enter(*argv, name="monitor", **given, **self.variables)
        done = self.folder / "summary.json"
        wait_for(lambda: at_once or done.exists() or (state.exists() and state.stat().st_mtime_ns > before))
        return started

    def algorithm(self, *argv: str) -> subprocess.Popen[bytes]:
        return self._enter(*argv, name="algorithm")

    def python(self, code: str) -> subprocess.Popen[bytes]:
        return self.algorithm(sys.executable, "-c", code)

    @staticmethod
    def send(entered: subprocess.Popen[bytes], number: int) -> None:
        for pid in children(entered.pid):
            os.kill(pid, number)

    def end(self, sidecar: subprocess.Popen[bytes]) -> dict[str, Any]:
        """Do as the kubelet does after the algorithm; return the summary."""
        self.send(sidecar, signal.SIGTERM)
        assert sidecar.wait(50) == 0
        return self.summary()

    def summary(self) -> dict[str, Any]:
        return json.loads((self.folder / "summary.json").read_text())

    def message(self) -> dict[str, Any]:
        """Return the last words; none before there are any: their file is made before it is written."""
        file = self.folder / "message"
        return json.loads((file.read_text() if file.exists() else "") or "{}")

    def finished(self) -> dict[str, Any]:
        wait_for(self.message)
        return self.summary()

    def others(self) -> list[bytes]:
        """Return the command lines of the processes in the pod beside its pause."""
        names = []
        for pid in map(int, filter(str.isdigit, os.listdir("/proc"))):  # noqa: PTH208
            with contextlib.suppress(OSError):
                inside = Path(f"/proc/{pid}/ns/pid").stat() == Path(f"/proc/{self._pause}/ns/pid").stat()
                if inside and pid != self._pause and identify(pid):
                    names.append(Path(f"/proc/{pid}/cmdline").read_bytes())
        return names

    def close(self) -> None:
        for directory in self.group.directories if self.group else ():
            if os.path.exists(f"{directory}/freezer.state"):  # noqa: PTH110
                Path(f"{directory}/freezer.state").write_text("THAWED")
        self._holder.kill()
        self._holder.wait()
        for process in self._entered:
            process.wait(50)
        assert self.group is None or self.group.remove()


def can_make_pods() -> bool:
    command = ["unshare", "--pid", "--fork", "--mount-proc", "--mount", "true"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture(params=["cgroup", "proc"])
def pod(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Pod]:
    if not can_make_pods():
        pytest.skip("namespaces can't be made here; needs root")
    made = Pod(tmp_path, accounted=request.param == "cgroup")
    try:
        if request.param == "cgroup" and made.group is None:
            pytest.skip("no cgroup with CPU and memory can be made here")
        yield made
    finally:
        made.close()


@pytest.fixture(params=["cgroup", "proc"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Run]:
    if request.param == "cgroup" and _cgroup_name() is None:
        pytest.skip("no cgroup with CPU and memory can be made here")
    made = Run(tmp_path, "auto" if request.param == "cgroup" else "none")
    yield made
    if made.process_json.exists():
        left_behind = [path for path in made.cgroups() if os.path.exists(path)]  # noqa: PTH110
        assert end_orphans(made.process_json) == []
        assert left_behind == []


@pytest.fixture
def killed() -> Callable[[subprocess.Popen[bytes]], None]:
    """Kill -9 a process of ours and wait for it."""

    def kill(process: subprocess.Popen[bytes]) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
        process.wait(50)

    return kill


@pytest.fixture(name="wait_for")
def wait_for_fixture() -> Callable[..., Any]:
    return wait_for


@pytest.fixture
def sampled() -> str:
    """Code for a measured program: waits until all that it holds is sampled, by the table's growth twice."""
    return """
import os, time
def written(): return os.path.getsize('../usage.csv') if os.path.exists('../usage.csv') else 0
for _ in range(2):
    size = written()
    while written() == size: time.sleep(.01)
"""
