# SPDX-License-Identifier: Apache-2.0
"""Every view of the results as a user has it: the commands, the API, the report, LaTeX and data frames.

Each is asked from outside, and what it shows becomes records of one shape:

rows        ``{column: value}``
groups      ``{"keys", "runs", "n", "failures", "figures", "coverage"}``, figures by metric and part
boards      ``{"facets", "entries"}``, an entry ``{"keys", "rank", "score", "runs", "n", "standings"}``

What a view does not show is not in its records.
"""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import math
import os
import re
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import TYPE_CHECKING, Any, Self
from unittest.mock import patch

import archives
from starlette.testclient import TestClient
from typer.main import get_command

import slamhive
from slamhive.cli.main import app
from slamhive.dashboard.answering.workers import AnswerBudget, AnswerLimits
from slamhive.dashboard.server.app import application
from slamhive.dashboard.server.service import Service
from slamhive.dashboard.sources.archived import Workstation
from slamhive.model.errors import SlamHiveError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from archives import Tables
    from reckoning import Question

    Record = dict[str, Any]

PARTS = ("n", "mean", "std", "median", "min", "max")
SHOWN = ("uid", "evaluation", "alignment", "outcome", "coverage", "phase", "reason", "ate.rmse")
"""Columns that are asked for where rows are listed."""

_COMMAND = get_command(app)
_DIGITS = ".5f"
_PAGE = 7


class CommandError(Exception):
    """A command or an address that answers with a complaint."""


class Views:
    """The project on one archive after the other.

    Args:
        home: a folder; its file ``archive.sqlite`` is the archive.
    """

    def __init__(self, home: Path) -> None:
        self.home = home
        self._source = _Source(Workstation(f"sqlite:///{home / 'archive.sqlite'}"))
        # Answers are judged here, not how long a busy machine makes them wait: CPU time stays bounded.
        limits = AnswerLimits(answer=AnswerBudget(seconds=600.0), waiting_seconds=600.0)
        asked: Any = application(Service(self._source, limits))
        self._client = TestClient(asked, base_url="http://127.0.0.1", raise_server_exceptions=False)

    def __enter__(self) -> Self:
        self._client.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._client.__exit__(None, None, None)

    def write(self, tables: Tables) -> None:
        """Put another archive in the place of the one before."""
        if self._client.portal is not None:
            self._client.portal.call(self._source.now.stop)
        archives.write(tables, self.home / "archive.sqlite")
        self._source.now = Workstation(f"sqlite:///{self.home / 'archive.sqlite'}")

    def command(self, *words: str) -> str:
        """Return the output of a ``slamhive`` command, called in this process."""
        stream, complaints = io.StringIO(), io.StringIO()
        environment = {"SLAMHIVE_HOME": str(self.home), "SLAMHIVE_ARCHIVE": ""}
        with patch.dict(os.environ, environment), redirect_stdout(stream), redirect_stderr(complaints):
            try:
                code = _COMMAND.main(list(words), "slamhive", standalone_mode=False)
            except SlamHiveError as error:
                raise CommandError(f"slamhive {' '.join(words)}: {error}") from None
        if code:
            raise CommandError(f"slamhive {' '.join(words)}: {code} {complaints.getvalue()[-300:]}")
        return stream.getvalue()

    def shell(self, *words: str) -> str:
        """Return the output of a ``slamhive`` command, called as a program."""
        command = [sys.executable, "-c", "from slamhive.cli.main import main; main()", *words]
        environment = os.environ | {"SLAMHIVE_HOME": str(self.home), "SLAMHIVE_ARCHIVE": ""}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise CommandError(f"slamhive {' '.join(words)}: {done.stderr[-300:]}")
        return done.stdout

    def get(self, path: str, pairs: Iterable[tuple[str, str]] = ()) -> Any:
        """Return the JSON that the API answers."""
        address = path if path.startswith("/api/") else f"/api/v1/{path}"
        answer = self._client.get(address, params=list(pairs) or None)
        if answer.status_code != 200:
            raise CommandError(f"{answer.url}: {answer.status_code} {answer.text[:300]}")
        return answer.json()

    def ask(self, address: str) -> None:
        """Ask for an address, and be content with everything but a failure of the dashboard's own."""
        answer = self._client.get(address)
        if answer.status_code >= 500:
            raise CommandError(f"{answer.url}: {answer.status_code} {answer.text[:300]}")

    def csv(self, path: str, pairs: Iterable[tuple[str, str]] = ()) -> list[Record]:
        """Return the CSV that the API answers."""
        answer = self._client.get(f"/api/v1/{path}", params=[*pairs, ("format", "csv")])
        if answer.status_code != 200:
            raise CommandError(f"{answer.url}: {answer.status_code} {answer.text[:300]}")
        return read_csv(answer.text)

    # Rows

    def listed(self, question: Question) -> list[Record]:
        """Return the rows of ``slamhive results list``."""
        words = ("results", "list", *chosen(question), "--columns", ",".join(SHOWN), "--format", "json")
        return list(json.loads(self.command(*words)))

    def exported(self, question: Question, form: str = "json") -> list[Record]:
        """Return the rows of ``slamhive results export``."""
        reused = ["--reused"] if question.reused else []
        text = self.command("results", "export", *chosen(question), *reused, "--format", form)
        return list(json.loads(text)) if form == "json" else read_csv(text)

    def framed(self, question: Question, library: str) -> list[Record]:
        """Return the rows of ``slamhive.results``."""
        given: Record = {"where": where(question), "evaluation": question.evaluation, "frame": library}
        options: Record = {name: True for name in ("superseded", "reused") if getattr(question, name)}
        options |= {"sweep": list(question.sweeps) or None, "columns": [*SHOWN, "status"]}
        with warnings.catch_warnings(action="ignore"):  # that none is meant
            found = slamhive.results(self.home, **given, **options)
        rows = found.to_dict("records") if library == "pandas" else found.to_dicts()
        return [{name: _known(value) for name, value in row.items()} for row in rows]

    def paged(self, question: Question) -> list[Record]:
        """Return the rows of ``/api/v1/runs``, page by page."""
        pairs = [*filters(question), ("columns", ",".join([*SHOWN, "status"])), ("limit", str(_PAGE))]
        answer = self.get("runs", pairs)
        rows = list(answer["items"])
        while answer["next"]:
            answer = self.get(answer["next"])
            rows += answer["items"]
        return rows

    def points(self, question: Question) -> list[Record]:
        """Return the rows of ``/api/v1/analysis/points``."""
        axes = [("x", "coverage"), ("y", "ate.rmse"), ("colour", "evaluation")]
        found = self.get("analysis/points", [*filters(question), *axes])
        evaluations = _decoded(found["axes"]["colour"])
        columns = (
            *(found["uid"], _decoded(found["status"]), evaluations),
            *(_decoded(found["axes"]["x"]), _decoded(found["axes"]["y"])),
        )
        names = ("uid", "status", "evaluation", "coverage", "ate.rmse")
        return [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]

    # Groups

    def table(self, question: Question, form: str = "json") -> list[Record]:
        """Return the groups of ``slamhive results table``."""
        text = self.command("results", "table", *chosen(question), *_table_words(question), "--format", form)
        rows = json.loads(text) if form == "json" else read_csv(text)
        return [_group(row, question) for row in rows]

    def printed(self, question: Question) -> list[Record]:
        """Return the groups of ``slamhive results table`` as Markdown, numbers as texts, without keys."""
        words = list(_table_words(question))
        for place, word in enumerate(words):
            if words[place - 1] == "--metric":
                words[place] = f"{word}:{_DIGITS}"
        text = self.command("results", "table", *chosen(question), *words, "--format", "markdown")
        headings, _, *lines = [
            line.strip("|").split(" | ") for line in text.splitlines() if line.startswith("|")
        ]
        headings = [heading.strip() for heading in headings]
        count, behind = len(question.metrics), len(headings) - headings.index("coverage")
        groups = []
        for line in lines:
            cells = [cell.strip() for cell in line]
            shown = dict(zip(headings, cells, strict=True))
            figures = {}
            for metric, cell in zip(question.metrics, cells[-behind - count :], strict=False):
                mean, _, std = cell.partition(" ± ")
                figures[metric] = {"mean": mean, "std": std or None}
            failures, _, untracked = shown["failures"].partition("; in n: ")
            groups.append(
                {
                    "n": int(shown["n"].removesuffix(" =")),
                    "repeating": shown["n"].endswith(" ="),
                    "failures": _words(failures),
                    "untracked": _words(untracked),
                    "figures": figures,
                }
            )
        return groups

    def aggregate(self, question: Question, *, flat: bool = False) -> list[Record]:
        """Return the groups of ``/api/v1/analysis/aggregate``, from its JSON or its CSV."""
        pairs = [*filters(question), ("metrics", ",".join(question.metrics))]
        pairs += [("outcomes", question.outcomes)]
        pairs += [] if question.by is None else [("by", ",".join(question.by))]
        if flat:
            return [_group(row, question) for row in self.csv("analysis/aggregate", pairs)]
        return [_cell(group) for group in self.get("analysis/aggregate", pairs)["groups"]]

    def left_out(self, question: Question) -> tuple[int, int]:
        """Return the numbers of runs ``/api/v1/analysis/aggregate`` leaves out: superseded, equal ones."""
        notes = " ".join(self.get("analysis/aggregate", filters(question))["notes"])
        said = (
            r"([\d,]+) runs? of earlier versions left out",
            r"([\d,]+) runs? repeats? the content of others",
        )
        found = [re.search(pattern, notes) for pattern in said]
        counts = [int(match[1].replace(",", "")) if match else 0 for match in found]
        return counts[0], counts[1]

    def repeated(self, question: Question) -> list[Record]:
        """Return the groups of ``/api/v1/analysis/repeatability``."""
        metric = question.metrics[0]
        found = self.get("analysis/repeatability", [*filters(question), ("metric", metric)])
        return [_cell(group | {"figures": {metric: group["figure"]}}) for group in found["groups"]]

    def paper(self, question: Question, *, columns: str = "dataset", median: bool = False) -> list[Record]:
        """Return the places of ``slamhive paper-table --format csv``."""
        text = self.command("paper-table", *self._paper_words(question, columns, median), "--format", "csv")
        groups = []
        for row in read_csv(text):
            figures: dict[str, Any] = {}
            for metric in question.metrics:
                heading = next(name for name in row if name.partition(" [")[0] == metric)
                factor = _FACTORS.get(heading.removeprefix(metric).strip(" []"), 1.0)
                value = _number(row.pop(heading))
                part = "median" if median else "mean"
                figures[metric] = {part: None if value is None else value / factor}
                for name in ("min", "max") if median else ("std",):
                    spread = _number(row.pop(f"{heading} {name}", ""))
                    if spread is not None or name == "std":
                        figures[metric][name] = None if spread is None else spread / factor
            failures = json.loads(row.pop("failures.by"))
            runs, n, copies, total = (int(row.pop(name)) for name in ("runs", "n", "copies", "failures"))
            row.pop("untracked", None)
            row.pop("untracked.by", None)
            group = {"keys": row, "runs": runs, "n": n, "failures": failures, "figures": figures}
            group["copies"] = copies
            groups.append(group | {"total": total})
        return groups

    def latex(self, question: Question, *, columns: str = "dataset") -> list[Record]:
        """Return the places of ``slamhive paper-table`` in LaTeX, numbers as texts."""
        return read_latex(self.command("paper-table", *self._paper_words(question, columns)), question)

    def _paper_words(self, question: Question, columns: str, median: bool = False) -> list[str]:
        rows = [name for name in question.by or ("algorithm", "sensors") if name != columns]
        words = [*chosen(question), "--rows", ",".join(rows), "--columns", columns, "--spread"]
        words += ["--outcomes", question.outcomes, *(["--statistic", "median"] if median else [])]
        for metric in question.metrics:
            words += ["--metric", f"{metric}:{_DIGITS}"]
        return words

    # Boards and what is made of them

    def leaderboard(self, question: Question) -> list[Record]:
        """Return the boards of ``/api/v1/analysis/leaderboard``."""
        found = self.get("analysis/leaderboard", _ranking(question))
        return [
            {
                "facets": board["facets"],
                "entries": [
                    {
                        **{name: entry[name] for name in ("keys", "rank", "score", "runs", "n")},
                        "standings": [
                            standing | {"figure": standing["summary"]} for standing in entry["datasets"]
                        ],
                    }
                    for entry in board["entries"]
                ],
            }
            for board in found["boards"]
        ]

    def compared(self, question: Question) -> list[Record]:
        """Return the pairs of ``/api/v1/analysis/compare``: facets, a, b, and their medians by dataset."""
        found = self.get("analysis/compare", _ranking(question))
        return [{"facets": board["facets"], **pair} for board in found["boards"] for pair in board["pairs"]]

    def fronts(self, question: Question, cost: str) -> list[Record]:
        """Return the points of ``/api/v1/analysis/pareto`` with their facets."""
        pairs = [pair for pair in _ranking(question) if pair[0] != "metric"]
        found = self.get("analysis/pareto", [*pairs, ("x", cost), ("y", question.metrics[0])])
        return [
            {"facets": front["facets"], **point} for front in found["fronts"] for point in front["points"]
        ]

    def subjects(self, question: Question) -> list[Record]:
        """Return the subjects of ``/api/v1/analysis/importance``."""
        pairs = [*filters(question), ("metric", question.metrics[0])]
        return list(self.get("analysis/importance", pairs)["subjects"])

    def report(self, question: Question, analysis: str = "none") -> Report:
        """Return the page that ``slamhive report`` writes."""
        words = ["report", *chosen(question), "--metric", question.metrics[0], "--analysis", analysis]
        words += ["--by", ",".join(question.competitors), "--outcomes", question.outcomes]
        return Report.read(self.command(*words, "-o", "-"))


_FACTORS = {"MiB": 2.0**-20}


class _Source:
    """The archive that the API's application is asked of at present."""

    def __init__(self, now: Workstation) -> None:
        self.now = now

    def __getattr__(self, name: str) -> Any:
        return getattr(self.now, name)


@dataclass(frozen=True)
class Report:
    """A report's page.

    Attributes:
        files: the tables that it lets one save, by name.
        tables: the tables that it shows: headings, then lines of texts, by the name of their file.
    """

    files: dict[str, list[Record]] = field(default_factory=dict)
    tables: dict[str, list[list[str]]] = field(default_factory=dict)

    @classmethod
    def read(cls, page: str) -> Self:
        """Read a page."""
        files = {}
        link = re.compile(r'href="data:text/csv;charset=utf-8;base64,([^"]*)" download="([^"]*)\.csv"')
        for content, name in link.findall(page):
            text = base64.b64decode(html.unescape(content)).decode()
            files[html.unescape(name)] = read_csv(text)
        reader = _Tables()
        reader.feed(page)
        return cls(files, reader.tables)

    def boards(self) -> list[Record]:
        """Return its leaderboards."""
        found = []
        for name, rows in self.files.items():
            if not name.startswith("leaderboard-"):
                continue
            entries: dict[str, Record] = {}
            for row in rows:
                keys = {key: row[key] for key in list(row)[: list(row).index("rank")]}
                entry = entries.setdefault(
                    json.dumps(keys),
                    {"keys": keys, "rank": row["rank"], "score": row["score"], "standings": []},
                )
                standing = {
                    **{key: row[key] for key in ("dataset", "runs", "coverage")},
                    "failures": json.loads(row["failures"]),
                    "median": row["median.censored"],
                    "rank": row["dataset.rank"],
                    "figure": {part: row[f"figure.{part}"] for part in PARTS},
                }
                entry["standings"].append(standing)
            found.append({"facets": {}, "entries": list(entries.values())})
        return found

    def groups(self, question: Question) -> list[Record]:
        """Return the groups of its first analysis."""
        groups = []
        for row in self.files["analysis-1"]:
            figures = {
                metric: {part: _number(row.pop(f"{metric}.{part}")) for part in PARTS}
                for metric in question.metrics[:1]
            }
            coverage = {part: _number(row.pop(f"coverage.{part}")) for part in PARTS}
            failures, runs = json.loads(row.pop("failures")), int(row.pop("runs"))
            keys = {name: value for name, value in row.items() if name not in _NOT_KEYS}
            groups.append(
                {"keys": keys, "runs": runs, "failures": failures, "figures": figures, "coverage": coverage}
            )
        return groups


_NOT_KEYS = {
    "reader",
    "median.censored",
    "n",
    "copies",
    "untracked",
    "untracked.by",
    "deterministic",
    "failures.by",
}


class _Tables(HTMLParser):
    """The tables of a page: lists of lines of texts, by the file that stands in their caption."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: dict[str, list[list[str]]] = {}
        self._name: str | None = None
        self._inside = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "a" and given.get("download"):
            self._name = str(given["download"]).removesuffix(".csv")
        elif tag == "table" and self._name is not None:
            self.tables[self._name] = []
        elif tag == "tr" and self._name in self.tables:
            self.tables[str(self._name)].append([])
        elif tag in {"td", "th"} and self._name in self.tables:
            self.tables[str(self._name)][-1].append("")
            self._inside = True
        elif tag == "br" and self._inside:
            self.handle_data(" ")

    def handle_endtag(self, tag: str) -> None:
        if tag in {"td", "th"}:
            self._inside = False
        elif tag == "table":
            self._name = None

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.tables[str(self._name)][-1][-1] += data


def chosen(question: Question) -> list[str]:
    """Return the options that choose rows."""
    words = [word for name in question.sweeps for word in ("--sweep", name)]
    if question.evaluation is not None:
        words += ["--evaluation", question.evaluation]
    if question.condition is not None:
        words += ["--where", str(where(question))]
    return [*words, *(["--superseded"] if question.superseded else [])]


def filters(question: Question) -> list[tuple[str, str]]:
    """Return the parameters of the API that choose rows."""
    pairs = [("sweep", name) for name in question.sweeps]
    if question.evaluation is not None:
        pairs.append(("evaluation", question.evaluation))
    if question.condition is not None:
        pairs.append(("where", str(where(question))))
    return [*pairs, *([("superseded", "1")] if question.superseded else [])]


def where(question: Question) -> str | None:
    """Return a condition as it is written."""
    if question.condition is None:
        return None
    column, operator, value = question.condition
    if operator.startswith("is"):
        return f"{column} {operator}"
    if operator == "in":
        return f"{column} in ({', '.join(map(_literal, value))})"
    return f"{column} {operator} {_literal(value)}"


def _literal(value: Any) -> str:
    return f"'{value}'" if isinstance(value, str) else json.dumps(value)


def _ranking(question: Question) -> list[tuple[str, str]]:
    given = [("metric", question.metrics[0]), ("by", ",".join(question.competitors))]
    return [*filters(question), *given, ("outcomes", question.outcomes)]


def _table_words(question: Question) -> list[str]:
    words = [] if question.by is None else ["--rows", ",".join(question.by)]
    for metric in question.metrics:
        words += ["--metric", metric]
    return [*words, "--outcomes", question.outcomes]


def _group(row: Record, question: Question) -> Record:
    """Return a group of a flat row; what is neither a figure nor a count is a key."""
    row = dict(row)
    figures = {}
    for name in (*question.metrics, "coverage"):
        figures[name] = {part: _number(row.pop(f"{name}.{part}")) for part in PARTS}
    failures = row.pop("failures.by")
    group = {
        "failures": failures if isinstance(failures, dict) else json.loads(failures),
        "total": int(row.pop("failures")),
        "runs": int(row.pop("runs")),
        "n": int(row.pop("n")),
        "copies": int(row.pop("copies")),
        "coverage": figures.pop("coverage"),
        "figures": figures,
    }
    for column, name in (("untracked.by", "untracked"), ("deterministic", "deterministic")):
        value = row.pop(column)
        group[name] = json.loads(value) if isinstance(value, str) else value
    return group | {"keys": {name: value for name, value in row.items() if name not in _NOT_KEYS}}


def _cell(group: Record) -> Record:
    nothing = {"n": 0} | dict.fromkeys(PARTS[1:])
    return {
        **{name: group[name] for name in ("keys", "runs", "n", "copies", "failures")},
        "total": group["failed"],
        "coverage": group["coverage"] or nothing,
        "figures": {name: {part: found[part] for part in PARTS} for name, found in group["figures"].items()},
        **{name: group[name] for name in ("untracked", "deterministic") if name in group},
    }


def read_csv(text: str) -> list[Record]:
    """Return the rows of a CSV file, all values texts."""
    return [dict(row) for row in csv.DictReader(io.StringIO(text))]


def read_latex(text: str, question: Question) -> list[Record]:
    """Return the places of a table in LaTeX: texts of their keys in order, of their numbers, and of n."""
    body = text.partition(r"\toprule")[2].partition(r"\bottomrule")[0]
    lines = [
        [_plain(cell) for cell in line.removesuffix(r" \\").split(" & ")]
        for line in body.splitlines()
        if line.endswith(r" \\")
    ]
    across = r"\multicolumn" in body
    spans = [int(span) for span in re.findall(r"\\multicolumn\{(\d+)\}", body)]
    if across:
        heading = lines[1]
        keys = len(heading) - sum(spans)
        content = lines[2:]
    else:
        keys = len(lines[0]) - len(question.metrics) - (lines[0][-1] == "n")
        heading, content = lines[0], lines[1:]
        if content and content[0][0] == "" and any(cell.startswith("[") for cell in content[0]):
            content = content[1:]
    places, last = [], ""
    wide = spans[0] if across else 1
    for line in content:
        last = line[0] or last
        for column in range(wide):
            numbers = [line[keys + number * wide + column] for number in range(len(question.metrics))]
            counts = line[keys + wide * len(question.metrics) :]
            place: Record = {
                "keys": [last, *line[1:keys], *([heading[keys + column]] if across else [])],
                "cells": numbers,
            }
            if len(counts) == wide:
                place["n"] = counts[column]
            places.append(place)
    return places


def _plain(cell: str) -> str:
    signs = (
        r"\textsuperscript{\textdaggerdbl}",
        r"\textbf",
        r"\underline",
        r"\textit",
        r"\rotatebox{60}",
        r"\textsuperscript{\textdagger}",
    )
    for command in signs:
        cell = cell.replace(command, "")
    cell = re.sub(r"\\([&%$#_{}])", r"\1", cell.replace(r"$\pm$", "±").replace("$n$", "n"))
    return cell.strip("{} ")


def _decoded(column: Record) -> list[Any]:
    if "values" in column:
        return [_known(value) for value in column["values"]]
    return [None if code < 0 else column["categories"][code] for code in column["codes"]]


def _words(text: str) -> dict[str, int]:
    """Return counts by word, from ``2 Lost, 1 NodeLost``."""
    if text in {"0", "–", ""}:
        return {}
    pairs = (part.split(" ", 1) for part in text.split(", "))
    return {word: int(count) for count, word in pairs}


def _number(value: Any) -> float | None:
    return None if value in (None, "") else float(value)


def _known(value: Any) -> Any:
    """Return a value; None for what stands for a missing one in a data frame."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return None
    return None if type(value).__name__ in {"NAType", "NaTType"} else value


def texts(values: Sequence[Any]) -> list[str]:
    """Return values as CSV has them."""
    return [_text(value) for value in values]


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, list | dict) else str(value)
