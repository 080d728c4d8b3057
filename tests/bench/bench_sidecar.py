# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the sidecar's cost and accuracy, in a pod of bare namespaces: needs root.

Prints one line per figure: what · ours · limit or peer.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slamhive.contract.trajectory import check_trajectory
from slamhive.monitor.measuring.processes import children

sys.path.insert(0, str(Path(__file__).parents[1] / "monitor"))
from conftest import Pod, can_make_pods

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterator

STARTS = 8
SECONDS = 8.0
MIB = 1 << 20
# Threads, a pool of children, 300 short-lived ones, and 300 MiB for a moment: about 4 CPU seconds.
WORK = f"""
import subprocess, threading, multiprocessing, time
def burn(seconds):
    end = time.thread_time() + seconds
    while time.thread_time() < end: sum(range(500))
block = bytearray({300 * MIB})
block[::4096] = b'1' * len(block[::4096])
time.sleep(0.3)
del block
workers = [threading.Thread(target=burn, args=(0.7,)) for _ in range(2)]
workers += [multiprocessing.Process(target=burn, args=(0.6,)) for _ in range(4)]
for worker in workers: worker.start()
for _ in range(300): subprocess.run(["true"])
for worker in workers: worker.join()
"""
EIGHT_THREADS = f"""
import threading, time
for _ in range(7): threading.Thread(target=time.sleep, args=({2 * SECONDS},)).start()
end = time.monotonic() + {2 * SECONDS}
while time.monotonic() < end: sum(range(500))
"""


def report(what: str, ours: str, limit: str) -> None:
    """Print one figure."""
    print(f"{what} · {ours} · {limit}", flush=True)


@contextmanager
def pod() -> Iterator[Pod]:
    """Make a pod with a cgroup for its algorithm."""
    with tempfile.TemporaryDirectory() as name:
        made = Pod(Path(name), accounted=True)
        try:
            yield made
        finally:
            made.close()


def cpu_of(entered: subprocess.Popen[bytes]) -> float:
    """Return the CPU seconds of a process in the pod, to the nanosecond."""
    return time.clock_gettime((~children(entered.pid)[0] << 3) | 2)


def peak_mib(entered: subprocess.Popen[bytes]) -> float:
    """Return the most memory a process in the pod had."""
    status = Path(f"/proc/{children(entered.pid)[0]}/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def share(entered: subprocess.Popen[bytes]) -> float:
    """Return a process's share of a core over the next seconds."""
    cpu, begin = cpu_of(entered), time.monotonic()
    time.sleep(SECONDS)
    return (cpu_of(entered) - cpu) / (time.monotonic() - begin)


def bench_start() -> None:
    """Report CPU from the start of the process until it watches."""
    costs = []
    for _ in range(STARTS):
        with pod() as one:
            costs.append(cpu_of(one.sidecar()))
    ours = f"{min(costs) * 1e3:.0f} ms CPU (median {statistics.median(costs) * 1e3:.0f} ms)"
    report("start of the sidecar until it watches", ours, "limit 150 ms")


def bench_shares() -> None:
    """Report the sidecar's share of a core while it waits and while it watches, and its memory."""
    with pod() as one:
        sidecar = one.sidecar()
        waiting = share(sidecar)
        report("the sidecar's share of a core while an image is pulled", f"{waiting:.2%}", "limit 1%")
        one.python(EIGHT_THREADS)
        time.sleep(1)
        report("the same at 10 Hz beside eight threads", f"{share(sidecar):.2%}", "limit 1%")
        report("the sidecar's memory", f"{peak_mib(sidecar):.1f} MiB resident", "limit 40 MiB")


def bench_accuracy() -> None:
    """Report CPU and memory beside the cgroup's own account, read from outside until its end."""
    with pod() as one:
        sidecar = one.sidecar()
        if one.group is None:
            print("no cgroup can be made here: no account to compare with")
            return
        algorithm = one.python(WORK)
        working_set = 0
        while algorithm.poll() is None:
            working_set = max(working_set, one.group.source.read().working_set)
            time.sleep(0.01)
        usage = one.end(sidecar)["usage"]
        compare("CPU seconds", usage["cpu"]["seconds"], one.group.source.read().cpu, "s")
        kernel_peak = (one.group.source.kernel_peak() or 0) / MIB
        compare("kernel's peak", usage["memory"]["kernelPeakBytes"] / MIB, kernel_peak, "MiB")
        ours = usage["memory"]["workingSetPeakBytes"] / MIB
        compare("peak of the working set", ours, working_set / MIB, "MiB")


def compare(what: str, ours: float, theirs: float, unit: str) -> None:
    """Report one figure beside the node's."""
    off = abs(ours - theirs) / theirs
    peer = f"{theirs:.3f} {unit} from the node, difference {off:.2%}, limit 1%"
    report(f"{what} by the sidecar", f"{ours:.3f} {unit}", peer)


def bench_trajectory() -> None:
    """Report how long a long trajectory takes to be checked."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "trajectory.txt"
        with path.open("w") as file:
            for k in range(200_000):
                file.write(
                    f"{1403636580 + k / 100:.6f} 1.234567891 -2.345678912 3.456789123 0.1 0.2 0.3 0.9\n"
                )
        begin = time.perf_counter()
        found: Any = check_trajectory(name).info
        taken = time.perf_counter() - begin
        report(f"check of a trajectory of {found.poses:,} poses", f"{taken:.2f} s", "limit 2 s")


def main() -> None:
    """Run all benchmarks."""
    bench_trajectory()
    if not can_make_pods():
        print("namespaces can't be made here: no figures for a pod; needs root")
        return
    bench_start()
    bench_shares()
    bench_accuracy()


if __name__ == "__main__":
    main()
