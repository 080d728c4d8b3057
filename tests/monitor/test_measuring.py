# SPDX-License-Identifier: Apache-2.0
"""Tests of measured CPU and memory on programs whose use is known."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from conftest import Run

MIB = 1 << 20
BURN = """
import os, time
def burn(seconds):
    end = time.thread_time() + seconds
    while time.thread_time() < end: sum(range(500))
"""


def test_cpu_of_one_process(run: Run) -> None:
    summary = run.python(
        f"{BURN}\nburn(.3)\nopen('cpu','w').write(str(time.process_time()))", data_seconds=10
    )
    usage = summary["usage"]
    own = float((run.output / "cpu").read_text())
    assert usage["cpu"]["seconds"] == pytest.approx(own, abs=0.08)
    assert usage["cpu"]["meanCores"] == pytest.approx(usage["cpu"]["seconds"] / usage["wallSeconds"])
    assert usage["cpu"]["meanCores"] <= usage["cpu"]["maxCores"] * 1.05
    assert usage["cpu"]["maxCores"] < 1.1
    assert usage["cpu"]["secondsPerDataSecond"] == pytest.approx(usage["cpu"]["seconds"] / 10)
    assert (summary["exitCode"], summary["reason"], summary["message"]) == (0, None, "")
    assert usage["source"] == ("proc" if run.cgroup == "none" else usage["source"])


@pytest.mark.parametrize(
    "body",
    [
        "import threading as t\nw=[t.Thread(target=burn,args=(.1,)) for _ in '123']",
        "import multiprocessing as m\nw=[m.Process(target=burn,args=(.1,)) for _ in '123']",
    ],
    ids=["threads", "children"],
)
def test_cpu_of_threads_and_children(run: Run, body: str) -> None:
    summary = run.python(f"{BURN}\n{body}\nfor x in w: x.start()\nfor x in w: x.join()")
    assert 0.3 <= summary["usage"]["cpu"]["seconds"] < 0.7


def test_cpu_of_a_daemon_that_forked_twice(run: Run) -> None:
    daemon = "os.setsid(); burn(.25); open('done', 'w')"
    fork_twice = f"if os.fork() == 0:\n  if os.fork() == 0:\n    {daemon}\n  os._exit(0)\nos.wait()"
    summary = run.python(f"{BURN}\n{fork_twice}\nwhile not os.path.exists('done'): time.sleep(.01)")
    assert 0.25 <= summary["usage"]["cpu"]["seconds"] < 0.55


def test_cpu_of_short_lived_children(run: Run) -> None:
    code = "for i in $(seq 150); do /bin/true; done; cat /proc/$$/stat > stat"
    summary = run("sh", "-c", code)
    fields = (run.output / "stat").read_text().rpartition(")")[2].split()
    kernel = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    assert summary["usage"]["cpu"]["seconds"] == pytest.approx(kernel, rel=0.01, abs=0.05)


def test_memory(run: Run, sampled: str) -> None:
    code = "x = bytearray(200 << 20)\nx[::4096] = b'1' * len(x[::4096])\n"
    usage = run.python(code + sampled)["usage"]
    assert 200 * MIB <= usage["memory"]["anonymousPeakBytes"] < 225 * MIB
    assert 200 * MIB <= usage["memory"]["peakBytes"] < 240 * MIB
    assert 100 * MIB < usage["memory"]["meanBytes"] <= usage["memory"]["peakBytes"]


def test_page_cache_does_not_count(run: Run, sampled: str) -> None:
    code = (
        "f = open('big', 'wb')\nfor i in range(100): f.write(b'x' * (1 << 20))\nf.close()\n"
        "f = open('big', 'rb')\nwhile f.read(1 << 20): pass\n"
    )
    memory = run.python(code + sampled)["usage"]["memory"]
    assert memory["anonymousPeakBytes"] < 40 * MIB
    assert memory["workingSetPeakBytes"] < 60 * MIB
    assert memory["peakBytes"] < 40 * MIB


def _rows(run: Run) -> list[dict[str, str]]:
    return list(csv.DictReader((run.folder / "usage.csv").read_text().splitlines()))


def _area(run: Run) -> float:
    """CPU seconds under the curve of usage.csv."""
    total = begin = 0.0
    for row in _rows(run):
        end = float(row["time_seconds"])
        total += (end - begin) * float(row["cpu_cores"])
        begin = end
    return total


def test_usage_table(run: Run) -> None:
    usage = run.python(f"{BURN}\nburn(.3)")["usage"]
    rows = _rows(run)
    assert list(rows[0]) == [
        "time_seconds",
        "cpu_cores",
        "resident_bytes",
        "anonymous_bytes",
        "working_set_bytes",
    ]
    times = [float(row["time_seconds"]) for row in rows]
    assert times == sorted(times)
    assert len(rows) == usage["samples"]
    assert times[-1] == pytest.approx(usage["wallSeconds"], abs=1e-3)
    assert _area(run) == pytest.approx(usage["cpu"]["seconds"], rel=0.02)


@pytest.mark.parametrize(
    ("metrics", "subtracted", "included", "noted"),
    [
        ({"readerCpuSeconds": 0.12}, 0.12, False, False),
        ({}, None, None, False),  # it says nothing of its reader: that none is in it isn't known
        ({"includesReader": False}, 0.0, False, False),
        ({"includesReader": True}, None, True, False),
        ({"readerCpuSeconds": -1}, None, True, True),
        ({"readerCpuSeconds": 1e6}, None, True, True),
        ({"readerCpuSeconds": float("nan")}, None, True, True),
        ([1], None, True, True),
    ],
)
@pytest.mark.parametrize("run", ["proc"], indirect=True)
def test_reader(run: Run, metrics: Any, subtracted: float | None, included: bool | None, noted: bool) -> None:
    (run.output / "metrics.json").write_text(json.dumps(metrics))
    summary = run.python(f"{BURN}\nburn(.2)")
    usage = summary["usage"]
    assert usage["readerCpuSeconds"] == subtracted
    assert (usage["includesReader"], "metrics.json" in (summary["metricsProblem"] or "")) == (included, noted)
    assert usage["maxIncludesReader"] == (bool(subtracted) or included)
    expected = _area(run) - (subtracted or 0)
    assert usage["cpu"]["seconds"] == pytest.approx(expected, abs=0.01)
    assert usage["cpu"]["meanCores"] == pytest.approx(usage["cpu"]["seconds"] / usage["wallSeconds"])


def test_reader_report_through_a_pipe_does_not_block(run: Run) -> None:
    summary = run("sh", "-c", "mkfifo metrics.json")
    assert "metrics.json" in summary["metricsProblem"]


def test_affinity(run: Run) -> None:
    cpu = max(os.sched_getaffinity(0))
    run.python("import os; print(os.sched_getaffinity(0))", cpus=(cpu,))
    assert (run.folder / "log.txt").read_text() == f"{{{cpu}}}\n"


def test_contention(run: Run) -> None:
    cpu = max(os.sched_getaffinity(0))
    code = f"import os\nos.sched_setaffinity(0, {{{cpu}}})\nwhile True: pass"
    other = subprocess.Popen([sys.executable, "-c", code])
    try:
        usage = run.python(f"{BURN}\nburn(1.2)", cpus=(cpu,))["usage"]
    finally:
        other.kill()
        other.wait()
    # How long it waits for its core, other groups of processes decide; that sums are right, test_parts shows.
    assert 0 < usage["contendedSeconds"] <= usage["wallSeconds"]


def test_import_stays_light() -> None:
    heavy = "numpy pydantic yaml rich subprocess asyncio argparse pathlib tempfile logging".split()  # noqa: SIM905
    code = f"import sys, slamhive.monitor.__main__\nprint([m for m in {heavy} if m in sys.modules])"
    told = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout == "[]\n"


def test_supervisor_does_not_count_itself(run: Run) -> None:
    assert run("sleep", "0.5")["usage"]["cpu"]["seconds"] < 0.02
