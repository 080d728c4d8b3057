# SPDX-License-Identifier: Apache-2.0
"""Tables III and IV of the ICRA 2023 paper: each cell as ``slamhive paper-table --preset`` writes it."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

ICRA = Path(__file__).parents[3] / "shared" / "data" / "icra2023"
COLUMNS = {
    "cpu_mean_cores": "usage.cpu.meanCores",
    "cpu_max_cores": "usage.cpu.maxCores",
    "memory_max_mib": "usage.memory.peakBytes [MiB]",
}


def rows_of(slamhive: Callable[..., Any], home: Path, name: str) -> list[dict[str, str]]:
    code, out, err = slamhive(home, "paper-table", "--preset", name, "--format", "csv")
    assert code == 0, err
    return list(csv.DictReader(io.StringIO(out)))


def lines_of(slamhive: Callable[..., Any], home: Path, name: str) -> list[list[str]]:
    """The cells of the lines of numbers in LaTeX, without what is set about them."""
    code, out, err = slamhive(home, "paper-table", "--preset", name)
    assert code == 0, err
    body = out.split("\\midrule\n", 1)[1].split("\\bottomrule", maxsplit=1)[0]
    for command in (r"\textsuperscript{\textdagger}", r"\textbf{", r"\underline{", "}", r" \\"):
        body = body.replace(command, "")
    return [line.split(" & ") for line in body.splitlines() if "&" in line]


def test_table_three_is_that_of_the_runs(published: Path, slamhive: Callable[..., Any]) -> None:
    reference = {one["id"]: one for one in json.loads((ICRA / "reference.json").read_text())["runs"]}
    cells = json.loads((ICRA / "paper_tables.json").read_text())["table_III"]
    rows = {
        (row["sensors"], row["algorithm"], row["dataset"]): row for row in rows_of(slamhive, published, "III")
    }
    assert len(rows) == len(cells) == 30
    for cell in cells:
        dataset = cell["dataset"].lower().replace("_", "-")
        row, run = rows[cell["sensors"], cell["algorithm"], dataset], reference[cell["run"]]
        assert float(row["ate.rmse [m]"]) == pytest.approx(run["ate_sim3"]["rmse"], rel=1e-9)
        for name, column in COLUMNS.items():
            assert float(row[column]) == pytest.approx(run[name], rel=1e-9)
        assert (row["n"], row["runs"]) == ("1", "1")


def test_table_three_is_what_the_paper_prints(published: Path, slamhive: Callable[..., Any]) -> None:
    cells = json.loads((ICRA / "paper_tables.json").read_text())["table_III"]
    lines = lines_of(slamhive, published, "iii")
    assert len(lines) == 10
    printed: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        shown = f"{cell['ate_rmse_m']:.3f}", *(f"{cell[name]:.2f}" for name in list(COLUMNS)[:2])
        printed.setdefault((cell["sensors"], cell["algorithm"]), []).append(
            [*shown, f"{cell['memory_max_mib']:.0f}"]  # type: ignore[arg-type]
        )
    differing = []
    sensors = ""
    for line in lines:
        sensors = line[0].strip() or sensors
        # Datasets stand side by side under each metric.
        expected = [row[metric] for metric in range(4) for row in printed[sensors, line[1]]]
        differing += [
            (sensors, line[1], found, paper)
            for found, paper in zip(line[2:], expected, strict=True)
            if found != paper
        ]
    assert differing == [("mono", "orb-slam2", "0.034", "0.038"), ("stereo", "orb-slam2", "4.11", "4.10")]


def test_table_four_is_that_of_the_runs_and_what_the_paper_prints(
    published: Path, slamhive: Callable[..., Any]
) -> None:
    cells = json.loads((ICRA / "paper_tables.json").read_text())["table_IV"]
    names = ("ate.rmse [cm]", "rpe[0].rmse [cm]", *COLUMNS.values())
    for cell, row in zip(cells, rows_of(slamhive, published, "IV"), strict=True):
        assert int(row["parameters.nFeatures"]) == cell["nFeatures"]
        assert [float(row[name]) for name in names] == pytest.approx(cell["recomputed"], rel=1e-9)
        assert row["n"] == "5"
    differing = []
    for cell, line in zip(cells, lines_of(slamhive, published, "4"), strict=True):
        paper = [f"{cell['ate_rmse_cm']:.3f}", f"{cell['rpe_rmse_cm_per_m']:.2f}"]
        paper += [f"{cell[name]:.2f}" for name in list(COLUMNS)[:2]] + [f"{cell['memory_max_mib']:.0f}"]
        pairs = zip(line[1:], paper, strict=True)
        differing += [(cell["nFeatures"], found, printed) for found, printed in pairs if found != printed]
    # One misprint, and two numbers that were cut instead of rounded.
    assert differing == [(500, "2.00", "1.99"), (1750, "1.14", "1.24"), (1750, "1641", "1640")]


def test_what_is_not_tracked_is_marked(published: Path, slamhive: Callable[..., Any]) -> None:
    out = slamhive(published, "paper-table", "--preset", "III")[1]
    assert r"0.027\textsuperscript{\textdagger}" in out
    assert r"\textbf{0.027}" not in out
    assert "sensors stereo, orb-slam2, mh-02-easy: 1 Lost" in out


def test_the_papers_numbers_stand_beside_those_of_its_runs(
    published: Path, slamhive: Callable[..., Any]
) -> None:
    """The runs are the paper's own: each number is beside its run's, and within 10 % of it."""
    words = ("paper-table", "--preset", "III", "--published")
    code, out, err = slamhive(published, *words, "--style", "csv")
    assert code == 0, err
    rows = list(csv.DictReader(io.StringIO(out)))
    cells = json.loads((ICRA / "paper_tables.json").read_text())["table_III"]
    printed = {
        (one["sensors"], one["algorithm"], one["dataset"].lower().replace("_", "-")): one["ate_rmse_m"]
        for one in cells
    }
    shown = {
        (row["sensors"], row["algorithm"], row["dataset"]): float(row["published.ate.rmse [m]"])
        for row in rows
        if row["published.ate.rmse [m]"]
    }
    assert shown.items() <= printed.items()
    assert len(shown) > 20
    for style, head in (("markdown", "ATE published"), ("booktabs", r"{ATE published [m]}")):
        code, out, err = slamhive(published, *words, "--style", style)
        assert code == 0, err
        assert head in out
        assert "ATE published: ICRA 2023, Table III." in out
