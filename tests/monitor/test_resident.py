# SPDX-License-Identifier: Apache-2.0
"""The headline of memory: what programs of known appetite had resident, seen by supervisor and sidecar.

Programs that have to be sampled wait for the file `go`, which is made when usage.csv has shown enough.
"""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.monitor.measuring import resident
from slamhive.monitor.measuring.processes import children, stat_fields
from slamhive.monitor.measuring.resident import ResidentMemory

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Pod, Run

MIB = 1 << 20
HOLD = "def hold(mib):\n  x = bytearray(mib << 20)\n  x[::4096] = b'1' * len(x[::4096])\n  return x\n"
WAIT = "while not os.path.exists('go'): time.sleep(.01)\n"
BEGIN = f"import os, subprocess, sys, time\n{HOLD}"
CHILD = f"{BEGIN}x = hold(60)\n{WAIT}"
SHORT = (
    f"{BEGIN}open('ready', 'w').close()\nwhile not os.path.exists('begin'): time.sleep(.01)\n"
    f"x = hold(300)\ntime.sleep(.03)\ndel x\nopen('freed', 'w').close()\n{WAIT}"
)
TWO = f"{BEGIN}w = [subprocess.Popen([sys.executable, '-c', {CHILD!r}]) for _ in '12']\n{WAIT}"
FORKED = f"  y = hold(20)\n  x[:20 << 20:4096] = b'2' * 5120\n  {WAIT}  os._exit(0)\n"
CASES = {
    "children": (f"{TWO}for x in w: x.wait()", 120, 175),
    # 200 MiB that both see, and 40 MiB of the child's own: half of that is what it was born with, changed.
    "fork without exec": (f"{BEGIN}x = hold(200)\nif os.fork() == 0:\n{FORKED}os.wait()", 240, 275),
}
cases = pytest.mark.parametrize(("code", "least", "most"), CASES.values(), ids=CASES.keys())


def most_seen(folder: Path) -> float:
    """The most that usage.csv shows so far, MiB."""
    table = folder / "usage.csv"
    lines = table.read_text().rpartition("\n")[0].splitlines() if table.exists() else []
    return max([int(row["resident_bytes"]) / MIB for row in csv.DictReader(lines)], default=0)


def unseen(pid: int, output: Path, wait_for: Callable[..., Any]) -> None:
    """Have a program hold 300 MiB for 30 ms while its monitor sleeps, whose next sample comes too late."""
    wait_for((output / "ready").exists)
    os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: stat_fields(Path(f"/proc/{pid}/stat").read_bytes())[0] == b"T")
    (output / "begin").touch()
    wait_for((output / "freed").exists)
    os.kill(pid, signal.SIGCONT)


@cases
def test_by_the_supervisor(
    run: Run, wait_for: Callable[..., Any], code: str, least: float, most: float
) -> None:
    process = run.start(sys.executable, "-c", code)
    wait_for(lambda: most_seen(run.folder) >= least)
    (run.output / "go").touch()
    assert process.wait(50) == 0
    memory = run.summary()["usage"]["memory"]
    assert memory["kind"] == "Resident"
    assert least <= memory["peakBytes"] / MIB < most


@cases
def test_by_the_sidecar(pod: Pod, wait_for: Callable[..., Any], code: str, least: float, most: float) -> None:
    sidecar = pod.sidecar()
    algorithm = pod.python(code)
    wait_for(lambda: most_seen(pod.folder) >= least)
    (pod.output / "go").touch()
    assert algorithm.wait(50) == 0
    memory = pod.end(sidecar)["usage"]["memory"]
    assert memory["kind"] == "Resident"
    assert least <= memory["peakBytes"] / MIB < most
    assert pod.message()["usage"]["memory"]["peakBytes"] == memory["peakBytes"]


def test_a_peak_between_samples_by_the_supervisor(run: Run, wait_for: Callable[..., Any]) -> None:
    process = run.start(sys.executable, "-c", SHORT)
    unseen(process.pid, run.output, wait_for)
    wait_for(lambda: 300 <= most_seen(run.folder) < 335)
    (run.output / "go").touch()
    assert process.wait(50) == 0


def test_a_peak_between_samples_by_the_sidecar(pod: Pod, wait_for: Callable[..., Any]) -> None:
    sidecar = pod.sidecar()
    algorithm = pod.python(SHORT)
    unseen(children(sidecar.pid)[0], pod.output, wait_for)
    wait_for(lambda: 300 <= most_seen(pod.folder) < 335)
    (pod.output / "go").touch()
    assert algorithm.wait(50) == 0
    assert 300 <= pod.end(sidecar)["usage"]["memory"]["peakBytes"] / MIB < 335


def test_a_peak_behind_the_last_sample(run: Run) -> None:
    memory = run.python(f"{BEGIN}hold(300)", interval_seconds=10)["usage"]["memory"]
    assert 300 <= memory["peakBytes"] / MIB < 335


def test_a_mapped_file_counts_the_same_cold_and_warm(run: Run) -> None:
    code = (
        "import mmap\nwith open('big', 'rb') as f: m = mmap.mmap(f.fileno(), 0, prot=mmap.PROT_READ)\n"
        "for k in range(0, len(m), 4096): m[k]\n"
    )
    with (run.output / "big").open("w+b") as file:
        for _ in range(200):
            file.write(b"x" * MIB)
        file.flush()
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    cold, warm = (run.python(code)["usage"]["memory"] for _ in range(2))
    assert 200 <= cold["peakBytes"] / MIB < 235
    assert warm["peakBytes"] == pytest.approx(cold["peakBytes"], rel=0.03)
    assert max(cold["anonymousPeakBytes"], warm["anonymousPeakBytes"]) < 40 * MIB


@pytest.mark.parametrize("files", [64, 0], ids=["kept", "opened"])
def test_reading(monkeypatch: pytest.MonkeyPatch, wait_for: Callable[..., Any], files: int) -> None:
    """With few descriptors as with many; a program that starts another is the other one from then on."""
    monkeypatch.setattr(resident, "_MOST_FILES", files)
    grown = f"{BEGIN}x = hold(50)\nsys.stdin.readline()"
    other = f"os.execv(sys.executable, [sys.executable, '-c', {grown!r}])"
    code = f"{BEGIN}x = hold(150)\nsys.stdin.readline()\n{other}"
    memory = ResidentMemory()
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        try:
            wait_for(lambda: 150 <= memory.read([process.pid]) / MIB < 185)
            print(file=process.stdin, flush=True)
            wait_for(lambda: 50 <= memory.read([process.pid]) / MIB < 85)
        finally:
            process.kill()
    wait_for(lambda: memory.read([process.pid]) == 0)
    memory.close()


def test_the_first_readings_are_all_done_as_a_run_may_be_over_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resident, "_SHARE", 1e-9)
    monkeypatch.setattr(resident, "_LONGEST_SECONDS", 3600.0)
    memory = ResidentMemory()
    code = f"{BEGIN}sys.stdin.readline()\nx = hold(40)\nprint(flush=True)\nsys.stdin.readline()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        before = memory.read([process.pid])
        print(file=process.stdin, flush=True)
        process.stdout.readline()
        after = memory.read([process.pid])
        process.kill()
    assert after >= before + 35 * MIB
    memory.close()
