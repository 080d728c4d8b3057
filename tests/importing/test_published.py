# SPDX-License-Identifier: Apache-2.0
"""All 81 runs of the paper: every statistic of an independent evaluator, every cell of its tables."""

from __future__ import annotations

import csv
import io
import json
import re
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Decimal
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.cli.parts.tables import PrintFormat

if TYPE_CHECKING:
    from collections.abc import Callable

    Results = Callable[..., str]

STATISTICS = ("rmse", "mean", "median", "std", "min", "max", "sse")
SIM3 = ("table", "--evaluation", "sim3", "--outcomes", "all")

TABLE_3 = (
    *SIM3,
    *("--where", "dataset != 'rgbd-dataset-freiburg2-desk' and run not in (53, 103, 122)"),
    *("--rows", "sensors,algorithm,dataset"),
    *("-m", "ate.rmse:m:.3f", "-m", "usage.cpu.meanCores:.2f", "-m", "usage.cpu.maxCores:.2f"),
    *("-m", "usage.memory.peakBytes:MiB:.0f"),
)
TABLE_4 = (
    *SIM3,
    *("--where", "dataset == 'rgbd-dataset-freiburg2-desk' and run not in (124, 139, 140)"),
    *("--rows", "parameters.nFeatures"),
    *("-m", "ate.rmse:cm:.3f", "-m", "rpe[0].rmse:cm:.2f"),
    *(
        "-m",
        "usage.cpu.meanCores:.2f",
        "-m",
        "usage.cpu.maxCores:.2f",
        "-m",
        "usage.memory.peakBytes:MiB:.0f",
    ),
)


def exported(results: Results, evaluation: str) -> dict[int, dict[str, Any]]:
    rows = json.loads(results("export", "--format", "json", "--evaluation", evaluation))
    return {row["run"]: row for row in rows}


@pytest.mark.parametrize("evaluation", ["sim3", "se3"])
def test_every_statistic(published: Results, reference: dict[str, Any], evaluation: str) -> None:
    rows = exported(published, evaluation)
    assert len(rows) == len(reference["runs"]) == 81
    for expected in reference["runs"]:
        row = rows[expected["id"]]
        pairs = {f"ate.{name}": expected[f"ate_{evaluation}"][name] for name in STATISTICS}
        if evaluation == "sim3":
            errors = expected["rpe_1m_all_pairs_sim3"]
            pairs |= {f"rpe[0].{name}": errors[name] for name in STATISTICS}
        pairs |= {
            "usage.cpu.meanCores": expected["cpu_mean_cores"],
            "usage.cpu.maxCores": expected["cpu_max_cores"],
            "usage.memory.peakBytes": expected["memory_max_mib"] * 2**20,
            "poses": expected["matched_poses"],
        }
        assert {name: row[name] for name in pairs} == {
            name: pytest.approx(value, rel=1e-9, abs=1e-12) for name, value in pairs.items()
        }, expected["id"]
        assert round(row["coverage"], 3) == expected["coverage"]
        assert row["keyframes"] == expected["keyframes"]
        assert row["label.dataset"] == expected["dataset"]
        assert row["label.algorithm"] == expected["algorithm"]
        assert row.get("parameters.nFeatures") == expected["nFeatures"]


def test_outcomes(published: Results) -> None:
    rows = exported(published, "sim3")
    assert rows[124]["outcome"] == "Diverged"
    assert rows[124]["scale"] == pytest.approx(5008, abs=1)
    assert rows[63]["outcome"] == "Lost"
    assert {row["phase"] for row in rows.values()} == {"Succeeded"}


def test_nothing_is_merged(published: Results) -> None:
    rows = exported(published, "sim3").values()
    assert len({row["uid"] for row in rows}) == 81
    assert len({row["provenance.specHash"] for row in rows}) == 40
    by_configuration: dict[str, list[int]] = {}
    for row in rows:
        by_configuration.setdefault(row["provenance.specHash"], []).append(row["repetition"])
    assert all(sorted(numbers) == list(range(len(numbers))) for numbers in by_configuration.values())


def test_what_the_samples_do_not_tell_stays_unknown(published: Results) -> None:
    for row in exported(published, "sim3").values():
        known = row["sensors"] != "rgbd"
        assert (row["usage.wallSeconds"] is not None) == known, row["run"]
        assert (row["usage.cpu.seconds"] is not None) == known, row["run"]


def as_printed(value: float, printed: float, digits: int, *, cut: bool = False) -> bool:
    """Tell whether a number, rounded or cut to the digits that the table has, is the one printed."""
    mode = ROUND_DOWN if cut else ROUND_HALF_EVEN
    return Decimal(repr(value)).quantize(Decimal(1).scaleb(-digits), mode) == Decimal(str(printed))


PRINTED = {
    "ate_rmse_m": ("ate.rmse", 1, 3),
    "ate_rmse_cm": ("ate.rmse", 100, 3),
    "rpe_rmse_cm_per_m": ("rpe[0].rmse", 100, 2),
    "cpu_mean_cores": ("usage.cpu.meanCores", 1, 2),
    "cpu_max_cores": ("usage.cpu.maxCores", 1, 2),
    "memory_max_mib": ("usage.memory.peakBytes", 2**-20, 0),
}


def wrong_cells(
    groups: dict[Any, dict[str, Any]], expected: dict[Any, dict[str, Any]]
) -> tuple[set[Any], set[Any]]:
    """Return the cells that are neither rounded nor cut to what was printed, and those that are cut."""
    wrong, cut = set(), set()
    for key, cells in expected.items():
        for name, printed in cells.items():
            if name not in PRINTED:
                continue
            column, factor, digits = PRINTED[name]
            value = groups[key][f"{column}.mean"] * factor
            if not as_printed(value, printed, digits):
                cell = (*key, name)
                (cut if as_printed(value, printed, digits, cut=True) else wrong).add(cell)
    return wrong, cut


def test_table_3(published: Results, tables: dict[str, Any]) -> None:
    rows = json.loads(published(*TABLE_3, "--format", "json"))
    assert len(rows) == len(tables["table_III"]) == 30
    groups = {(row["sensors"], row["algorithm"], row["dataset"]): row for row in rows}
    expected = {
        (cell["sensors"], cell["algorithm"], cell["dataset"].lower().replace("_", "-")): cell
        for cell in tables["table_III"]
    }
    wrong, cut = wrong_cells(groups, expected)
    short = ("stereo", "orb-slam2", "mh-01-easy")
    assert wrong == {("mono", "orb-slam2", "mh-02-easy", "ate_rmse_m"), (*short, "cpu_max_cores")}
    assert not cut
    # The only cell that was printed with one decimal.
    assert as_printed(groups[short]["usage.cpu.maxCores.mean"], 4.1, 1)


def test_table_4(published: Results, tables: dict[str, Any]) -> None:
    rows = json.loads(published(*TABLE_4, "--format", "json"))
    assert [(row["runs"], row["n"]) for row in rows] == [(5, 5)] * 9
    groups = {(row["parameters.nFeatures"],): row for row in rows}
    expected = {(cell["nFeatures"],): cell for cell in tables["table_IV"]}
    wrong, cut = wrong_cells(groups, expected)
    assert wrong == {(1750, "rpe_rmse_cm_per_m")}
    assert cut == {(500, "cpu_max_cores"), (1750, "memory_max_mib")}


def test_tables_as_people_read_them(published: Results) -> None:
    lines = published(*TABLE_4, "--format", "markdown").splitlines()
    assert lines[0].split(" | ")[1:6] == [
        "ATE [cm]",
        "RPE [cm]",
        "CPU [cores]",
        "CPU max [cores]",
        "peak memory [MiB]",
    ]
    assert lines[5].startswith(
        "| 1250 | 0.693 ± 0.035 | 1.16 ± 0.06 | 1.64 ± 0.08 | 3.18 ± 0.26 | 955 ± 38 |"
    )
    assert lines[7].endswith("| 5 | 0; in n: 1 Partial |")


def test_means_leave_out_what_was_not_tracked_and_show_it(published: Results) -> None:
    asked = [word for word in TABLE_4 if word not in {"--outcomes", "all"}]
    rows = {row["parameters.nFeatures"]: row for row in json.loads(published(*asked, "--format", "json"))}
    assert (rows[2000]["n"], rows[2000]["failures"], rows[2000]["failures.by"]) == (3, 2, {"Partial": 2})
    assert rows[2000]["coverage.n"] == 5


def test_default_table_keeps_both_evaluations_and_the_diverged_run_apart(published: Results) -> None:
    rows = json.loads(published("table", "--format", "json"))
    assert {row["evaluation"] for row in rows} == {"se3", "sim3"}
    assert sum(row["runs"] for row in rows) == 162
    (diverged,) = [
        row
        for row in rows
        if row["dataset.attributes.DepthMapFactor"] == 5208 and row["evaluation"] == "sim3"
    ]
    assert (diverged["n"], diverged["failures.by"], diverged["ate.rmse.mean"]) == (0, {"Diverged": 1}, None)


@pytest.mark.parametrize("form", [PrintFormat.CSV, PrintFormat.MARKDOWN])
def test_every_format_of_export_has_every_digit(published: Results, form: PrintFormat) -> None:
    expected = {row["uid"]: row for row in json.loads(published("export", "--format", "json"))}
    text = published("export", "--format", form)
    if form is PrintFormat.MARKDOWN:
        names, _, *lines = (
            [part.strip() for part in re.split(r"(?<!\\)\|", line)[1:-1]] for line in text.splitlines()
        )
        rows = [dict(zip(names, line, strict=True)) for line in lines]
    else:
        rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 162
    sse = {(row["uid"], row["evaluation"]): float(row["ate.sse"]) for row in rows}
    for row in expected.values():
        assert sse[row["uid"], row["evaluation"]] == row["ate.sse"]


def test_selecting_and_sorting(published: Results) -> None:
    words = ("list", "--evaluation", "sim3", "--format", "json", "--columns", "run,ate.rmse")
    rows = json.loads(published(*words, "--where", "run in (52, 63, 103, 121)", "--sort", "-ate.rmse"))
    assert [row["run"] for row in rows] == [103, 121, 52, 63]
    assert set(rows[0]) == {"run", "ate.rmse"}


def test_showing_one_run(published: Results) -> None:
    text = published("show", "124")
    assert "the scale is 500" in text
    assert re.search(r"parameters\.nFeatures +1000", text)
    (row, _) = json.loads(published("show", "124", "--json"))
    assert row["dataset.attributes.DepthMapFactor"] == 5208
