# SPDX-License-Identifier: Apache-2.0
"""Runs of three paces, and what a player notes of nodes: in tables, reports, figures and pages to share."""

from __future__ import annotations

import csv
import io
import json
import re
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

ERRORS = {"Lockstep": 0.1, "Realtime": 0.4, "Stepped": 0.2}
CAUSAL = {"Realtime": 0.5, "Stepped": 0.2}
"""In Stepped no pose was published otherwise later, so that the player wrote no second trajectory."""


def metrics(pace: str) -> Mapping[str, Any]:
    """Return the notes of a player on a run; none in Lockstep."""
    if pace == "Lockstep":
        return {}
    latest = 31.0 if pace == "Realtime" else 0.9
    latencies = {"mean": 0.3, "median": 0.25, "p95": 0.75, "p99": 0.875, "max": latest}
    return {"posesPublished": 90, "latencySeconds": latencies, "realTimeFactor": 2.0, "playSeconds": 30.0}


@pytest.fixture
def home(records: Any, fill: Callable[[Iterable[Any]], Path]) -> Path:
    """A home with two runs of an algorithm on a dataset in each of the three paces."""
    made = []
    for number, (pace, error) in enumerate([*ERRORS.items()] * 2):
        values: dict[str, Any] = {"ate": {"rmse": error}}
        if pace == "Realtime":
            causal = {"outcome": "Tracked", "coverage": 0.9, "ate": {"rmse": CAUSAL[pace]}}
            values["beside"] = {"online": causal}
        spec = {
            "algorithmRef": {"name": "node"},
            "datasetRef": {"name": "hall"},
            "input": {"pace": pace, "rate": 1.0},
            "repetition": number // 3,
        }
        made.append(
            records.run(
                number,
                spec=spec,
                parameters={},
                metrics=metrics(pace),
                frames={"offered": 100, "processed": 90, "dropped": 10 if pace == "Realtime" else 0},
                provenance={"prepared": {"frameRate": 10.0}},
                results=[records.result(**values)],
            )
        )
    return fill(made)


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_table_has_a_row_a_pace_with_causal_beside_final(home: Path, slamhive: Callable[..., Any]) -> None:
    code, text, err = slamhive(home, "results", "table", "--format", "csv")
    assert code == 0, err
    rows = {row["input.pace"]: row for row in rows_of(text)}
    assert {pace: float(row["ate.rmse.mean"]) for pace, row in rows.items()} == ERRORS
    causal = {pace: row["beside.online.ate.rmse.mean"] for pace, row in rows.items()}
    assert causal == {"Lockstep": ""} | {pace: str(error) for pace, error in CAUSAL.items()}
    assert {row["metrics.latencySeconds.p99.mean"] for row in rows.values()} == {"", "0.875"}
    assert {pace: row["late"] for pace, row in rows.items()} == {
        pace: str(pace == "Realtime").lower() for pace in ERRORS
    }


def test_its_columns_have_plain_names_and_its_notes_say_what_they_mean(
    home: Path, slamhive: Callable[..., Any]
) -> None:
    code, text, err = slamhive(home, "results", "table", "--format", "markdown")
    assert code == 0, err
    head, _, *lines = [line for line in text.splitlines() if line.startswith("|")]
    for name in (
        "ATE, final [m]",
        "ATE, causal [m]",
        "latency p50 [s]",
        "latency p99 [s]",
        "real-time factor",
    ):
        assert name in head
    assert [line for line in lines if "§" in line] == [line for line in lines if "Realtime" in line]
    assert "ATE, causal: RMSE of position errors after SE(3) alignment, of the poses as first publ" in err
    assert (
        "§ poses came up to 31 s late in 2 runs: memory says how far it fell behind, not what it needs" in err
    )
    assert "usage.cpu.meanCores of runs in Lockstep and Stepped say how fast a program was" in err


def test_a_list_of_runs_tells_paces_and_late_poses(home: Path, slamhive: Callable[..., Any]) -> None:
    code, text, err = slamhive(home, "results", "list", "--format", "markdown")
    assert code == 0, err
    head = next(line for line in text.splitlines() if line.startswith("|"))
    names = ("pace", "ATE, final [m]", "ATE, causal [m]", "poses late by up to [s]", "real-time factor")
    names += ("frames dropped",)
    assert [name for name in names if name not in head] == []
    assert "poses came up to 31 s late in 2 runs: memory says" in err


def test_who_was_never_played_to_has_no_such_columns(home: Path, slamhive: Callable[..., Any]) -> None:
    alone = ("--where", "input.pace == 'Lockstep'", "--format", "markdown")
    for command in ("table", "list"):
        code, text, err = slamhive(home, "results", command, *alone)
        assert code == 0, err
        assert "ATE [m]" in text
        assert not re.search("causal|latency|real-time|late by|dropped|CPU \\[cores\\]|pace", text)


def test_a_report_ranks_paces_apart_and_says_when_poses_came(
    home: Path, slamhive: Callable[..., Any]
) -> None:
    code, _, err = slamhive(home, "report", "-o", home / "report.html")
    assert code == 0, err
    text = (home / "report.html").read_text()
    ranked = text.partition('id="leaderboard"')[2].partition('id="timeliness"')[0]
    assert [pace for pace in ERRORS if f"hall (pace {pace})" in ranked] == [*ERRORS]
    section = text.partition('id="timeliness"')[2].partition("</section>")[0]
    cells = re.findall(r"<tr>(.*?)</tr>", section)
    shown = [re.findall(r"<td[^>]*>(.*?)</td>", one) for one in cells if "<td" in one]
    assert [[row[0], *row[4:6], row[-2]] for row in shown] == [
        ["Realtime", "0.4", "0.5", "2"],
        ["Stepped", "0.2", "0.2", "2"],
    ]
    assert "Causal: each pose as it was first published" in section


def test_a_report_of_programs_alone_has_no_such_section(home: Path, slamhive: Callable[..., Any]) -> None:
    code, _, err = slamhive(home, "report", "--where", "input.pace == 'Lockstep'", "-o", home / "report.html")
    assert code == 0, err
    assert 'id="timeliness"' not in (home / "report.html").read_text()


@pytest.mark.parametrize(
    ("number", "held", "lacking"),
    [
        (1, ["ATE, final [m]", "ATE, causal [m]", "latency p99 [s]", "31 s late", "CPU [cores]"], []),
        (2, ["ATE, final [m]", "ATE, causal [m]", "real-time factor"], ["s late", "CPU [cores]"]),
        (0, ["ATE [m]"], ["causal", "latency", "s late", "CPU [cores]"]),
    ],
)
def test_the_page_of_a_run_says_what_was_known_when(
    home: Path, slamhive: Callable[..., Any], number: int, held: list[str], lacking: list[str]
) -> None:
    code, _, err = slamhive(home, "report", "--run", f"run-{number:03d}", "-o", home / "run.html")
    assert code == 0, err
    shown = (home / "run.html").read_text().partition("<h2>Results</h2>")[2].partition("<details>")[0]
    assert [one for one in held if one not in shown] == []
    assert [one for one in lacking if one in shown] == []


def test_what_is_shown_of_a_run_has_its_causal_figures(home: Path, slamhive: Callable[..., Any]) -> None:
    for number, causal in enumerate([None, 0.5, 0.2]):
        code, text, err = slamhive(home, "results", "show", f"run-{number:03d}", "--json")
        assert code == 0, err
        (row,) = json.loads(text)
        assert row.get("beside.online.ate.rmse") == causal
    assert "poses came up to 31 s late: memory says" in slamhive(home, "results", "show", "run-001")[2]


def test_figures_draw_causal_over_final_and_a_panel_a_pace(
    home: Path, slamhive: Callable[..., Any], tmp_path: Path
) -> None:
    words = ("figure", "scatter", "-x", "ate.rmse", "-y", "beside.online.ate.rmse", "-o", tmp_path / "f.svg")
    code, _, err = slamhive(home, *words)
    assert code == 0, err
    drawn = rows_of(re.sub(r"(?m)^#.*\n", "", (tmp_path / "f.data.csv").read_text()))
    found = {(row["input.pace"], row["ate.rmse"], row["beside.online.ate.rmse"]) for row in drawn}
    assert found == {(pace, str(error), str(CAUSAL.get(pace, ""))) for pace, error in ERRORS.items()}


def test_a_paper_table_has_a_row_a_pace(home: Path, slamhive: Callable[..., Any]) -> None:
    code, text, err = slamhive(
        home, "paper-table", "--rows", "algorithm,input.pace", "-m", "ate.rmse:m:.2f", "--style", "markdown"
    )
    assert code == 0, err
    shown = [
        re.findall(r"[\w.]+", re.sub("</?u>", "", line)) for line in text.splitlines() if "| node" in line
    ]
    assert {row[1]: row[2] for row in shown} == {pace: f"{error:.2f}" for pace, error in ERRORS.items()}
