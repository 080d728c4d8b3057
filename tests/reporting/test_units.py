# SPDX-License-Identifier: Apache-2.0
"""Units of parameters: what an Algorithm's manifest declares stands in figures, tables, reports and pages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis.metrics import declared_units, label_of
from slamhive.archive import Archive
from slamhive.archive.records import CatalogEntry
from slamhive.dashboard.answers.columns import heading
from slamhive.figures.asking import FigureKind, Wish
from slamhive.figures.making import picture
from slamhive.local.home.folder import Home
from slamhive.tables.homes import Beside, read_homes
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ALGORITHMS = ("algorithm-0", "algorithm-1")


def declare(home: Path, *units: str | None) -> None:
    """Store manifests whose parameter k has a unit, or none; of so many algorithms as units are given."""
    with Archive.open(f"sqlite:///{home / 'archive.sqlite'}") as archive:
        for name, unit in zip(ALGORITHMS, units, strict=False):
            one = {"type": "Number"} | ({} if unit is None else {"unit": unit})
            spec = {"parameters": {"k": one, "mode": {"type": "String"}}}
            archive.put_catalog(CatalogEntry(kind="Algorithm", name=name, spec=spec))


@pytest.fixture
def study(records: Any, fill: Callable[..., Path]) -> Path:
    return fill(records.run(number, parameters={"k": 0.5 * (1 + number % 3)}) for number in range(12))


def url(home: Path) -> str:
    return f"sqlite:///{home / 'archive.sqlite'}"


@pytest.mark.parametrize(
    ("units", "found"),
    [
        (("m", "m"), {"parameters.k": "m"}),
        (("m", "cm"), {}),
        (("m", None), {}),
        (("m",), {}),  # of the other algorithm nothing is known
        ((None, None), {}),
    ],
)
def test_a_unit_holds_where_all_algorithms_agree(study: Path, units: Any, found: dict[str, str]) -> None:
    declare(study, *units)
    assert read_archive(url(study)).units == found


def test_only_algorithms_of_the_runs_shown_count(study: Path) -> None:
    declare(study, "m", "cm")
    frame = read_archive(url(study))
    of = frame.column("algorithm")
    assert [frame.select(of.codes == of.values.index(name)).units for name in ALGORITHMS] == [
        {"parameters.k": "m"},
        {"parameters.k": "cm"},
    ]


def test_the_latest_manifest_says_it(study: Path) -> None:
    declare(study, None, None)
    before = read_archive(url(study), study / "cache")
    declare(study, "s", "s")
    assert (before.units, read_archive(url(study), study / "cache").units) == ({}, {"parameters.k": "s"})


def test_units_hold_inside_alone() -> None:
    with declared_units({"parameters.k": "s"}):
        assert label_of("parameters.k") == "k [s]"
    assert label_of("parameters.k") == "k"


def test_figures_name_axes_with_them(study: Path) -> None:
    declare(study, "m", "m")
    frame = read_archive(url(study))
    drawn = picture(frame, Wish(FigureKind.LINES, x="k"), Home.at(study))
    assert (drawn.x.label, drawn.y.label) == ("k [m]", "ATE RMSE [m]")
    apart = picture(frame, Wish(FigureKind.LINES, x="repetition", by="k"), Home.at(study))
    assert "k 0.5 m" in " ".join(apart.series)


def test_tables_and_reports_do(study: Path, slamhive: Callable[..., Any]) -> None:
    declare(study, "m", "m")
    code, out, err = slamhive(study, "results", "table", "--rows", "k", "--format", "markdown")
    assert code == 0, err
    assert "| k [m] |" in out
    meaning = "ATE: RMSE of position errors after SE(3) alignment"
    assert meaning in err
    code, out, err = slamhive(
        study, "paper-table", "--rows", "k", "--columns", "dataset", "--style", "markdown"
    )
    assert r"| k \[m\] |" in out, err
    code, out, err = slamhive(study, "results", "list", "--format", "markdown", "--columns", "run,k")
    assert "| k [m] |" in out, err
    file = study / "report.html"
    code, _, err = slamhive(study, "report", "--analysis", "k:ate.rmse", "-o", file)
    assert "k [m]" in file.read_text(), err
    assert file.read_text().count(meaning) >= 3, "the report says it below its tables"


def test_pages_do(study: Path) -> None:
    declare(study, "m", "m")
    found = heading(read_archive(url(study)), "parameters.k")
    assert (found["title"], found["label"], found["unit"]) == ("parameters.k [m]", "k [m]", "m")


def test_bytes_of_settings_stand_as_they_were_written(study: Path) -> None:
    declare(study, "B", "B")
    found = heading(read_archive(url(study)), "parameters.k")
    assert (found["title"], found["factor"]) == ("parameters.k [B]", 1.0)


def test_homes_of_others_bring_theirs(study: Path, tmp_path: Path) -> None:
    declare(study, "m", "m")
    mine = tmp_path / "mine"
    mine.mkdir()
    frame = read_homes(Home.at(mine), [Beside("anna", url(study), study)])
    assert frame.units == {"parameters.k": "m"}
