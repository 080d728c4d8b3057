# SPDX-License-Identifier: Apache-2.0
"""Tables for papers: what stands where, what is bold, what failed, and LaTeX that LaTeX takes."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import subprocess
from typing import TYPE_CHECKING, Any

import pytest

from slamhive.analysis import Metric, Outcomes, Selection, choose
from slamhive.model.results import Outcome
from slamhive.reporting.latex import Rules, escaped, latex
from slamhive.reporting.papermarkdown import markdown
from slamhive.reporting.papertables import Best, Overall, Statistic, TableLayout, flat, make_table
from slamhive.reporting.tablewords import caption
from slamhive.tables.reading import archive_url, read_archive

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from slamhive.reporting.papertables import PaperTable

ERROR = Metric.parse("ate.rmse:cm:.2f")


def table(home: Path, *, where: str | None = None, **layout: Any) -> PaperTable:
    given = {"rows": ("algorithm",), "columns": ("dataset",), "metrics": (ERROR,)}
    frame = choose(read_archive(archive_url(home)), Selection(where=where)).frame
    return make_table(frame, TableLayout(**(given | layout)))


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
    told = "Mean ± standard deviation (of settings, nFeatures, not of repetitions alone) over"
    assert told in caption(table(study, spread=True), "")[0]
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
    assert r"Sensors & loop & frame rate 7.5 Hz & frame rate 15 Hz" in text
    assert "Not tracked: sensors stereo, loop true, frame rate 15 Hz: 1 OutOfMemory." in text
    turned = latex(table(home, rows=("input.frameRate", "input.resolution"), columns=()))
    assert "Frame rate [Hz] & Resolution & ATE" in turned


def test_the_paper_has_what_its_readers_need_and_the_author_the_rest(
    records: Any, fill: Callable[..., Path], slamhive: Callable[..., Any]
) -> None:
    def run(number: int, digit: str) -> Any:
        return records.run(
            number, provenance={"algorithmHash": digit * 64}, created=f"2025-01-0{digit}T00:00:00Z"
        )

    home = fill([run(24, "1"), run(0, "2"), run(6, "2")])
    told = "earlier versions left out"
    code, out, err = slamhive(home, "paper-table", "--rows", "algorithm")
    assert code == 0, err
    comments = [line for line in out.splitlines() if line.startswith("%")]
    paper = "\n".join(line for line in out.splitlines() if line not in comments)
    assert told in err
    assert any(told in line for line in comments)
    assert told not in paper
    assert "parameters." not in paper
    assert "Over all tried values of nFeatures." in paper
    assert "ATE: RMSE of position errors after SE(3) alignment." in paper
    code, out, err = slamhive(home, "paper-table", "--rows", "algorithm", "--style", "markdown")
    assert (told in out, told in err) == (False, True)


def test_a_cell_in_which_all_failed_says_how(study: Path) -> None:
    text = latex(table(study, where="repetition > 1 or algorithm == 'algorithm-1'"))
    assert r"algorithm-0 & -- & -- & \textit{Lost} &" in text


@pytest.fixture
def three(records: Any, fill: Callable[..., Path]) -> Path:
    """Three algorithms on three datasets: a is best on two of them, c failed on the last."""
    errors = {"a": (0.01, 0.02, 0.09), "b": (0.02, 0.03, 0.03), "c": (0.04, 0.04, None)}
    runs = []
    for at, (name, values) in enumerate(errors.items()):
        for dataset, error in enumerate(values):
            spec = {"algorithmRef": {"name": name}, "datasetRef": {"name": f"dataset-{dataset}"}}
            number = 2 * (3 * at + dataset)
            runs.append(
                records.failed(number, spec=spec)
                if error is None
                else records.run(number, spec=spec, results=[records.result(ate={"rmse": error})])
            )
    return fill(runs)


def test_the_second_is_underlined(three: Path) -> None:
    text = latex(table(three))
    assert r"a & \textbf{1.00} & \textbf{2.00} & \underline{9.00} &" in text
    assert r"b & \underline{2.00} & \underline{3.00} & \textbf{3.00} &" in text
    assert r"c & 4.00 & 4.00 & \textit{OutOfMemory} &" in text
    assert "Bold: best of its column, underlined: second." in text


def test_of_two_rows_none_is_second(study: Path) -> None:
    assert "underline" not in latex(table(study))
    assert "underline" not in latex(table(study, best=Best.NONE))


def test_ranks_and_ratios_are_what_stands_for_all_datasets(three: Path) -> None:
    found = table(three, overall=(Overall.RANK, Overall.RATIO))
    ranks, ratios = found.overall
    assert [one.value for one in ranks.figures] == pytest.approx([(1 + 1 + 2) / 3, (2 + 2 + 1) / 3, 3.0])
    assert [one.value for one in ratios.figures] == pytest.approx([3 ** (1 / 3), 3 ** (1 / 3), math.inf])
    assert [(one.bold, one.second) for one in ranks.figures] == [(True, False), (False, True), (False, False)]
    text = latex(found)
    assert r"\multicolumn{2}{c}{Over datasets}" in text
    assert r"& \textbf{1.33} & \textbf{1.44} &" in text
    assert r"& 3.00 & $\infty$ &" in text
    assert r"$\infty$: of a dataset the median run failed." in text
    assert flat(found)["rank over datasets"][0] == pytest.approx(4 / 3)


def test_where_large_is_good_the_largest_is_bold_and_ranks_first(
    records: Any, fill: Callable[..., Path]
) -> None:
    shares = ((0.9, 0.2), (0.6, 0.8), (0.3, 0.1))
    runs = [
        records.run(
            2 * number + place,
            spec={"algorithmRef": {"name": "abc"[number]}, "datasetRef": {"name": f"dataset-{place}"}},
            results=[records.result(points={"share": share})],
        )
        for number, both in enumerate(shares)
        for place, share in enumerate(both)
    ]
    met = Metric.parse("points.share")
    found = table(fill(runs), metrics=(met,), overall=(Overall.RANK, Overall.RATIO))
    assert bold(found) == [[True, False], [False, True], [False, False]]
    ranks, ratios = found.overall
    assert [one.value for one in ranks.figures] == [1.5, 1.5, 3.0]
    assert [one.value for one in ratios.figures] == pytest.approx([2.0, 1.5**0.5, 24**0.5])
    assert [one.bold for one in ratios.figures] == [False, True, False]


def test_a_rank_on_some_datasets_says_so(three: Path) -> None:
    found = table(three, overall=(Overall.RANK,), where="algorithm != 'b' or dataset == 'dataset-0'")
    assert "(1/3)" in latex(found)
    assert "In parentheses: on how many datasets of all" in latex(found)


def test_metres_are_never_averaged_over_datasets(three: Path) -> None:
    """Whoever leaves the datasets out of the columns gets them as rows."""
    found = table(three, rows=("algorithm",), columns=())
    assert "dataset" in found.keys
    assert len(found.rows) == 9


def test_ieee_has_lines_without_a_package(three: Path) -> None:
    text = latex(table(three), rules=Rules.IEEE)
    assert "rule" not in text.replace("\\arraystretch", "")
    assert text.count(r"\hline") == 4
    assert "usepackage{booktabs}" not in text


def test_markdown_is_the_same_table(three: Path) -> None:
    lines = markdown(table(three, overall=(Overall.RATIO,)), told="Three | of them").splitlines()
    assert lines[0].startswith("Three \\| of them. Mean over tracked runs, n = 0 to 1 each.")
    assert lines[2].startswith("| Algorithm | ATE \\[cm\\], dataset-0 | ATE \\[cm\\], dataset-1 |")
    assert lines[4] == "| a | **1.00** | **2.00** | <u>9.00</u> | **1.44** | 1 | 1 | 1 |"
    assert lines[6] == "| c | 4.00 | 4.00 | *OutOfMemory* | ∞ | 1 | 1 | 0/1 |"
    assert {line.count(" | ") for line in lines[2:7]} == {7}


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


@pytest.mark.slow  # make test needs no LaTeX; make test-packages installs it
def test_latex_takes_it(assorted: Path, study: Path, three: Path, tmp_path: Path) -> None:
    program = shutil.which("pdflatex")
    if program is None:
        pytest.skip("no pdflatex here: sudo apt-get install texlive-latex-recommended")
    where = "dataset in ('dataset-0', 'dataset-1', 'dataset-2')"
    metrics = tuple(
        map(Metric.parse, ("ate.rmse", "usage.cpu.meanCores", "usage.memory.peakBytes", "coverage"))
    )
    tables = [
        table(assorted, rows=("algorithm", "sensors"), metrics=metrics, spread=True, where=where),
        table(assorted, rows=("parameters.nFeatures", "parameters.text"), columns=(), where=where),
    ]
    tables += [
        table(three, overall=(Overall.RANK, Overall.RATIO), spread=True),
        table(study, best=Best.GROUP),
    ]
    body = "\n".join(latex(one, caption="x_y & <z>", rules=rules) for one in tables for rules in Rules)
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
    assert slamhive(study, "paper-table", "-m", "ate.rmse:cm", "--style", "csv")[1] == out
    assert slamhive(study, "paper-table", "--style", "markdown")[1].startswith("Mean over tracked runs")
    assert r"\hline" in slamhive(study, "paper-table", "--style", "ieee")[1]
    assert re.search(r"^algorithm-0 & dataset-0 & ", (tmp_path / "t.tex").read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--overall", "mean"], "--overall: unknown figure over datasets 'mean'; known: rank, ratio"),
        (["--overall", "rank", "--columns", ""], "--overall: ranks and ratios are over datasets"),
        (["--overall", "rank", "-m", "scale"], "--overall: scale: ranks are by a figure that is good"),
        (["--preset", "V"], "--preset: unknown table 'V'"),
        (["-m", "ate.rmes"], "--metric: unknown column 'ate.rmes'; did you mean 'ate.rmse'?"),
        (["-m", "ate.rmse:km"], "ate.rmse:km: 'km' is neither a unit"),
        (["-m", "algorithm"], "--metric: algorithm: a column of numbers is needed"),
        (["--rows", "algo"], "--rows: unknown column 'algo'"),
        (["--columns", "datset"], "--columns: unknown column 'datset'; did you mean 'dataset'?"),
        (["--columns", "cpu.seconds"], "--columns: usage.cpu.seconds is a result"),
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
