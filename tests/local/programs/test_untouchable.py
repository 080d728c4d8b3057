# SPDX-License-Identifier: Apache-2.0
"""Tests of attacks by a measured program on its supervisor, made from inside runs of an ordinary user."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml

import slamhive
from slamhive.archive import Archive
from slamhive.local.home.folder import Home
from slamhive.model.results import Phase, Reason

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.model.results import RunRecord

pytestmark = pytest.mark.timeout(300)

USER = 65532
HEAD = """
import ctypes, json, os, pathlib, re, resource, shutil, signal, struct, subprocess, sys, time
run = pathlib.Path(os.environ["SLAMHIVE_RUN"])
folder, output = run.parent, run / "output"
libc = ctypes.CDLL(None, use_errno=True)
def parent(pid):
    return int(pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
supervisor = os.getppid()
runner = parent(supervisor)
done = []
def attempt(what, act):
    for pid in (supervisor, runner):
        try:
            act(pid)
            done.append([what, pid])
        except OSError:
            pass
def call(result):
    if result == -1: raise OSError(ctypes.get_errno(), "")
def use(seconds):
    while time.process_time() < seconds: sum(range(1000))
def sampled(lines):
    while (folder / "usage.csv").read_text().count("\\n") < lines: time.sleep(.01)
use(0.3)
shutil.copyfile(run / "assets" / "truth.txt", output / "trajectory.txt")
act = re.search(r"^  act: (.+)$", (run / "config.yaml").read_text(), re.MULTILINE).group(1).strip("'")
"""

LOOK = """
place = ctypes.create_string_buffer(64)
class Vector(ctypes.Structure):
    _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]
mine = Vector(ctypes.addressof(place), 64)
def copy(name, pid):
    start = int(pathlib.Path("/proc/self/maps").read_text().split("-")[0], 16)
    call(getattr(libc, name)(pid, ctypes.byref(mine), 1, ctypes.byref(Vector(start, 64)), 1, 0))
def take(pid):
    descriptor = os.pidfd_open(pid)
    for number in range(20): call(libc.syscall(438, descriptor, number, 0))
attempt("read memory", lambda pid: open(f"/proc/{pid}/mem", "rb").close())
attempt("write memory", lambda pid: open(f"/proc/{pid}/mem", "r+b").close())
attempt("list its root", lambda pid: os.listdir(f"/proc/{pid}/root"))
attempt("list its folder", lambda pid: os.listdir(f"/proc/{pid}/cwd"))
attempt("list its files", lambda pid: os.listdir(f"/proc/{pid}/fd"))
attempt("write its files", lambda pid: [open(f"/proc/{pid}/fd/{n}", "wb").close() for n in range(20)])
attempt("read its environment", lambda pid: open(f"/proc/{pid}/environ", "rb").read())
attempt("read its maps", lambda pid: open(f"/proc/{pid}/maps", "rb").read())
attempt("attach", lambda pid: call(libc.ptrace(16, pid, 0, 0)))
attempt("seize", lambda pid: call(libc.ptrace(0x4206, pid, 0, 0)))
attempt("process_vm_readv", lambda pid: copy("process_vm_readv", pid))
attempt("process_vm_writev", lambda pid: copy("process_vm_writev", pid))
attempt("pidfd_getfd", take)
attempt("change who is killed first", lambda pid: open(f"/proc/{pid}/oom_score_adj", "w").write("1000"))
attempt("have it dump", lambda pid: open(f"/proc/{pid}/coredump_filter", "w").close())
"""

FORGED = '{"exitCode": 0, "reason": null, "usage": {"cpu": {"seconds": 0.001}, "memory": {}}}'
LEFT = f"""
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        while os.path.exists(f"/proc/{{supervisor}}"): pass
        (folder / "summary.json").write_text('''{FORGED}''')
        time.sleep(600)
    os._exit(0)
"""

THREAD = """
import threading
done = threading.Event()
def read():
    task = f"/proc/self/task/{threading.get_native_id()}"
    pathlib.Path(task, "comm").write_text("slamhive-reader")
    done.wait()
reader = threading.Thread(target=read)
reader.start()
sampled(3)
use(2.0)
done.set()
reader.join()
(output / "metrics.json").write_text(json.dumps({"readerCpuSeconds": 1.9}))
"""

SEEN: dict[str, tuple[str, str]] = {
    "claim a reader": (
        '(output / "metrics.json").write_text(json.dumps({"readerCpuSeconds": 0.99 * time.process_time()}))',
        "its reader claims",
    ),
    "claim an absurd reader": (
        '(output / "metrics.json").write_text(json.dumps({"readerCpuSeconds": 1e9}))',
        "is more than all CPU seconds and was ignored",
    ),
    "claim more than the thread": (THREAD, "the clock of its thread has"),
    "stop": (
        "os.kill(supervisor, 19); os.kill(supervisor, 18)",
        "by a signal",
    ),
    "limit": (
        "resource.prlimit(supervisor, resource.RLIMIT_NOFILE, (200, 4096))",
        "limits were changed",
    ),
    "renice": ("os.setpriority(os.PRIO_PROCESS, supervisor, 19)", "priority was changed"),
    "idle": (
        "os.sched_setscheduler(supervisor, os.SCHED_IDLE, os.sched_param(0))",
        "priority was changed",
    ),
    "write the samples": (
        'sampled(2); (folder / "usage.csv").write_text("time_seconds")',
        "usage.csv was changed",
    ),
    "put other samples there": (
        'sampled(2); os.replace(folder / "usage.csv", folder / "mine")',
        "usage.csv was changed",
    ),
}
"""Tries that leave the figures as they are and are said of them: program, part of the sentence."""

WITHOUT_EFFECT: dict[str, str] = {
    "look": LOOK + 'json.dump(done, open(output / "done.json", "w"))',
    "forge the summary": f"""(folder / "summary.json").write_text('''{FORGED}''')""",
    "forge a state": """
for name in ("monitor.json", "process.json", "supervisor.json", "attempt.json"):
    (folder / name).write_text("{}")
""",
    "link what is read": '(output / "metrics.json").symlink_to("/etc/passwd")',
}
"""Tries that change nothing, as if they had not been made."""

FATAL: dict[str, tuple[str, str]] = {
    "kill": (LEFT + "os.kill(supervisor, 9); time.sleep(60)", "the supervisor was ended by signal 9"),
    "abort": (LEFT + "os.kill(supervisor, 6); time.sleep(60)", "the supervisor was ended by signal 6"),
    "end": (
        f"(folder / 'summary.json').write_text('''{FORGED}'''); os.kill(supervisor, 15); time.sleep(60)",
        "another program told the supervisor to end the run",
    ),
    "no more CPU": (
        LEFT + "resource.prlimit(supervisor, resource.RLIMIT_CPU, (0, 0)); time.sleep(60)",
        "the supervisor was ended by signal",
    ),
    "no more files": (
        "resource.prlimit(supervisor, resource.RLIMIT_FSIZE, (0, 0))",
        "",
    ),
}
"""Tries that end who measures: the run is a fault."""


ELSEWHERE = """
mount --bind "$1" "$3"
mount -t tmpfs -o mode=755 none "$2"
mkdir -p "$1"
mount --move "$3" "$1"
shift 3
exec "$@"
"""


def as_a_user(command: list[str], spare: Path) -> list[str]:
    """Return a command as root runs it as nobody in particular: root is kept from nothing.

    Also where our interpreter is in root's own folder, closed to others.
    """
    if os.getuid() != 0:
        return command
    user = f"--reuid={USER}", f"--regid={USER}", "--clear-groups", "--no-new-privs"
    command = ["setpriv", *user, "--bounding-set=-all", "--inh-caps=-all", *command]
    parents = [*reversed(Path(sys.base_prefix).parents)]
    closed = next((str(place) for place in parents if not place.stat().st_mode & 0o001), None)
    if closed is None:
        return command
    return ["unshare", "--mount", "sh", "-ec", ELSEWHERE, "sh", sys.base_prefix, closed, str(spare), *command]


@pytest.fixture(scope="module")
def base() -> Iterator[Path]:
    """A folder that isn't below pytest's own, which are closed to other users."""
    path = Path(tempfile.mkdtemp(prefix="slamhive-untouchable-"))
    yield path
    shutil.rmtree(path)


@pytest.fixture(scope="module")
def records(tiny: Path, base: Path) -> dict[str, RunRecord]:
    """Records of one run of each try, by the try; one ``slamhive run`` makes them all."""
    home, actor = base / "home", base / "home" / "algorithms" / "actor"
    shutil.copytree(tiny, home / "datasets")
    shutil.copytree(Path(__file__).parents[2] / "actor", actor)
    truth = next(tiny.glob("tiny-*/groundtruth.txt")).read_text()
    (actor / "truth.txt").write_text("".join(line + "\n" for line in truth.splitlines() if line[0] != "#"))
    tries = {name: code for name, (code, _) in (SEEN | FATAL).items()} | WITHOUT_EFFECT | {"nothing": "pass"}
    (actor / "adapter.py").write_text(HEAD + f"exec({tries!r}[act])\n")
    template = {"algorithmRef": {"name": "actor"}, "datasetRef": {"name": "tiny"}, "retries": 0}
    matrix = [{"path": "parameters.act", "values": list(tries)}]
    sweep = {
        "apiVersion": "slamhive.io/v1alpha1",
        "kind": "Sweep",
        "metadata": {"name": "tries"},
        "spec": {"template": {"spec": template}, "matrix": matrix},
    }
    (base / "sweep.yaml").write_text(yaml.safe_dump(sweep))
    (base / "spare").mkdir()
    if os.getuid() == 0:
        for place in (base, *base.rglob("*")):
            os.chown(place, USER, USER, follow_symlinks=False)
    packages = [Path(slamhive.__file__).parents[1], Path(slamhive.__file__).parents[2] / "evaluator"]
    variables = {
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "SLAMHIVE_HOME": str(home),
        "HOME": str(base),
        "PYTHONPATH": os.pathsep.join(map(str, packages)),
    }
    program = "from slamhive.cli.main import main; main()"
    command = [sys.executable, "-c", program, "run", str(base / "sweep.yaml"), "-j", "2"]
    done = subprocess.run(
        as_a_user(command, base / "spare"),
        env=variables,
        capture_output=True,
        text=True,
        check=False,
        cwd=base,
    )
    with Archive.open(Home.at(home).archive_url) as archive:
        found = {record.spec["parameters"]["act"]: record for record in archive.runs()}
    assert sorted(found) == sorted(tries), f"{done.stdout}{done.stderr}"
    return found


def figures_are_true(record: RunRecord) -> bool:
    """Tell whether the whole CPU time is there: every program used 0.3 s of it."""
    usage = record.usage
    return usage is not None and (usage.cpu.total_seconds or 0) >= 0.3 and record.phase is Phase.SUCCEEDED


def test_figures_come_from_a_process_that_the_measured_program_cannot_touch(
    records: dict[str, RunRecord],
) -> None:
    record = records["look"]
    assert json.loads((Path(record.folder or "") / "run/output/done.json").read_text()) == []
    assert figures_are_true(record)


@pytest.mark.slow
@pytest.mark.parametrize("what", SEEN)
def test_a_try_that_can_be_made_is_said_of_the_figures(what: str, records: dict[str, RunRecord]) -> None:
    record, told = records[what], SEEN[what][1]
    assert figures_are_true(record)
    assert record.usage is not None
    assert told in (record.usage.suspect or "")
    assert "UsageSuspect" in (record.message or "")


@pytest.mark.parametrize("what", ["nothing", *WITHOUT_EFFECT])
def test_a_try_without_effect_changes_nothing(what: str, records: dict[str, RunRecord]) -> None:
    record = records[what]
    assert figures_are_true(record), (record.phase, record.reason, record.message, record.usage)
    assert record.usage is not None
    assert record.usage.suspect is None


@pytest.mark.parametrize("what", FATAL)
def test_who_ends_the_measurement_has_no_result(what: str, records: dict[str, RunRecord]) -> None:
    record = records[what]
    assert (record.phase, record.reason, record.results) == (Phase.FAILED, Reason.SYSTEM_FAULT, [])
    assert FATAL[what][1] in (record.message or "")
