# SPDX-License-Identifier: Apache-2.0
"""Answers of a gate as a table, as Markdown for a pull request, and as JUnit ET."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np

from slamhive.analysis.gating.deciding import GateAnswer
from slamhive.analysis.gating.figures import FAILURES, MarginScale
from slamhive.analysis.metrics import Metric
from slamhive.contract.lines import printable
from slamhive.model.base import plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.gating.cells import GateCell, GateRuns
    from slamhive.analysis.gating.deciding import GateFinding
    from slamhive.analysis.gating.figures import GateFigure

HEADINGS = ("figure", "answer", "change", "surely within", "margin", "runs before", "runs now", "remark")
_MARKS = {
    GateAnswer.BETTER: "🟢",
    GateAnswer.NO_WORSE: "🟢",
    GateAnswer.WORSE: "🔴",
    GateAnswer.UNKNOWN: "🟡",
}
_MOST_SETTINGS = 50
_MOST_NAMED = 3


@dataclass(frozen=True)
class GateReport:
    """Answers of a gate, with its runs.

    Attributes:
        title: names of the sweeps.
        baseline: name of the file.
        answer: of the gate as a whole.
        findings: figure by figure.
        cells: settings with their runs.
        seconds: how long it took.
        why: sentence on why it ended.
        notes: further sentences.
    """

    title: str
    baseline: str
    answer: GateAnswer
    findings: Sequence[GateFinding]
    cells: Sequence[GateCell]
    seconds: float
    why: str
    notes: Sequence[str] = field(default=())

    @property
    def sentence(self) -> str:
        """Answer in a sentence, with the figures that decided it."""
        named = [one.figure.title for one in self.findings if one.answer is self.answer]
        runs = sum(cell.now.count for cell in self.cells)
        count = plural(runs, "run")
        what = (
            f": {', '.join(named)}" if self.answer in {GateAnswer.WORSE, GateAnswer.UNKNOWN} and named else ""
        )
        return f"{self.title}: {self.answer}{what} ({count} against {self.baseline}; {self.why})"

    def rows(self) -> list[list[str]]:
        """Return a line of text for each figure."""
        return [self._row(one) for one in self.findings]

    def _row(self, one: GateFinding) -> list[str]:
        figure = one.figure
        remarks = [one.why] if one.why else []
        if one.cells and one.answer in {GateAnswer.WORSE, GateAnswer.UNKNOWN}:
            names = [self.cells[number].name for number in one.cells[:_MOST_NAMED]]
            names += ["…"] if len(one.cells) > _MOST_NAMED else []
            remarks.append(f"stands out: {'; '.join(names)}")
        return [
            figure.title,
            str(one.answer),
            _change(figure, one.shift),
            _within(one),
            _margin(figure),
            str(one.counts[0]),
            str(one.counts[1]),
            ". ".join(remarks),
        ]


def _percent(figure: GateFigure, change: float) -> str:
    unit = " %" if figure.scale is MarginScale.RATIO else " points"
    return f"{100 * change:+.1f}{unit}" if change else f"0{unit}"


def _change(figure: GateFigure, shift: float) -> str:
    return "–" if math.isnan(shift) else _percent(figure, figure.change(shift))


def _within(one: GateFinding) -> str:
    if math.isinf(one.high):
        return "–"
    if math.isinf(one.low):
        return f"at most {_percent(one.figure, one.figure.change(one.high))}"
    low, high = sorted(one.figure.change(end) for end in (one.low, one.high))
    return f"{_percent(one.figure, low)} … {_percent(one.figure, high)}"


def _margin(figure: GateFigure) -> str:
    return _percent(figure, figure.change(figure.bound))


def markdown(report: GateReport) -> str:
    """Return the Markdown of a pull request's comment: what it came to, figures, settings."""
    mark = _MARKS[report.answer]
    lines = [f"### {mark} {_cell(report.sentence)}", "", *_table(HEADINGS, report.rows()), ""]
    lines += [f"- {_cell(note)}" for note in report.notes]
    shown = [one.figure for one in report.findings]
    if shown and report.cells:
        rows = [
            [cell.name, *(_sides(figure, cell) for figure in shown)] for cell in report.cells[:_MOST_SETTINGS]
        ]
        heads = ["setting", *(figure.title for figure in shown)]
        lines += ["", "<details><summary>Settings: medians before → now</summary>", "", *_table(heads, rows)]
        if more := len(report.cells) - _MOST_SETTINGS:
            lines += ["", f"and {more} more"] if more > 0 else []
        lines += ["", "</details>"]
    return "\n".join(lines) + "\n"


def recorded_markdown(title: str, baseline: str, words: str, notes: Sequence[str]) -> str:
    """Return the Markdown of a gate that had nothing to compare with and recorded it.

    Args:
        title: names of the sweeps.
        baseline: name of the file.
        words: what is in it.
        notes: further sentences.
    """
    lines = [
        f"### 🟡 {_cell(title)}: no baseline yet, so nothing was compared",
        "",
        f"Recorded {_cell(baseline)}: {_cell(words)}. Commit that file, and the next gate compares with it.",
        *(f"- {_cell(note)}" for note in notes),
    ]
    return "\n".join(lines) + "\n"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    found = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(_cell(text) for text in row)} |" for row in found]


def _cell(text: str) -> str:
    """Return a text so that Markdown takes nothing in it for more."""
    plain = printable(text).replace("\\", "\\\\").replace("|", "\\|").replace("&", "&amp;")
    return plain.replace("<", "&lt;").replace("`", "\\`").replace("[", "\\[").replace("@", "&#64;")


def _sides(figure: GateFigure, cell: GateCell) -> str:
    return f"{_side(figure, cell.before)} → {_side(figure, cell.now)}"


def _side(figure: GateFigure, runs: GateRuns) -> str:
    if figure.name == FAILURES:
        return f"{runs.failed} of {runs.count}"
    numbers = runs.numbers(figure.name, logarithms=False)
    if not len(numbers):
        return "–"
    metric = Metric.parse(figure.name)
    unit = f" {metric.unit}" if metric.unit else ""
    return f"{metric.show(float(np.median(numbers)))}{unit}"


def junit(report: GateReport) -> str:
    """Return JUnit XML: a test case a figure; worse is a failure, what nobody can tell is skipped."""
    answers = [one.answer for one in report.findings]
    suite = ET.Element(
        "testsuite",
        name=printable(f"slamhive gate {report.title}"),
        tests=str(len(answers)),
        failures=str(answers.count(GateAnswer.WORSE)),
        errors="0",
        skipped=str(answers.count(GateAnswer.UNKNOWN)),
        time=f"{report.seconds:.1f}",
    )
    for one, row in zip(report.findings, report.rows(), strict=True):
        case = ET.SubElement(suite, "testcase", classname="slamhive.gate", name=one.figure.name)
        text = "; ".join(f"{head}: {value}" for head, value in zip(HEADINGS, row, strict=True) if value)
        if one.answer is GateAnswer.WORSE:
            ET.SubElement(case, "failure", message=printable(text))
        elif one.answer is GateAnswer.UNKNOWN:
            ET.SubElement(case, "skipped", message=printable(text))
        else:
            ET.SubElement(case, "system-out").text = printable(text)
    found = io.BytesIO()
    ET.ElementTree(suite).write(found, encoding="utf-8", xml_declaration=True)
    return found.getvalue().decode() + "\n"
