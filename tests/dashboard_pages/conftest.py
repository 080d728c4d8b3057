# SPDX-License-Identifier: Apache-2.0
"""Archives that the pages show, dashboards that serve them, and a console that stays empty."""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from browsers import poll
from slamhive.archive import Archive, CatalogEntry, SweepRecord
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LONG = "<img src=x onerror=alert(1)>" + "long " * 2000


WITH_FILES = 3
STARTED = datetime(2026, 1, 1, tzinfo=UTC)
SWEEP = {
    "template": {
        "spec": {"algorithmRef": {"name": "first"}, "datasetRef": {"name": "hall"}, "sensors": "mono"}
    },
    "matrix": [{"path": "parameters.nFeatures", "values": [500, 1000, 1500, 2000]}],
    "repetitions": 15,
}


def write_files(home: Path) -> None:
    """Write the paths and the load of the first runs, and their ground truth.

    The second run's path begins 4 s later. The third was played in real time: its program began 5 s before.
    """
    t = np.arange(200) / 10
    path = np.stack([t, np.cos(t), np.sin(t), t / 20], axis=1)
    for number in range(WITH_FILES):
        output = home / "runs" / "study" / f"run-{number:03d}" / "run" / "output"
        output.mkdir(parents=True)
        moved = path + np.array([0, 0.01, 0, 0]) * (number + 1)
        moved[:, 3] += 0.01 * (number + 1) * np.sin(7 * t)
        poses = np.hstack([moved, np.eye(4)[np.full(200, 3)]])
        np.savetxt(output / "trajectory.txt", poses[40:] if number == 1 else poses)
        load = np.stack([t, 1 + np.sin(t) ** 2, 2e8 + 1e6 * t, 1e8 + 1e6 * t], axis=1)
        header = "time_seconds,cpu_cores,memory_bytes,anonymous_bytes"
        np.savetxt(output / "usage.csv", load, delimiter=",", header=header, comments="")
        files = output.parent / "files" / "config"
        files.mkdir(parents=True)
        (files / "vins.yaml").write_text('%YAML:1.0\n---\ntopic: "<b>imu</b>"\n   data: [1.0]\n')
    played = {"dataset": {"startTime": -2.0}, "input": {"pace": "Realtime", "rate": 1.0, "start": 0.0}}
    (output.parent / "config.yaml").write_text(json.dumps(played))
    started = (STARTED + timedelta(minutes=number)).timestamp()
    rows = [f"{stamp:.1f},{started + 5 + stamp:.4f},0,0" for stamp in t]
    (output / "latency.csv").write_text("\n".join(["stamp,frame_arrival,pose_arrival,latency", *rows, ""]))
    (home / "groundtruth").mkdir()
    np.savetxt(home / "groundtruth" / "hall.txt", np.hstack([path, np.eye(4)[np.full(200, 3)]]))


def make_record(number: int) -> RunRecord:
    """Return a run of two algorithms over four numbers of features; every sixth failed without a result."""
    failed = number % 6 == 5
    error = 0.1 / (1 + number // 2 % 4) + 0.01 * (number % 2)
    result = Result(
        evaluation="sim3",
        outcome=Outcome.PARTIAL if number % 6 == 4 else Outcome.TRACKED,
        coverage=0.8 if number % 6 == 4 else 0.99,
        values={
            "alignment": "sim3",
            "scale": 1.04 if number % 2 else 0.4 + 0.01 * number,
            "transform": np.eye(4).tolist(),
            "ate": {"rmse": error, "mean": error, "median": error, "std": 0.0, "min": 0.0, "max": error},
        },
    )
    if number == 12:
        others = {
            "keyframes": {"outcome": "Tracked", "coverage": 0.99, "ate": {"rmse": 0.125}},
            "online": {"outcome": "Partial", "ate": {"rmse": 0.25}, "message": "the estimate covers 40%"},
        }
        result = result.replace(values=result.values | {"beside": others})
    spec = {
        "algorithmRef": {"name": ("first", "second")[number % 2]},
        "datasetRef": {"name": ("hall", "yard")[number // 8 % 2]},
        "sensors": ("mono", "stereo")[number % 2],
        "parameters": {"nFeatures": 500 * (1 + number // 2 % 4), "note": LONG},
        "input": {"pace": "Lockstep", "frameRate": 10.0, "resolution": 1.0},
        "repetition": number // 16,
        "seed": number,
    }
    # Runs of the original system have numbers for names, beside own ones that have words.
    labels = {"camera": ("front", "back")[number // 4 % 2]} | ({"run": "57"} if number == 20 else {})
    finished = STARTED + timedelta(minutes=number)
    return RunRecord.model_validate(
        {
            "uid": f"run-{number:03d}",
            "name": LONG[:9000] if number == 2 else f"<b>run</b> {number}",
            "sweep": "study",
            "index": number,
            "spec": spec,
            "phase": Phase.FAILED if failed else Phase.SUCCEEDED,
            "reason": Reason.OUT_OF_MEMORY if failed else None,
            "message": LONG if failed else None,
            "attempts": 1,
            "created": finished,
            "started": finished,
            "finished": finished,
            "usage": {
                "cpu": {
                    "meanCores": 1.0 + number % 4,
                    "maxCores": 2.0,
                    "seconds": (60.0, 66.0)[number // 16 % 2],
                },
                "memory": {"peakBytes": 2**28 + number, "meanBytes": 1e8},
                "wallSeconds": 60.0,
                "samples": 30,
                "source": "cgroup",
                "includesReader": False,
            },
            "metrics": {"loops": number % 5, "ratio": float("nan"), "largest": float("inf"), "keyframes": 12},
            "labels": labels,
            "results": [] if failed else [result],
            "folder": f"runs/study/run-{number:03d}" if number < WITH_FILES else None,
            "provenance": {"contentHash": f"{number:064x}", "slamhiveVersion": "0.1.0", "cpuModel": "P"}
            | {"node": f"node-{number // 16 % 2}", "machine": {"governor": "performance"}},
        }
    )


@pytest.fixture(scope="session")
def archive_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An archive of 48 runs, in a home with the files of some."""
    home = tmp_path_factory.mktemp("home")
    write_files(home)
    url = f"sqlite:///{home / 'archive.sqlite'}"
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="study", name="study", spec=SWEEP))
        archive.put_catalog(
            *(CatalogEntry(kind="Algorithm", name=name, spec={}) for name in ("first", "second"))
        )
        archive.put_runs(map(make_record, range(48)))
    return url


@contextlib.contextmanager
def serving(url: str, log: Path) -> Iterator[str]:
    """Serve an archive and give the address."""
    home = Path(url.removeprefix("sqlite:///")).parent
    environment = os.environ | {"SLAMHIVE_HOME": str(home), "SLAMHIVE_ARCHIVE": url}
    command = [sys.executable, "-c", "from slamhive.cli.main import main; main()", "dashboard", "--port", "0"]
    with log.open("w") as written:
        process = subprocess.Popen(command, env=environment, stdout=written, stderr=subprocess.STDOUT)
    try:
        found = poll(lambda: re.search(r"http://127\.0\.0\.1:\d+", log.read_text()), "the dashboard")
        yield found[0]
    finally:
        process.terminate()
        process.wait(50)


@pytest.fixture(scope="session")
def site(archive_url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a dashboard over the archive."""
    pytest.importorskip("fastapi")
    with serving(archive_url, tmp_path_factory.mktemp("served") / "log.txt") as address:
        yield address


@pytest.fixture(scope="session")
def serve() -> Callable[[str, Path], contextlib.AbstractContextManager[str]]:
    """Serves an archive as ``with`` begins, and gives the address."""
    pytest.importorskip("fastapi")
    return serving


@pytest.fixture
def empty_site(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """The address of a dashboard over an archive that holds nothing, and the archive's."""
    pytest.importorskip("fastapi")
    url = f"sqlite:///{tmp_path / 'archive.sqlite'}"
    Archive.open(url).close()
    with serving(url, tmp_path / "log.txt") as address:
        yield address, url


@pytest.fixture(scope="session")
def make_run() -> Callable[[int], RunRecord]:
    """Return the function that makes runs."""
    return make_record


@pytest.fixture(autouse=True)
def quiet(request: pytest.FixtureRequest) -> Iterator[None]:
    """After a test, nothing was written to the console that the test did not take away."""
    if "browser" not in request.fixturenames:
        yield
        return
    browser = request.getfixturevalue("browser")
    browser.call("Page.navigate", url="about:blank")
    browser.complaints.clear()
    yield
    browser.run("1")
    assert [one for one in browser.complaints if "ERR_NETWORK_CHANGED" not in one] == []
