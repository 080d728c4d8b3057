# SPDX-License-Identifier: Apache-2.0
"""An algorithm with the standard library alone that keeps the contract, or breaks it where its text says so.

Its poses are the ground truth's. `BREAKS` is replaced by what it does wrong.
"""

import os
import re
import signal
import sys
import time
from pathlib import Path

BREAKS = set()  # what it does wrong
run = Path(os.environ["SLAMHIVE_RUN"])
config = (run / "config.yaml").read_text()
recording = (run / "dataset" / "recording.bag").read_bytes()
truth = (run / "assets" / "truth.txt").read_text().splitlines(keepends=True)
rate = re.search(r"^  size: (\d+)$", config, re.MULTILINE)
settings = run / "files" / "settings.txt"

if "deaf" in BREAKS:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
if "unread" not in BREAKS and settings.exists():
    settings.read_text()
if b"topic=/points" not in recording:
    if "waits" in BREAKS:
        time.sleep(600)
    sys.exit("the recording has no topic /points")
if len(recording) < 20_000:
    if "crashes" in BREAKS:
        os.kill(os.getpid(), signal.SIGSEGV)
    sys.exit("the recording has no scan on /points")
output = run / "output"
if "half" in BREAKS:
    truth = truth[: len(truth) // 2]
if "differs" in BREAKS:
    noise = time.monotonic_ns() % 1_000_003 / 1e9
    rows = [line.split() for line in truth]
    truth = [" ".join([row[0], str(float(row[1]) + noise), *row[2:]]) + "\n" for row in rows]
if "never" in BREAKS:
    sys.exit("the licence has run out")
with (output / "trajectory.txt").open("w") as file:
    for line in truth:
        file.write(line)
        file.flush()
    (output / "begun").touch()
    if "slow" in BREAKS:
        time.sleep(600)
