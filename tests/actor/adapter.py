# SPDX-License-Identifier: Apache-2.0
"""An algorithm that acts as its parameter says; the good act copies the ground truth, given as an asset."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

run = Path(os.environ["SLAMHIVE_RUN"])
text = (run / "config.yaml").read_text()
act = re.search(r"^  act: (\S+)$", text, re.MULTILINE)
number = re.search(r"^  number: (\d+)$", text, re.MULTILINE)
out = run / "output" / "trajectory.txt"
truth = run / "assets" / "truth.txt"
lines = truth.read_text().splitlines(keepends=True)


def good() -> None:
    shutil.copyfile(truth, out)


def slow() -> None:
    time.sleep(2)
    good()


def second() -> None:
    time.sleep(1)
    good()


def crash() -> None:
    sys.stdout.write("something about the map\n")
    sys.exit("cannot open the map")


def segfault() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hang() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    time.sleep(600)


def memory() -> None:
    hog = []
    while True:
        hog.append(bytearray(20_000_000))
        time.sleep(0.01)


def sleeper() -> None:
    """Leave a process that outlives its parent, in a session of its own."""
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)


def forks() -> None:
    sleeper()
    sleeper()
    good()


def nothing() -> None:
    pass


def write(what: list[str]) -> None:
    out.write_text("".join(what))


def elsewhere() -> None:
    pairs = (line.split(None, 1) for line in lines[:100])
    write([f"{float(stamp) + 1e6:.6f} {rest}" for stamp, rest in pairs])


def log() -> None:
    for _ in range(60_000):
        sys.stdout.write("x" * 1000 + "\n")
    good()


def configuration() -> None:
    assert not os.access(run / "config.yaml", os.W_OK) or os.getuid() == 0
    assert not list((run / "dataset").glob("*groundtruth*"))
    assert os.sched_getaffinity(0)
    assert os.environ["SLAMHIVE_SEED"]
    assert "SLAMHIVE_FILES" not in os.environ
    assert not (run / "files").exists()
    good()


def settings() -> None:
    files = Path(os.environ["SLAMHIVE_FILES"])
    assert files == run / "files"
    shutil.copytree(files, run / "output" / "seen")
    good()


def scored() -> None:
    """Have a score, which is best at the number 7; above 20 there is none."""
    at = int(number.group(1)) if number else 0
    if at > 20:
        crash()
    (run / "output" / "metrics.json").write_text(json.dumps({"score": (at - 7) ** 2}))
    good()


def note(event: str) -> None:
    """Add a line to the home's journal: an account of attempts that no part of slamhive keeps."""
    words = {
        "event": event,
        "run": run.parent.name,
        "time": time.monotonic(),
        "cpus": sorted(os.sched_getaffinity(0)),
        "threads": os.environ["OMP_NUM_THREADS"],
    }
    journal = os.open(run.parents[3] / "journal", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(journal, (json.dumps(words) + "\n").encode())


def noted() -> None:
    """Take as many milliseconds as the number says, beside a child that would stay."""
    note("start")
    sleeper()
    time.sleep(int(number.group(1)) / 1000 if number else 0)
    good()
    note("end")


ACTS: dict[str, Callable[[], object]] = {
    "good": good,
    "slow": slow,
    "second": second,
    "crash": crash,
    "segfault": segfault,
    "hang": hang,
    "memory": memory,
    "forks": forks,
    "nothing": nothing,
    "empty": lambda: write([]),
    "nan": lambda: write(
        [line if k % 4 else line.split()[0] + " nan" * 7 + "\n" for k, line in enumerate(lines)]
    ),
    "infinite": lambda: write([*lines[:5], "1.0 inf 0 0 0 0 0 1\n"]),
    "half": lambda: write(lines[: len(lines) * 14 // 25]),
    "elsewhere": elsewhere,
    "log": log,
    "configuration": configuration,
    "settings": settings,
    "scored": scored,
    "noted": noted,
}
ACTS[act.group(1) if act else "good"]()
