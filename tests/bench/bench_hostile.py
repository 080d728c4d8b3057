# SPDX-License-Identifier: Apache-2.0
"""A thousand hostile requests from 20 clients while 20 honest ones ask, over 80,000 runs.

The dashboard is held to 512 MiB and 2 CPUs, as the chart does, by a cgroup where one can be made. It must not
end, answer 5xx other than 503, or keep honest clients waiting: their 95th percentile is at most 2 s.
"""

from __future__ import annotations

import argparse
import gzip
import http.client
import json
import os
import random
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote, urlsplit

from bench_dashboard import ALGORITHMS, RUNS, Server, fill, make_record, report, wait_for_cache

if TYPE_CHECKING:
    from collections.abc import Iterator

CLIENTS = 20
MEMORY_MIB = 512
CPUS = 2
THINKING_SECONDS = (0.2, 1.5)
"""Time for which an honest client looks at an answer before it asks again."""

GROUPS = Path("/sys/fs/cgroup")


def traps() -> list[str]:
    """Return questions that were found to stop or kill the dashboard, and more of the kind."""
    uid = make_record(0).uid
    nines = ",".join(["9"] * 3900)
    compared = " or ".join(
        f"{a} < {b}" for a in ("uid", "name", "run") for b in ("name", "uid") for _ in range(60)
    )
    return [
        f"runs?where={'1' * 9990}x",
        f"runs?where=run=={'1' * 5000}",
        f"runs?limit=1&where={quote(f'seed in ({nines})')}",
        f"runs?limit=1&where={quote(compared)}",
        f"runs?limit=1&where={quote('(' * 3000 + '1' + ')' * 3000)}",
        "analysis/leaderboard?by=id",
        "analysis/leaderboard?by=uid,name&outcomes=all",
        "analysis/pareto?by=id",
        "analysis/compare?by=id",
        "analysis/aggregate",
        "analysis/aggregate?by=id&metrics=ate.rmse,scale,coverage,usage.wallSeconds",
        "analysis/repeatability?metric=seed",
        "analysis/importance?metric=seed",
        "analysis/points?x=uid&y=name&colour=provenance.contentHash&size=seed&facet=trajectory.sha256",
        "analysis/points?x=uid&y=name&format=csv",
        "analysis/common",
        "analysis/versions?metric=seed",
        "runs?sort=uid,name,provenance.contentHash&limit=1000",
        "runs?format=csv&columns=COLUMNS",
        "runs?format=parquet&columns=COLUMNS",
        "runs?limit=1000&columns=COLUMNS",
        "columns",
        f"runs/{uid}/trajectory",
        f"runs/{uid}/usage",
        "SILENCE",
        "HALF",
        "LEAVE",
    ]


def made_up(chance: random.Random) -> str:
    """Return a question near the language of the filters."""
    words = (
        "ate.rmse",
        "uid",
        "seed",
        "null",
        "1e999",
        "'x'",
        "%00",
        "x" * 300,
        "((((",
        "not not",
        "-1",
        "all",
    )
    names = (
        "sort",
        "by",
        "x",
        "y",
        "metric",
        "metrics",
        "limit",
        "columns",
        "format",
        "where",
        "uid",
        "seed>",
    )
    paths = ("runs", "columns", "sweeps", "algorithms", *(f"analysis/{one}" for one in ANALYSES))
    asked = "&".join(
        f"{quote(chance.choice(names))}={quote(chance.choice(words))}" for _ in range(chance.randrange(5))
    )
    return f"{chance.choice(paths)}?{asked}"


ANALYSES = (
    "points",
    "aggregate",
    "leaderboard",
    "compare",
    "pareto",
    "importance",
    "repeatability",
    "suspects",
)


def honest(chance: random.Random) -> str:
    """Return a question of somebody who looks at the pages."""
    algorithm, dataset = chance.choice(ALGORITHMS), f"sequence-{chance.randrange(10):02d}"
    return chance.choice(
        (
            "",
            "sweeps",
            "algorithms",
            "columns",
            "analysis/leaderboard",
            f"analysis/leaderboard?dataset={dataset}",
            f"runs?algorithm={algorithm}&sort=ate.rmse&limit=100",
            f"runs?dataset={dataset}&coverage%3E=0.5&limit=100",
            f"analysis/points?x=parameters.p0&y=ate.rmse&colour=algorithm&dataset={dataset}",
            f"analysis/aggregate?by=algorithm,parameters.p1&metrics=ate.rmse&dataset={dataset}",
            f"analysis/aggregate?by=algorithm&metrics=ate.rmse&dataset={dataset}",
            f"analysis/pareto?dataset={dataset}",
        )
    )


class Crowd:
    """Clients, and what became of their questions.

    Args:
        server: who is asked.
        one_address: whether all come from one address, as by way of an ingress.
    """

    def __init__(self, server: Server, *, one_address: bool) -> None:
        found = urlsplit(server.root)
        self._place = found.hostname or "", found.port or 0
        self._one_address = one_address
        self._columns = ""
        self.times: list[float] = []
        self.statuses: dict[str, Counter[int | str]] = {"honest": Counter(), "hostile": Counter()}
        self.slowest: list[tuple[float, str]] = []
        self.hostile_left = 0
        self._lock = threading.Lock()

    def ask(self, question: str, address: str, *, keep: bool = False) -> tuple[int, bytes]:
        """Ask from an address; what is large is not kept."""
        source = None if self._one_address else (address, 0)
        connection = http.client.HTTPConnection(*self._place, timeout=120, source_address=source)
        try:
            connection.request("GET", f"/api/v1/{question}".rstrip("/"), headers={"Accept-Encoding": "gzip"})
            answer = connection.getresponse()
            if keep:
                return answer.status, answer.read()
            while answer.read(2**20):
                pass
            return answer.status, b""
        finally:
            connection.close()

    def learn(self, columns: list[str]) -> None:
        """Take the names of all columns."""
        self._columns = ",".join(columns)

    def be_hostile(self, number: int, requests: int) -> None:
        """Ask for what costs most, in any order."""
        chance = random.Random(number)
        address = f"127.0.1.{number + 1}"
        known = traps()
        for _ in range(requests):
            question = chance.choice(known) if chance.random() < 0.6 else made_up(chance)
            status: int | str
            try:
                status = self._attack(question.replace("COLUMNS", self._columns), address)
            except (OSError, http.client.HTTPException) as error:
                status = type(error).__name__
            with self._lock:
                self.statuses["hostile"][status] += 1
        with self._lock:
            self.hostile_left -= 1

    def _attack(self, question: str, address: str) -> int | str:
        if question not in {"SILENCE", "HALF", "LEAVE"}:
            return self.ask(question, address)[0]
        source = ("", 0) if self._one_address else (address, 0)
        with socket.create_connection(self._place, 30, source_address=source) as connection:
            if question == "LEAVE":
                line = (
                    f"GET /api/v1/runs?format=csv&columns={self._columns} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
                )
                connection.sendall(line.encode())
                connection.recv(4096)
                return "left"
            if question == "HALF":
                connection.sendall(b"GET /api/v1 HTTP/1.1\r\nX-a: ")
            with suppress(ConnectionResetError):
                connection.recv(1)
        return "closed"

    def be_honest(self, number: int) -> None:
        """Ask as people do, for as long as there are hostile ones."""
        chance = random.Random(1000 + number)
        while self.hostile_left:
            question = honest(chance)
            begun = time.perf_counter()
            status: int | str
            try:
                status = self.ask(question, f"127.0.2.{number + 1}")[0]
            except (OSError, http.client.HTTPException) as error:
                status = type(error).__name__
            took = time.perf_counter() - begun
            with self._lock:
                self.times.append(took)
                self.slowest = sorted([*self.slowest, (took, question)], reverse=True)[:5]
                self.statuses["honest"][status] += 1
            time.sleep(chance.uniform(*THINKING_SECONDS))


def run(server: Server, requests: int, *, one_address: bool) -> bool:
    """Let them all ask; returns whether nothing went wrong."""
    crowd = Crowd(server, one_address=one_address)
    _, content = crowd.ask("columns", "127.0.0.1", keep=True)
    crowd.learn([item["name"] for item in json.loads(_plain(content))["items"]])
    crowd.hostile_left = CLIENTS
    peak = Peak(server.process.pid)
    threads = [
        threading.Thread(target=crowd.be_hostile, args=(k, requests // CLIENTS)) for k in range(CLIENTS)
    ]
    threads += [threading.Thread(target=crowd.be_honest, args=(k,)) for k in range(CLIENTS)]
    begun = time.monotonic()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    peak.stop()
    for who, statuses in crowd.statuses.items():
        shown = ", ".join(f"{count:,} × {status}" for status, count in statuses.most_common())
        print(
            f"{who}: {statuses.total():,} requests in {time.monotonic() - begun:.0f} s: {shown}", flush=True
        )
    times = sorted(crowd.times)
    report("honest: median", 1e3 * times[len(times) // 2], "ms", 1000)
    report("honest: 95th percentile", 1e3 * times[int(0.95 * len(times))], "ms", 2000)
    for took, question in crowd.slowest:
        print(f"honest: one of the slowest · {took:.1f} s · {question}", flush=True)
    report("memory of all its processes at most, pages shared counted once", peak.mib, "MiB", MEMORY_MIB)
    ended = server.process.poll()
    faults = [
        s for found in crowd.statuses.values() for s in found if isinstance(s, int) and s >= 500 and s != 503
    ]
    refused = sum(count for status, count in crowd.statuses["honest"].items() if status != 200)
    print(
        f"it {'runs on' if ended is None else f'ended with {ended}'}; honest ones refused: {refused}",
        flush=True,
    )
    return ended is None and not faults and times[int(0.95 * len(times))] <= 2.0


def _plain(content: bytes) -> bytes:
    return gzip.decompress(content) if content[:2] == b"\x1f\x8b" else content


class Peak:
    """Watches what the processes of a tree have in memory together.

    Args:
        pid: the first process.
    """

    def __init__(self, pid: int) -> None:
        self.mib = 0.0
        self._pid = pid
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def stop(self) -> None:
        """Look no longer."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(0.25):
            with suppress(OSError):
                children = Path(f"/proc/{self._pid}/task/{self._pid}/children").read_text().split()
                self.mib = max(self.mib, sum(_share(int(pid)) for pid in [self._pid, *children]))


def _share(pid: int) -> float:
    """Return a process's share of what is in memory, MiB."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024
    return 0.0


@contextmanager
def held() -> Iterator[list[Path]]:
    """Make cgroups of the chart's limits, where that can be done; gives their folders."""
    name = f"slamhive-hostile-{os.getpid()}"
    if (GROUPS / "cgroup.controllers").exists():
        settings = {
            GROUPS / name: {"memory.max": str(MEMORY_MIB * 2**20), "cpu.max": f"{CPUS * 100_000} 100000"}
        }
    else:
        settings = {
            GROUPS / "memory" / name: {"memory.limit_in_bytes": str(MEMORY_MIB * 2**20)},
            GROUPS / "cpu" / name: {"cpu.cfs_quota_us": str(CPUS * 100_000)},
        }
    made: list[Path] = []
    try:
        for folder, values in settings.items():
            folder.mkdir()
            made.append(folder)
            for key, value in values.items():
                (folder / key).write_text(value)
        print(f"held to {MEMORY_MIB} MiB and {CPUS} CPUs by a cgroup", flush=True)
    except OSError as error:
        print(f"no cgroup can be made here ({error.strerror}): memory is measured, not held", flush=True)
    try:
        yield made
    finally:
        for folder in made:
            with suppress(OSError):
                print(f"processes killed for memory: {_killed(folder)}", flush=True)
            folder.rmdir()


def _killed(folder: Path) -> str:
    name = "memory.events" if (folder / "memory.events").exists() else "memory.oom_control"
    lines = (line.split() for line in (folder / name).read_text().splitlines())
    return next(value for key, value in lines if key == "oom_kill")


def enter(folders: list[Path], *, leave: bool = False) -> None:
    """Put this process, and those that it starts from now on, into cgroups, or out of them again."""
    for folder in folders:
        place = folder.parent if leave else folder
        (place / "cgroup.procs").write_text(str(os.getpid()))


def fill_home(home: Path) -> None:
    """Write the files of one run as a hostile algorithm would: large ones, and one that explodes."""
    output = home / "runs" / "runs" / "00000" / "output"
    output.mkdir(parents=True, exist_ok=True)
    with (output / "trajectory.txt").open("w") as file:
        file.writelines(f"{k / 1000} {k % 7} {k % 11} {k % 13} 0 0 0 1\n" for k in range(1_000_000))
    lines = ["a0: &a0 [0,0,0,0,0,0,0,0,0,0]"]
    lines += [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 9)]
    (output.parent / "config.yaml").write_text("\n".join([*lines, "mode: lidar", "sensors: *a8"]) + "\n")
    (output.parent / "usage.csv").write_text(
        "time_seconds,cpu_cores,resident_bytes\n" + "1,1,1\n" * 3_000_000
    )


def main() -> int:
    """Start a dashboard and let them ask; returns the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--keep", type=Path, help="SQLite file to keep the runs in, or to find them in")
    parser.add_argument("--one-address", action="store_true", help="all from one address, as by an ingress")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        file = options.keep or home / "archive.sqlite"
        if not file.exists():
            fill(f"sqlite:///{file}", options.runs)
        fill_home(home)
        first = Server(f"sqlite:///{file}", home)  # the table is kept, as by the pod's volume
        first.get("runs?limit=1")
        wait_for_cache(home)
        first.close()
        with held() as folders:
            enter(folders)
            server = Server(f"sqlite:///{file}", home)
            enter(folders, leave=True)
            try:
                return 0 if run(server, options.requests, one_address=options.one_address) else 1
            finally:
                server.close()


if __name__ == "__main__":
    sys.exit(main())
