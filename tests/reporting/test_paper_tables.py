# SPDX-License-Identifier: Apache-2.0
"""Tables for papers: what stands where, what is bold, what failed, and LaTeX that LaTeX takes."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis import Metric, Outcomes, Selection, choose
from slamhive.model.results import Outcome
from slamhive.reporting.latex import escaped, latex
from slamhive.reporting.papertables import Best, Layout, Statistic, flat, make_table
from slamhive.tables.reading import archive_url, read_archive

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.reporting.papertables import PaperTable

ERROR = Metric.parse("ate.rmse:cm:.2f")


def table(home: Path, *, where: str | None = None, **layout: Any) -> PaperTable:
    given = {"rows": ("algorithm",), "columns": ("dataset",), "metrics": (ERROR,)}
    frame = choose(read_archive(archive_url(home)), Selection(where=where)).frame
    return make_table(frame, Layout(**(given | layout)))


def values(found: PaperTable, number: int = 0) -> list[list[Any]]:
    return [[place and place.figures[number].value for place in line] for line in found.places]


def bold(found: PaperTable) -> list[list[bool]]:
    return [[bool(place and place.figures[0].bold) for place in line] for line in found.places]


@pytest.fixture
def study(records: Any, fill: Callable[..., Path]) -> Path:
    """24 tracked runs, and on dataset-2 two more of the better algorithm that were not."""
    lost = [
        records.run(28, results=[records.result(outcome=Outcome.LOST, ate={"rmse": 0.001})]),
        records.failed(34),
    ]
    return fill([*(records.run(number) for number in range(24)), *lost])


def test_means_medians_and_spread(study: Path) -> None:
    found = table(study)
    assert [row[0] for row in found.rows] == ["algorithm-0", "algorithm-1"]
    assert found.columns == (("dataset-0",), ("dataset-1",), ("dataset-2",))
    # 2 cm, the other algorithm 4; 1 cm more each dataset, 1 mm more at the second repetition.
    assert values(found) == [pytest.approx([2.05, 3.05, 4.05]), pytest.approx([4.05, 5.05, 6.05])]
    spread = table(study, spread=True, statistic=Statistic.MEDIAN).places[0][0]
    assert spread is not None
    assert spread.figures[0].spread == pytest.approx((2.0, 2.1))


def test_what_failed_is_counted_and_a_small_error_of_a_lost_run_is_no_best(study: Path) -> None:
    found = table(study)
    place = found.places[0][2]
    assert place is not None
    assert (place.n, place.runs, place.failures) == (4, 6, {"Lost": 1, "OutOfMemory": 1})
    assert bold(found) == [[True] * 3, [False] * 3]
    only = table(study, where="dataset == 'dataset-2' and repetition > 1 or algorithm != 'algorithm-0'")
    assert only.places[0] == (None, None, only.places[0][2])
    assert bold(only)[0][2] is False
    everything = table(study, outcomes=Outcomes.ALL, where="dataset == 'dataset-2'")
    assert everything.places[0][0] is not None
    assert everything.places[0][0].n == 5


@pytest.mark.parametrize(
    ("best", "expected"),
    [
        (Best.COLUMN, [True, False, False, False]),
        (Best.GROUP, [True, False, True, False]),
        (Best.NONE, [False] * 4),
    ],
)
def test_where_the_best_is_looked_for(study: Path, best: Best, expected: list[bool]) -> None:
    found = table(study, rows=("algorithm", "dataset"), columns=(), best=best, where="dataset != 'dataset-2'")
    assert [line[0] for line in bold(found)] == expected


def test_numbers_that_are_shown_alike_are_both_best(study: Path) -> None:
    rough = Metric.parse("usage.memory.peakBytes:GiB:.1f")
    assert bold(table(study, metrics=(rough,), where="status == 'Tracked'")) == [[True] * 3, [True] * 3]
    assert not any(map(any, bold(table(study, metrics=(Metric.parse("seed"),)))))


def test_evaluations_become_rows(records: Any, fill: Callable[..., Path]) -> None:
    both = [records.result(), records.result("sim3", ate={"rmse": 0.2})]
    found = table(
        fill([records.run(0, results=both), records.failed(6, evaluations=records.meant("se3", "sim3"))])
    )
    assert found.keys == ("evaluation", "algorithm")
    assert values(found) == [[pytest.approx(10)], [pytest.approx(20)]]
    assert [line[0] and line[0].failures for line in found.places] == [{"OutOfMemory": 1}] * 2


def test_latex_says_n_and_what_failed(study: Path) -> None:
    text = latex(table(study), caption="100 % of it", label="tab:x", origin=["made\nhere"])
    lines = text.splitlines()
    assert lines[0] == "% made here"
    assert r"\caption{100 \% of it. Mean over tracked runs, $n = 4$ each. Bold: best of its column." in text
    assert r"\label{tab:x}" in text
    assert r" & \multicolumn{3}{c}{ATE [cm]} & \multicolumn{3}{c}{$n$} \\" in lines
    numbers = r"\textbf{2.05} & \textbf{3.05} & \textbf{4.05}\textsuperscript{\textdagger}"
    assert rf"algorithm-0 & {numbers} & 4 & 4 & 4/6 \\" in lines
    assert "Not tracked: algorithm-0, dataset-2: 1 Lost, 1 OutOfMemory." in text


@pytest.mark.parametrize("caption", ["", "Sure?", "Told.", " Told. "])
def test_captions_get_no_second_full_stop(study: Path, caption: str) -> None:
    begins = f"{caption.strip()} Mean over".strip()
    assert rf"\caption{{{begins}" in latex(table(study), caption=caption)


def test_heads_and_footnotes_say_what_their_values_are(records: Any, fill: Callable[..., Path]) -> None:
    def run(number: int, rate: float, **more: Any) -> Any:
        spec = {"input": {"pace": "Lockstep", "frameRate": rate, "resolution": 0.5}}
        make = records.failed if number == 24 else records.run
        return make(number, spec=spec, parameters={"loop": True}, **more)

    home = fill([run(0, 7.5), run(12, 15.0), run(24, 15.0)])
    text = latex(table(home, columns=("input.frameRate",), rows=("sensors", "parameters.loop")))
    assert r"Sensors & loop & frame rate [Hz] 7.5 & frame rate [Hz] 15.0" in text
    assert "Not tracked: sensors stereo, loop true, frame rate 15.0 Hz: 1 OutOfMemory." in text
    turned = latex(table(home, rows=("input.frameRate", "input.resolution"), columns=()))
    assert "Frame rate [Hz] & Resolution & ATE" in turned


def test_a_cell_in_which_all_failed_says_how(study: Path) -> None:
    text = latex(table(study, where="repetition > 1 or algorithm == 'algorithm-1'"))
    assert r"algorithm-0 & -- & -- & \textit{Lost} &" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a_b & 50%", r"a\_b \& 50\%"),
        (r"\input{x}", r"\textbackslash{}input\{x\}"),
        ("~^#$", r"\textasciitilde{}\textasciicircum{}\#\$"),
        ("two\nlines\x00", "two lines "),
        (None, "--"),
        (True, "true"),
        (0.1, "0.1"),
    ],
)
def test_names_are_no_commands(text: Any, expected: str) -> None:
    assert escaped(text) == expected


def test_csv_has_every_digit(study: Path) -> None:
    columns = flat(table(study))
    assert columns["ate.rmse [cm]"][0] == pytest.approx(2.05, rel=1e-15)
    assert columns["failures.by"][2] == {"Lost": 1, "OutOfMemory": 1}
    assert {len(held) for held in columns.values()} == {6}


def test_latex_takes_it(assorted: Path, study: Path, tmp_path: Path) -> None:
    program = shutil.which("pdflatex")
    if program is None:
        pytest.skip("no pdflatex here: apt-get install texlive-latex-recommended")
    where = "dataset in ('dataset-0', 'dataset-1', 'dataset-2')"
    metrics = tuple(
        map(Metric.parse, ("ate.rmse", "usage.cpu.meanCores", "usage.memory.peakBytes", "coverage"))
    )
    tables = [
        table(assorted, rows=("algorithm", "sensors"), metrics=metrics, spread=True, where=where),
        table(assorted, rows=("parameters.nFeatures", "parameters.text"), columns=(), where=where),
    ]
    body = "\n".join(latex(one, caption="x_y & <z>") for one in tables)
    packages = r"\usepackage[utf8]{inputenc}\usepackage[T1]{fontenc}\usepackage{booktabs,graphicx}"
    (tmp_path / "x.tex").write_text(
        rf"\documentclass[twocolumn]{{article}}{packages}\begin{{document}}{body}\end{{document}}"
    )
    command = [program, "-interaction=nonstopmode", "-halt-on-error", "-draftmode", "x.tex"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False
    )
    assert done.returncode == 0, done.stdout[-3000:]


def test_the_command_writes_both_forms(study: Path, slamhive: Callable[..., Any], tmp_path: Path) -> None:
    code, out, _ = slamhive(study, "paper-table", "-m", "ate.rmse:cm", "--format", "csv")
    assert code == 0
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [row["dataset"] for row in rows[:3]] == ["dataset-0", "dataset-1", "dataset-2"]
    assert float(rows[0]["ate.rmse [cm]"]) == pytest.approx(2.05)
    assert (
        slamhive(study, "paper-table", "--columns", "", "--rows", "dataset", "-o", tmp_path / "t.tex")[0] == 0
    )
    assert re.search(r"^algorithm-0 & dataset-0 & ", (tmp_path / "t.tex").read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--preset", "V"], "--preset: unknown table 'V'"),
        (["-m", "ate.rmes"], "--metric: unknown column 'ate.rmes'; did you mean 'ate.rmse'?"),
        (["-m", "ate.rmse:km"], "ate.rmse:km: 'km' is neither a unit"),
        (["-m", "algorithm"], "--metric: algorithm: a column of numbers is needed"),
        (["--rows", "algo"], "--rows: unknown column 'algo'"),
        (["--columns", "datset"], "--columns: unknown column 'datset'; did you mean 'dataset'?"),
        (["--where", "coverage > 2"], "no run is meant"),
        (["--where", "coverage >"], "condition, character 11"),
        (["--sweep", "x"], "--sweep: unknown sweep 'x'; known: later, study"),
        (["--evaluation", "x"], "--evaluation: unknown evaluation 'x'; known: se3"),
        (["-o", "/nowhere/t.tex"], "--output: /nowhere/t.tex: No such file"),
    ],
)
def test_mistakes(study: Path, slamhive: Callable[..., Any], words: list[str], sentence: str) -> None:
    code, out, err = slamhive(study, "paper-table", *words)
    assert (code, out) == (2, "")
    assert " ".join(err.split()).startswith(f"error: {sentence}")
