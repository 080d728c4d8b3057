# SPDX-License-Identifier: Apache-2.0
"""A real sidecar in what the kernel makes of a pod: one namespace of processes, cgroup by container."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.monitor.measuring.machine import machine_report
from slamhive.monitor.measuring.processes import children

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Pod

MIB = 1 << 20
POSES = "1.0 0 0 0 0 0 0 1\n3.5 1 0 0 0 0 0 1\n"
BURN = "import time\nend = time.thread_time() + {}\nwhile time.thread_time() < end: sum(range(500))\n"
STUBBORN = """
import os, signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0: time.sleep(600)
    os._exit(0)
os.wait()
open('ready', 'w').close()
time.sleep(600)
"""

SEEN = "until [ -e ../usage.csv ]; do sleep .01; done"
"""A program that goes on until it is watched, however busy the machine is."""
with_cgroup = pytest.mark.parametrize("pod", ["cgroup"], indirect=True)


def test_a_run_from_start_to_summary(pod: Pod) -> None:
    (pod.output / "trajectory.txt").write_text(POSES)
    metrics = {"readerCpuSeconds": 0.25, "framesOffered": 9, "lost": 2, "times": [1, 2], "odd": float("nan")}
    (pod.output / "metrics.json").write_text(json.dumps(metrics))
    sidecar = pod.sidecar(dataSeconds=10.0)
    pod.python(BURN.format(1.0))
    summary = pod.finished()
    usage = summary["usage"]
    assert usage["source"] == (pod.group.source.name if pod.group else "proc")
    # What it burnt after the last sample of /proc is lost: how much, the load of the machine decides.
    assert 0.5 < usage["cpu"]["seconds"] < 1.2
    assert usage["cpu"]["secondsPerDataSecond"] == pytest.approx(usage["cpu"]["seconds"] / 10)
    assert (usage["readerCpuSeconds"], usage["maxIncludesReader"]) == (0.25, True)
    assert summary["trajectory"]["poses"] == 2
    assert summary["trajectory"]["durationSeconds"] == 2.5
    assert summary["frames"] == {"offered": 9, "processed": None, "dropped": None}
    assert summary["metrics"] == {"readerCpuSeconds": 0.25, "framesOffered": 9, "lost": 2}
    assert summary["metricsProblem"] == (
        "output/metrics.json: left out times (a list), odd (no finite number)"
    )
    assert (summary["exitCode"], summary["reason"], summary["message"]) == (None, None, "")
    assert summary["node"] == "n1"
    assert summary["cpuModel"]
    assert (pod.folder / "config.yaml").read_text() == "kind: RunConfiguration\n"
    assert len((pod.folder / "usage.csv").read_text().splitlines()) == usage["samples"] + 1
    assert sidecar.poll() is None
    message = pod.message()
    assert message["usage"]["cpu"]["seconds"] == pytest.approx(usage["cpu"]["seconds"], abs=1e-6)
    assert message["trajectory"] == summary["trajectory"]
    told = summary["machine"]
    assert message["machine"] == told == machine_report(exclusive=told.get("exclusiveCores"))
    assert pod.end(sidecar) == summary


def test_an_algorithm_of_50_ms_is_seen(pod: Pod) -> None:
    sidecar = pod.sidecar()
    assert pod.algorithm("sleep", "0.05").wait(50) == 0
    usage = pod.end(sidecar)["usage"]
    assert usage["wallSeconds"] > 0
    assert usage["samples"] >= 2


def test_no_algorithm(pod: Pod) -> None:
    summary = pod.end(pod.sidecar())
    assert (summary["usage"], summary["startedAt"], summary["reason"]) == (None, None, None)
    assert "never seen" in summary["notes"][0]
    assert (summary["trajectoryMissing"], "trajectory" in summary) == (True, False)
    assert pod.message()["trajectoryProblem"] == summary["trajectoryProblem"]


@with_cgroup
def test_figures_are_the_kernels_own(pod: Pod, sampled: str) -> None:
    sidecar = pod.sidecar()
    work = "import subprocess\nfor _ in range(100): subprocess.run(['true'])\n"
    hold = f"x = bytearray({80 * MIB})\nx[::4096] = b'1' * len(x[::4096])\n{sampled}"
    pod.python(BURN.format(0.3) + hold + work).wait(60)
    usage = pod.end(sidecar)["usage"]
    assert pod.group is not None
    assert usage["cpu"]["seconds"] == pytest.approx(pod.group.source.read().cpu, rel=0.01)
    assert usage["memory"]["kernelPeakBytes"] == pod.group.source.kernel_peak()
    assert 80 * MIB < usage["memory"]["anonymousPeakBytes"] < 105 * MIB
    assert usage["throttledSeconds"] in (None, 0.0)


def test_timeout_ends_all_of_the_container_and_nobody_else(pod: Pod) -> None:
    sidecar = pod.sidecar(timeoutSeconds=1.0, killGraceSeconds=0.3)
    algorithm = pod.python(STUBBORN)
    assert algorithm.wait(50) != 0
    summary = pod.finished()
    assert (summary["reason"], summary["message"]) == ("DeadlineExceeded", "it took more than 1 s")
    assert [b"sidecar" in line for line in pod.others()] == [True]
    pod.end(sidecar)


def test_timeout_asks_first(pod: Pod) -> None:
    sidecar = pod.sidecar(timeoutSeconds=0.7, killGraceSeconds=60)
    stopped = "import os, signal, sys, time\nsignal.signal(15, lambda *_: sys.exit(7))\n"
    assert pod.python(f"{stopped}os.kill(os.getpid(), 19)\ntime.sleep(600)").wait(50) == 7
    assert pod.end(sidecar)["reason"] == "DeadlineExceeded"


@with_cgroup
def test_what_can_not_be_ended_holds_nothing_up(pod: Pod, wait_for: Callable[..., Any]) -> None:
    freezers = [path for path in pod.group.directories if os.path.exists(f"{path}/freezer.state")]  # type: ignore[union-attr] # noqa: PTH110
    if not freezers:
        pytest.skip("needs the freezer of version 1")
    sidecar = pod.sidecar(timeoutSeconds=2.0, killGraceSeconds=0)
    pod.algorithm("sleep", "600")
    wait_for((pod.folder / "usage.csv").exists)
    Path(f"{freezers[0]}/freezer.state").write_text("FROZEN")
    summary = pod.finished()
    assert summary["reason"] == "DeadlineExceeded"
    assert summary["notes"][-1] == "processes of the algorithm could not be ended"
    assert pod.end(sidecar) == summary


@pytest.mark.parametrize(
    ("code", "options", "reason", "part"),
    [
        (
            "f = open('map', 'wb')\nwhile True: f.write(b'1' * 100000); f.flush()",
            {"outputLimitBytes": 5 * MIB},
            "OutputTooLarge",
            "5 MiB",
        ),
        (
            "import os, time\nfor _ in range(7): os.fork()\ntime.sleep(600)",
            {"taskLimit": 60},
            "AlgorithmFailed",
            "more than 60 processes",
        ),
        (
            "x = []\nwhile True: x.append(bytearray(b'1' * (4 << 20)))",
            {"memoryLimitBytes": 100 * MIB},
            "OutOfMemory",
            "100 MiB",
        ),
    ],
    ids=["output", "tasks", "memory"],
)
def test_limits(pod: Pod, code: str, options: dict[str, Any], reason: str, part: str) -> None:
    if pod.group is not None:
        pod.group.limit(options.get("memoryLimitBytes"), None)
    sidecar = pod.sidecar(timeoutSeconds=60.0, **options)
    pod.python(code)
    summary = pod.finished()
    assert summary["reason"] == reason
    assert part in summary["message"]
    assert [b"sidecar" in line for line in pod.others()] == [True]
    pod.end(sidecar)


def test_once_killed_it_believes_nothing_and_ends_the_algorithm(
    pod: Pod, wait_for: Callable[..., Any]
) -> None:
    """Whatever it left could have been changed while it was away, as the algorithm has its user."""
    sidecar = pod.sidecar()
    (pod.output / "trajectory.txt").write_text(POSES)
    algorithm = pod.algorithm("sleep", "600")
    wait_for((pod.folder / "usage.csv").exists)
    pod.send(sidecar, signal.SIGKILL)
    sidecar.wait(50)
    (pod.folder / "summary.json").write_text('{"reason": null, "usage": {"cpu": {"seconds": 0.001}}}')
    again = pod.sidecar(at_once=True)
    algorithm.wait(50)
    wait_for(lambda: pod.message().get("reason") == "SystemFault")
    summary = pod.end(again)
    assert (summary["reason"], summary["usage"]) == ("SystemFault", None)
    assert "the monitor was ended while the algorithm ran" in summary["message"]


def test_started_again_before_the_algorithm_it_is_as_if_it_never_died(
    pod: Pod, wait_for: Callable[..., Any]
) -> None:
    first = pod.sidecar()
    pod.send(first, signal.SIGKILL)
    first.wait(50)
    (pod.folder / "config.yaml").unlink()
    sidecar = pod.sidecar()
    pod.algorithm("sh", "-c", SEEN)
    summary = pod.finished()
    assert (summary["reason"], summary["usage"]["suspect"]) == (None, None)
    assert pod.end(sidecar) == summary


def test_told_to_end_before_the_algorithm(pod: Pod, wait_for: Callable[..., Any]) -> None:
    sidecar = pod.sidecar()
    pod.algorithm("sleep", "600")
    wait_for((pod.folder / "usage.csv").exists)
    pod.send(sidecar, signal.SIGTERM)
    summary = pod.end(sidecar)
    assert (summary["reason"], summary["usage"]["samples"] > 1) == ("Cancelled", True)


TRICKS = {
    "stop": ("os.kill(pid, 19); os.kill(pid, 18)", "made to go on, by a signal"),
    "limit": ("resource.prlimit(pid, resource.RLIMIT_FSIZE, (1 << 40, 1 << 40))", "limits were changed"),
    "nice": ("os.setpriority(os.PRIO_PROCESS, pid, 19)", "priority was changed"),
    "idle": ("os.sched_setscheduler(pid, os.SCHED_IDLE, os.sched_param(0))", "priority was changed"),
    "table": ("open('../usage.csv', 'w').write('0')", "usage.csv was changed"),
    "another table": ("os.rename('../usage.csv', 'mine')", "usage.csv was changed"),
}
TRY = """
import os, resource, time
def command(pid):
    try: return open(f'/proc/{pid}/cmdline', 'rb').read()
    except OSError: return b''
pid = next(int(p) for p in os.listdir('/proc') if p.isdigit() and b'slamhive.monitor.sidecar' in command(p))
%s
%s
"""


@pytest.mark.parametrize("pod", ["proc"], indirect=True)
@pytest.mark.parametrize("what", TRICKS)
def test_who_meddles_with_the_monitor_is_seen(pod: Pod, what: str, sampled: str) -> None:
    code, told = TRICKS[what]
    sidecar = pod.sidecar()
    assert pod.python(TRY % (sampled, code)).wait(50) == 0
    pod.finished()
    assert told in pod.end(sidecar)["usage"]["suspect"]


@pytest.mark.parametrize("pod", ["proc"], indirect=True)
def test_nobody_is_suspected_of_nothing(pod: Pod, sampled: str) -> None:
    sidecar = pod.sidecar()
    pod.python(TRY % (sampled, "pass")).wait(50)
    pod.finished()
    assert pod.end(sidecar)["usage"]["suspect"] is None


HOSTILE = [
    "ln -s ../summary.json trajectory.txt; ln -s /dev/zero metrics.json",
    "mkfifo trajectory.txt metrics.json",
    "mkdir trajectory.txt metrics.json",
    "ln -s trajectory.txt trajectory.txt",
    f"head -c {4 * MIB} /dev/zero | tr '\\0' '[' > metrics.json",
    f"(printf '['; yes '[],' | head -c {4 * MIB - 9} | tr -d '\\n'; printf '0]') > metrics.json",
    "chmod 000 .; rm -rf /nothing",
]


@pytest.mark.parametrize("script", HOSTILE)
@with_cgroup
def test_odd_output_is_said_and_never_followed(pod: Pod, script: str) -> None:
    sidecar = pod.sidecar()
    # A program of a millisecond may end before it is seen.
    pod.algorithm("sh", "-c", f"{script}\n{SEEN}").wait(50)
    pod.finished()
    status = Path(f"/proc/{children(sidecar.pid)[0]}/status").read_text()
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    summary = pod.end(sidecar)
    assert summary["trajectoryMissing"]
    assert summary["trajectoryProblem"] == "output/trajectory.txt is missing or not a regular file"
    assert ("metrics.json" in (summary["metricsProblem"] or "")) == ("metrics.json" in script)
    assert peak < 64


@pytest.mark.parametrize("pod", ["proc"], indirect=True)
def test_told_to_end_while_it_starts(pod: Pod, wait_for: Callable[..., Any]) -> None:
    sidecar = pod.sidecar(at_once=True)
    # Not before `env` has blocked the signal and become the sidecar.
    name, not_yet = b"slamhive.monitor.sidecar", b"--block-signal"
    wait_for(lambda: any(name in line and not_yet not in line for line in pod.others()))
    assert pod.end(sidecar)["usage"] is None
    assert pod.message()["v"] == 1
