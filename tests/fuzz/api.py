# SPDX-License-Identifier: Apache-2.0
"""Ask the dashboard's API made-up questions: ``python tests/fuzz/api.py --seconds 300``.

schemathesis makes requests up from the OpenAPI document, as the document allows and as it doesn't; beside
them go query strings of the filters' own language, broken in all ways, paths that lead elsewhere, odd
headers and methods. Whatever is asked, the answer is no 5xx, one of 4xx has a sentence, and only GET and HEAD
get anything else, and no answer takes more CPU seconds or memory than an answer may. The least questions that
break this are printed, and the exit code is 1. 80,000 runs are asked for, but with --small.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient

from slamhive.dashboard.server.app import create_app
from slamhive.dashboard.sources.archived import Workstation

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1] / "bench")]

from bench_dashboard import RUNS, fill
from costs import Meter

if TYPE_CHECKING:
    from collections.abc import Callable

    from fastapi import FastAPI

EXAMPLES = 20
"""Questions of one sort before it is the next one's turn."""

FIRST = 4
"""Questions of each sort to begin with, however long they take."""

UNENDING = "/api/v1/events"
HOST = "http://127.0.0.1"
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE")
WORDS = (
    *(
        "ate.rmse",
        "algorithm",
        "-seed",
        "where",
        "coverage>=0.5",
        "algorithm == 'x'",
        "uid-000",
        "se3",
        "all",
    ),
    *(
        "%00",
        "NaN",
        "1e999",
        "-1",
        "é",
        "null",
        "json",
        "csv",
        "parquet",
        "parameters.nFeatures",
        "seed in (",
    ),
    *("../../etc/passwd", "' OR 1=1 --", "<script>", "`a b` < 3", "not not", "((((", "a" * 300, "all"),
)
NAMES = (
    *WORDS,
    *("sort", "by", "x", "y", "metric", "metrics", "limit", "after", "columns", "format", "points"),
)


@dataclass
class Tally:
    """Counts of the questions and answers of a fuzzed API, with the faults found.

    Attributes:
        asked: questions by their sort.
        statuses: answers by their status.
        faults: the least question of each fault that was found.
    """

    asked: Counter[str] = field(default_factory=Counter)
    statuses: Counter[int] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)


class FaultError(Exception):
    """An answer that must not be."""


class Fuzzer:
    """Asks an application until the time is over.

    Args:
        app: the application.
        client: asks it; server errors are answers.
        start: what the questions are made up from; the same questions for the same number.
    """

    def __init__(self, app: FastAPI, client: TestClient, start: int = 0) -> None:
        self._client = client
        self.meter = Meter(app.state.service.workers)
        self._seed = start
        self._deadline = 0.0
        self.tally = Tally()
        document = app.openapi()
        schema = schemathesis.openapi.from_dict(document)
        self._sorts: dict[str, st.SearchStrategy[Any]] = {
            path: schema[path]["GET"].as_strategy() for path in document["paths"] if path != UNENDING
        }
        self._sorts |= {"query strings": queries(list(self._sorts)), "requests": requests()}

    def run(self, seconds: float) -> Tally:
        """Ask for some time, and a few questions of each sort in any case."""
        end = time.monotonic() + seconds
        self._deadline = math.inf
        for sort, strategy in self._sorts.items():
            self._round(sort, strategy, FIRST)
        self._deadline = end
        while time.monotonic() < self._deadline and not self.tally.faults:
            self._seed += 1
            for sort, strategy in self._sorts.items():
                if time.monotonic() < self._deadline:
                    self._round(sort, strategy, EXAMPLES)
        return self.tally

    def _round(self, sort: str, strategy: st.SearchStrategy[Any], examples: int) -> None:
        @seed(self._seed)
        @settings(
            max_examples=examples,
            deadline=None,
            database=None,
            phases=(Phase.generate, Phase.shrink),
            suppress_health_check=list(HealthCheck),
        )
        @given(case=strategy)
        def ask(case: Any) -> None:
            if time.monotonic() < self._deadline:
                self._ask(sort, case)

        try:
            ask()
        except FaultError as error:
            self.tally.faults.append(f"{sort}: {error}")

    def _ask(self, sort: str, case: Any) -> None:
        self.meter.begin()
        if isinstance(case, dict):
            method, address, headers = case["method"], case["address"], case["headers"]
            answer = self._client.request(method, f"{HOST}{address}", headers=headers)
        else:
            method, address = "GET", case.formatted_path
            answer = self._client.get(address, params=case.query or {})
        self.tally.asked[sort] += 1
        self.tally.statuses[answer.status_code] += 1
        if wrong := verdict(method, answer) or self.meter.end():
            raise FaultError(f"{method} {answer.request.url} {wrong}: {answer.text[:500]}")


def verdict(method: str, answer: Any) -> str:
    """Return the fault of an answer; empty if it has none."""
    if answer.status_code >= 500 and (answer.status_code != 503 or "retry-after" not in answer.headers):
        return f"was answered {answer.status_code}"
    if method not in {"GET", "HEAD"} and answer.status_code < 400:
        return f"was answered {answer.status_code}, and only GET and HEAD may be"
    if answer.status_code >= 400 and method != "HEAD":
        try:
            told = json.loads(answer.text)["error"]
        except (ValueError, KeyError, TypeError):
            told = ""
        if not told:
            return f"was answered {answer.status_code} without a sentence"
    return ""


def queries(paths: list[str]) -> st.SearchStrategy[dict[str, Any]]:
    """Return questions of the filters' own language, and near it."""
    word = st.one_of(st.sampled_from(WORDS), st.text(max_size=30), st.floats().map(str))
    name = st.one_of(st.sampled_from(NAMES), st.text(max_size=10))
    symbol = st.sampled_from(("", "", "<", ">", "!", "<=", ">>"))
    pair = st.tuples(name, symbol, word).map(lambda one: f"{_quoted(one[0] + one[1])}={_quoted(one[2])}")
    plain = [path for path in paths if "{" not in path]
    return st.builds(
        lambda path, found: {"method": "GET", "address": f"{path}?{'&'.join(found)}", "headers": {}},
        st.sampled_from(plain),
        st.lists(pair, max_size=5),
    )


def requests() -> st.SearchStrategy[dict[str, Any]]:
    """Return requests of any method, path and headers."""
    known = ("api", "v1", "runs", "uid-000", "files", "..", "%2e%2e", "etc", "vendor", "", "x.js")
    part = st.one_of(st.sampled_from(known), st.text(max_size=12).map(_quoted))
    path = st.lists(part, max_size=7).map(lambda parts: "/" + "/".join(parts))
    header = st.sampled_from(("Accept", "If-None-Match", "Accept-Encoding", "Range", "X-Forwarded-Host"))
    content = st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=40)
    usual = st.sampled_from(("text/csv", "*/*", "gzip", "application/vnd.apache.parquet", "bytes=0-5"))
    return st.builds(
        lambda method, address, headers: {"method": method, "address": address, "headers": headers},
        st.sampled_from(METHODS),
        path.filter(lambda one: one != UNENDING),
        st.dictionaries(header, st.one_of(content, usual), max_size=3),
    )


def _quoted(text: str) -> str:
    return quote(text.encode("utf-8", "replace"), safe="")


def main() -> int:
    """Ask for the time that is given; returns the exit code."""
    parser = argparse.ArgumentParser(description="Ask the dashboard's API made-up questions.")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--runs", type=int, default=RUNS, help="runs in the archive")
    parser.add_argument("--small", action="store_true", help="few runs, of every sort")
    parser.add_argument("--start", type=int, default=int(time.time()), help="number to make them up from")
    options = parser.parse_args()
    print(f"made up from --start {options.start}", flush=True)  # noqa: T201
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        if options.small:
            url = _archive_with_runs_of_every_sort()(home)
        else:
            url = f"sqlite:///{home / 'archive.sqlite'}"
            fill(url, options.runs)
        app = create_app(Workstation(url, home))
        with TestClient(app, base_url=HOST, raise_server_exceptions=False) as client:
            client.get("/api/v1")  # the table is no question's cost
            fuzzer = Fuzzer(app, client, options.start)
            tally = fuzzer.run(options.seconds)
    statuses = ", ".join(f"{count:,} × {status}" for status, count in sorted(tally.statuses.items()))
    print(f"{tally.asked.total():,} questions of {len(tally.asked)} sorts: {statuses}")  # noqa: T201
    cpu_seconds, mib = fuzzer.meter.largest
    print(f"the costliest took {cpu_seconds:.1f} s of CPU time and {mib:.0f} MiB")  # noqa: T201
    for fault in tally.faults:
        print(fault, file=sys.stderr)  # noqa: T201
    return 1 if tally.faults else 0


def _archive_with_runs_of_every_sort() -> Callable[[Path], str]:
    """Return the function of the dashboard's tests that fills an archive in a folder."""
    place = Path(__file__).parents[1] / "dashboard" / "conftest.py"
    spec = importlib.util.spec_from_file_location("dashboard_conftest", place)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Callable[[Path], str] = module.fill_assorted
    return found


if __name__ == "__main__":
    sys.exit(main())
