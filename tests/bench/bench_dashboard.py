# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the dashboard's answers over 80,000 runs with 20 parameters and 30 metrics, beside its limits.

Each database is asked by a server process of its own over HTTP, as a browser would. An archive is warm once
a dashboard of this version has read it: the table that it made is in the home's cache, and only what differs
in the database is read again. The very first start reads nine documents of each run; it is shown beside.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
import uuid
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "archive"))

from servers import postgresql
from sqlalchemy import text

from slamhive.archive import Archive, CatalogEntry, SweepRecord, schema
from slamhive.archive.connection import open_engine, parse
from slamhive.model.results import Outcome, Phase, Reason, Result, RunRecord

RUNS = 80_000
START = datetime(2026, 1, 1, tzinfo=UTC)
STEP = 37
"""Seconds between the starts of two runs."""
TIMES = ("created", "started", "finished")
ALGORITHMS = ("orb-slam2", "orb-slam3", "vins-mono", "vins-fusion", "kiss-icp", "lio-sam", "dso", "svo")
SENSORS = ("mono", "stereo", "lidar", "rgbd")
STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "sse")
CLIENTS = 50

QUESTIONS = (
    (
        "first page, filtered and sorted",
        "runs?algorithm=orb-slam3&coverage%3E=0.5&sort=ate.rmse&limit=100",
        100,
    ),
    ("last page of all, sorted", "LAST", 100),
    ("scatter of all", "analysis/points?x=parameters.p0&y=ate.rmse&colour=algorithm", 500),
    ("leaderboard", "analysis/leaderboard", 500),
    (
        "group by algorithm and a parameter",
        "analysis/aggregate?by=algorithm,parameters.p1&metrics=ate.rmse",
        500,
    ),
    ("group by default of five figures, one dataset", "analysis/aggregate?by=algorithm,dataset", 500),
)


MANY = "by=algorithm,input.frameRate,parameters.p1,parameters.p2&parameters.p2%3C4000"
"""Competitors of which there are 192, with half of the runs."""

PICTURES = (
    (
        "small multiples: sensors by frame rate over a parameter, one dataset",
        "analysis/aggregate?by=sensors,input.frameRate,parameters.p1&metrics=ate.rmse&dataset=sequence-03",
        500,
    ),
    ("timeline of all", "analysis/timeline", 500),
    ("timeline of a part of the time, run by run", "analysis/timeline?from=1767225600&to=1767260000", 500),
    ("cumulative shares of all, an algorithm and a dataset each", "analysis/ecdf", 500),
    (
        "contours of one algorithm on one dataset",
        "analysis/surface?x=parameters.p1&y=parameters.p2&algorithm=dso&dataset=sequence-00",
        500,
    ),
    ("slices of one algorithm on one dataset", "analysis/slices?algorithm=dso&dataset=sequence-00", 1000),
    ("leaderboard of 192 competitors", f"analysis/leaderboard?{MANY}", 500),
    ("192 competitors two by two, the best of them", f"analysis/compare?{MANY}", 1000),
    ("cumulative shares of 192 competitors, the best of them", f"analysis/ecdf?{MANY}", 500),
    ("error over cost of 192 competitors", f"analysis/pareto?{MANY}", 500),
    ("runs by words", "search?words=orb-slam3+parameters+2000", 1000),
)
"""Questions of single pictures, measured one at a time; the crowd asks the above."""


def make_record(number: int) -> RunRecord:
    """Return a run as a study of many parameters leaves them, the same for the same number."""
    chance = random.Random(number)
    algorithm = ALGORITHMS[number % 8]
    dataset = f"sequence-{number // 8 % 10:02d}"
    error = 0.02 * (1 + number % 8) * (1 + number // 8 % 10) * chance.lognormvariate(0, 0.5)
    failed = chance.random() < 0.05
    started = START + timedelta(seconds=STEP * number)
    results = []
    if not failed:
        coverage = min(1.0, chance.lognormvariate(-0.05, 0.1))
        outcome = Outcome.TRACKED if coverage >= 0.9 else Outcome.PARTIAL
        errors = {name: error * (k + 1) / 3 for k, name in enumerate(STATISTICS)}
        values = {
            "alignment": "se3",
            "scale": chance.gauss(1.0, 0.01),
            "ate": errors,
            "rpe": [{"delta": 1.0, "unit": "m", "pairs": "all", "count": 1000} | errors],
            "ateRotationDeg": errors,
            "poses": 1000,
            "pathLength": 80.5,
            "transform": [[1.0, 0.0, 0.0, chance.random()] for _ in range(4)],
            "settings": "e79f14e7149b9b08",
        }
        results.append(Result(evaluation="se3", outcome=outcome, coverage=coverage, values=values))
    spec = {
        "algorithmRef": {"name": algorithm},
        "datasetRef": {"name": dataset},
        "sensors": SENSORS[number % 4],
        "parameters": {f"p{k}": chance.choice((500, 1000, 1500, 2000)) * (k + 1) for k in range(20)},
        "input": {"pace": "Lockstep", "frameRate": chance.choice((5.0, 10.0, 20.0)), "resolution": 1.0},
        "repetition": number // 8000,
        "seed": number,
    }
    wall = chance.uniform(20, 60)
    return RunRecord.model_validate(
        {
            "uid": str(uuid.UUID(int=chance.getrandbits(128), version=4)),
            "name": f"study-{number:05d}-{chance.getrandbits(32):08x}",
            "sweep": "study",
            "sweepUid": "study",
            "index": number,
            "spec": spec,
            "attributes": {"loops": number // 8 % 3, "motion": "fast" if number % 16 < 8 else "slow"},
            "phase": Phase.FAILED if failed else Phase.SUCCEEDED,
            "reason": Reason.OUT_OF_MEMORY if failed else None,
            "attempts": 1,
            "created": started,
            "started": started,
            "finished": started + timedelta(seconds=wall),
            "usage": {
                "cpu": {
                    "meanCores": 1.5,
                    "maxCores": 2.0,
                    "seconds": wall * 1.5,
                    "secondsPerDataSecond": 0.7,
                },
                "memory": {"peakBytes": chance.randrange(10**8, 10**9), "meanBytes": 1e8 * chance.random()},
                "wallSeconds": wall,
                "throttledSeconds": 0.0,
                "contendedSeconds": 0.0,
                "samples": 300,
                "source": "cgroup",
                "includesReader": False,
            },
            "frames": {"offered": 1000, "processed": 990, "dropped": 10},
            "metrics": {"loops": number % 5, "lost": 0},
            "trajectory": None
            if failed
            else {
                "poses": 1000,
                "durationSeconds": 50.0,
                "sha256": f"{chance.getrandbits(256):064x}",
                "path": "output/trajectory.txt",
            },
            "evaluations": [{"evaluation": "se3", "alignment": "se3", "settings": "bench"}],
            "results": results,
            "provenance": {
                "algorithmHash": f"hash-{spec['algorithmRef']['name']}",
                "environment": f"environment-{spec['algorithmRef']['name']}",
                "datasetSha256": f"recording-{spec['datasetRef']['name']}",
                "preparation": "3",
                "contentHash": f"{chance.getrandbits(256):064x}",
                "cpuModel": "Some Processor 3000",
                "node": f"node-{number % 12}",
                "slamhiveVersion": "0.1.0",
            },
            "folder": f"runs/{number:05d}",
        }
    )


def fill(url: str, count: int) -> None:
    """Write the runs into an archive."""
    with Archive.open(url) as archive:
        archive.put_sweep(SweepRecord(uid="study", name="study", spec={}))
        archive.put_catalog(*(CatalogEntry(kind="Algorithm", name=name, spec={}) for name in ALGORITHMS))
        archive.put_runs(make_record(number) for number in range(count))


def multiply(url: str, wanted: int) -> None:
    """Bring PostgreSQL to a number of runs: later copies, with content and trajectories of their own."""
    other = "md5(random()::text || r.id) || md5(random()::text)"
    own = {
        "id": "r.id + :shift",
        **{name: f"r.{name} + {STEP} * :shift * interval '1 second'" for name in TIMES},
        "point": "r.point + :shift",
        "uid": "gen_random_uuid()::text",
        "content_hash": "h.content",
        "name": "r.name || '-' || :shift",
        "folder": "r.folder || '-' || :shift",
        "provenance": "replace(r.provenance::text, r.content_hash, h.content)::json",
        "trajectory": """regexp_replace(r.trajectory::text, '"[0-9a-f]{64}"', '"' || h.track || '"')::json""",
    }
    names = [column.name for column in schema.runs.columns]
    into = ", ".join(f'"{name}"' for name in names)
    values = ", ".join(own.get(name, f'r."{name}"') for name in names)
    found = ", ".join(f'"{column.name}"' for column in schema.results.columns)
    copied = found.replace('"run_id"', "run_id + :shift")
    engine = open_engine(parse(url))
    with engine.begin() as connection:
        begun: int = connection.execute(text("SELECT max(id) FROM runs")).scalar_one()
        for shift in range(begun, wanted, begun):
            given = {"shift": shift, "most": min(begun, wanted - shift)}
            hashes = f"LATERAL (SELECT {other} AS content, {other} AS track) h"
            connection.execute(
                text(f"INSERT INTO runs ({into}) SELECT {values} FROM runs r, {hashes} WHERE r.id <= :most"),
                given,
            )
            connection.execute(
                text(f"INSERT INTO results ({found}) SELECT {copied} FROM results WHERE run_id <= :most"),
                given,
            )
    engine.dispose()


class Server:
    """A dashboard in a process of its own."""

    def __init__(self, url: str, home: Path) -> None:
        environment = os.environ | {"SLAMHIVE_ARCHIVE": url, "SLAMHIVE_HOME": str(home)}
        command = [sys.executable, "-m", "slamhive.cli", "dashboard", "--port", "0"]
        command[1:3] = ["-c", "from slamhive.cli.main import main; main()"]
        self.started = time.perf_counter()
        self.process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline() if self.process.stdout else ""
        self.root = f"{line.split()[2]}api/v1/"

    def get(self, question: str) -> tuple[bytes, float, Any]:
        """Ask, and return the bytes on the wire, the time in ms and the headers."""
        request = urllib.request.Request(self.root + question, headers={"Accept-Encoding": "gzip"})  # noqa: S310
        begun = time.perf_counter()
        with urllib.request.urlopen(request, timeout=120) as answer:  # noqa: S310
            content = answer.read()
            return content, (time.perf_counter() - begun) * 1e3, answer.headers

    def peak(self) -> float:
        """Return the most memory it has taken, in MiB."""
        for line in Path(f"/proc/{self.process.pid}/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) / 1024
        return float("nan")

    def close(self) -> None:
        """End it."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait(20)


def report(what: str, figure: float, unit: str, limit: float) -> None:
    """Print a figure beside its limit."""
    print(
        f"{what} · {figure:.0f} {unit} · limit {limit:g} {unit}{'' if figure < limit else ', TOO MUCH'}",
        flush=True,
    )


def fresh(question: str, turn: int) -> str:
    """Return a question that means the same and was not asked before, so that nothing remembered answers."""
    return f"{question}{'&' if '?' in question else '?'}run!=never-{turn}"


def last_page(server: Server) -> str:
    """Return the question for the page near the end of the table."""
    question = "runs?sort=-usage.wallSeconds&limit=1000&columns=uid,usage.wallSeconds&usage.wallSeconds%3C21"
    while True:
        answer = json.loads(gzip.decompress(server.get(question)[0]))
        if len(answer["items"]) < 1000 or not answer["next"]:
            return question
        question = answer["next"].removeprefix("/api/v1/")


def measure(name: str, url: str, home: Path) -> None:
    """Print all figures of one database."""
    server = Server(url, home)
    try:
        server.get("runs?limit=1")
        took = time.perf_counter() - server.started
        print(
            f"{name}: the very first start, nothing kept · {took * 1e3:.0f} ms · once an archive", flush=True
        )
        wait_for_cache(home)
        for _, question, _ in QUESTIONS:
            server.get("runs?limit=1000" if question == "LAST" else question)
        report(f"{name}: peak memory after the very first start", server.peak(), "MiB", 400)
    finally:
        server.close()
    server = Server(url, home)
    try:
        server.get("runs?limit=1")
        took = time.perf_counter() - server.started
        report(f"{name}: start to first answer, warm archive", took * 1e3, "ms", 3000)
        for what, question, limit in (*QUESTIONS, *PICTURES):
            times = []
            size = 0
            if question == "LAST":
                asked = last_page(server)
                times = [server.get(asked + f"&limit={900 + turn}")[1] for turn in range(5)]
            else:
                for turn in range(5):
                    content, took, _ = server.get(fresh(question, turn))
                    times.append(took)
                    size = len(content)
            report(f"{name}: {what}", statistics.median(times), "ms", limit)
            if what.startswith("scatter"):
                report(f"{name}: {what}, on the wire", size / 1000, "kB", 1000)
        crowd(name, server)
        report(f"{name}: peak memory", server.peak(), "MiB", 400)
    finally:
        server.close()


def wait_for_cache(home: Path) -> None:
    """Wait until the table has been kept for the next start, if it is large enough for that."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and not list(home.glob("cache/dashboard-*.npz")):
        time.sleep(0.1)


def crowd(name: str, server: Server) -> None:
    """Ask from 50 clients at once."""
    times: list[float] = []
    errors: list[str] = []

    def client(number: int) -> None:
        for turn, (_, question, _) in enumerate(QUESTIONS):
            try:
                asked = "runs?limit=100" if question == "LAST" else question
                times.append(server.get(fresh(asked, 100 + (number + turn) % 5))[1])
            except OSError as error:
                errors.append(str(error))

    threads = [threading.Thread(target=client, args=(number,)) for number in range(CLIENTS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    report(f"{name}: {CLIENTS} clients at once, errors", len(errors), "", 1)
    if times:
        report(
            f"{name}: {CLIENTS} clients at once, 95th percentile",
            sorted(times)[int(0.95 * len(times))],
            "ms",
            1000,
        )


def main() -> int:
    """Measure each database that is there."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--keep", type=Path, help="SQLite file to keep the runs in, or to find them in")
    parser.add_argument("--only", choices=("sqlite", "postgresql"))
    parser.add_argument("--copied", type=int, help="bring PostgreSQL to so many runs by copies: 1000000")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = options.keep or Path(folder) / "archive.sqlite"
        if options.only != "postgresql":
            if not file.exists():
                fill(f"sqlite:///{file}", options.runs)
            measure("SQLite", f"sqlite:///{file}", Path(folder) / "sqlite")
        if options.only != "sqlite":
            with postgresql() as server:
                if server is None:
                    print("PostgreSQL · not installed · apt-get install postgresql", flush=True)
                else:
                    fill(server.url, options.runs)
                    if options.copied:
                        multiply(server.url, options.copied)
                    measure("PostgreSQL", server.url, Path(folder) / "postgresql")
    return 0


if __name__ == "__main__":
    sys.exit(main())
