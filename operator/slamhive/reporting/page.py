# SPDX-License-Identifier: Apache-2.0
"""A report: one HTML page that needs nothing but itself, to be put beside a paper.

There is no script in it, and its content security policy allows neither one nor any request.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from slamhive import __version__
from slamhive.analysis import Outcomes
from slamhive.analysis.boards import COMPETITORS
from slamhive.analysis.grouping import aggregate
from slamhive.analysis.measures import Better, measure_of
from slamhive.analysis.metrics import declared_units
from slamhive.model.base import plural
from slamhive.reporting.charts import study_chart
from slamhive.reporting.conclusions import conclusion
from slamhive.reporting.drawing import legend
from slamhive.reporting.markup import Markup, clip, element, joined, parse_metric, shown
from slamhive.reporting.overview import overview_section, provenance_section, runs_of, runs_section
from slamhive.reporting.sections import (
    RATIOS,
    comparison_section,
    figure,
    fronts_section,
    leaderboard_section,
    timeliness_section,
)
from slamhive.reporting.studies import study
from slamhive.reporting.tables import Sheet, notes_html
from slamhive.reporting.titles import column_title, keys_text
from slamhive.tables.reading import revision, with_figure
from slamhive.tables.text import (
    as_columns,
    cost_mark,
    failures_text,
    flat_summary,
    marked,
    n_of_runs,
    number_text,
    range_text,
    spread_text,
)
from slamhive.tables.timeliness import WORDS
from slamhive.tables.words import meanings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.analysis.cells import Cell
    from slamhive.analysis.frame import Frame
    from slamhive.reporting.questions import Question
    from slamhive.reporting.studies import Study

CPU = ("usage.cpu.secondsPerDataSecond", "usage.cpu.meanCores")
MEMORY = "usage.memory.peakBytes"

_COMMENT = re.compile(r"/\*.*?\*/\s*", re.DOTALL)


@dataclass(frozen=True)
class ReportContents:
    """Choices of what a report shows: its title, metric, competitors, charts and notes.

    Attributes:
        title: its heading.
        metric: column that competitors are ranked by.
        by: columns that tell competitors apart.
        outcomes: which runs have a figure that counts.
        costs: columns that accuracy is drawn against; empty for processor time and memory.
        questions: what else is drawn.
        filters: what was chosen, in words.
        notes: sentences on what is left out.
    """

    title: str = "SLAM comparison"
    metric: str = "ate.rmse"
    by: tuple[str, ...] = COMPETITORS
    outcomes: Outcomes = Outcomes.TRACKED
    costs: tuple[str, ...] = ()
    questions: tuple[Question, ...] = ()
    filters: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def report_html(frame: Frame, contents: ReportContents, now: datetime | None = None) -> str:
    """Make the page.

    Args:
        frame: one row a run and evaluation, failed runs beside each evaluation.
        contents: what it shows.
        now: the time it says that it was made.
    """
    with declared_units(frame.units):
        return _html(frame, contents, now or datetime.now(UTC))


def _html(frame: Frame, contents: ReportContents, stamp: datetime) -> str:
    made = {"report made": f"{stamp:%Y-%m-%d} with slamhive {__version__}", "data revision": revision(frame)}
    ranked, left = with_figure(frame, contents.metric)
    sections = [
        ("what", "What was compared", overview_section(frame, contents.notes)),
        _ranked("leaderboard", "Leaderboard", _leaderboard_words(contents), _board(ranked, contents, left)),
        *_timely(ranked, contents),
        _ranked("comparison", "Two by two", _COMPARED, comparison_section(ranked, *_asked(contents))),
        *_fronts(ranked, contents),
        *_studies(contents.questions),
        ("runs", "All runs", runs_section(frame, contents.metric)),
        ("provenance", "Provenance", provenance_section(frame, made, contents.filters)),
    ]
    body = [
        element("section", element("h2", title, id=name), content, aria_labelledby=name)
        for name, title, content in sections
    ]
    links = [element("li", element("a", title, href=f"#{name}")) for name, title, _ in sections]
    runs = plural(runs_of(frame), "run")
    counts = f"{runs} · {stamp:%Y-%m-%d} · slamhive {__version__} · data {revision(frame)}"
    header = element(
        "header",
        element("h1", clip(contents.title, 300)),
        element("p", counts, class_="quiet"),
        *_findings(ranked, contents),
    )
    navigation = element("nav", element("ul", *links), aria_label="Sections")
    return document(contents.title, joined([header, navigation, element("main", *body)]))


def _findings(frame: Frame, contents: ReportContents) -> list[Markup]:
    """Return the sentences on the winner and its cost, where small figures are good."""
    if frame.column(contents.metric).is_empty or measure_of(contents.metric).better is not Better.LOWER:
        return []
    costs = [name for name in (*contents.costs, *CPU) if measure_of(name).better is Better.LOWER]
    cost = next((name for name in costs if not frame.column(name).is_empty), costs[0])
    found = aggregate(frame, [contents.metric, cost], outcomes=contents.outcomes)
    return [element("p", " ".join(clip(one, 400) for one in conclusion(found, contents.metric, cost)))]


def document(title: str, body: Markup, script: str = "") -> str:
    """Return a page that needs nothing but itself, in the report's style.

    Args:
        title: of the page.
        body: what it shows.
        script: the only one that may run in it; empty for none.
    """
    style = _style()
    runs = f"script-src 'sha256-{_digest(script)}'; " if script else ""
    policy = (
        f"default-src 'none'; style-src 'sha256-{_digest(style)}'; {runs}img-src data:; form-action 'none'; "
        "base-uri 'none'"
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", name_="viewport", content_="width=device-width, initial-scale=1"),
        element("meta", http_equiv="Content-Security-Policy", content_=policy),
        element("meta", name_="referrer", content_="no-referrer"),
        element("link", rel="icon", href="data:,"),
        element("title", clip(title, 300)),
        element("style", Markup(style)),
    )
    last = element("script", Markup(script)) if script else None
    page = element("html", head, element("body", body, last), lang="en")
    return f"<!doctype html>\n{page}\n"


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _style() -> str:
    """Return the style of the evaluator's report, whose looks this one shares, with what is added to it."""
    files = (
        importlib.resources.files("slamhive_eval") / "assets" / "report.css",
        importlib.resources.files("slamhive.reporting") / "report.css",
    )
    return "".join(_COMMENT.sub("", file.read_text(encoding="utf-8")) for file in files)


_COMPARED = (
    "One pair of medians a dataset; the ratio is their geometric mean, above 1 A has the smaller figures. "
    "p says how likely such differences are among equals."
)


def _asked(contents: ReportContents) -> tuple[str, tuple[str, ...], Outcomes]:
    return contents.metric, contents.by, contents.outcomes


def _board(frame: Frame, contents: ReportContents, left: list[str]) -> tuple[Markup, list[str]]:
    content, notes = leaderboard_section(frame, *_asked(contents))
    return content, [*meanings(frame, [contents.metric, "coverage"]), *left, *notes]


def _timely(frame: Frame, contents: ReportContents) -> list[tuple[str, str, Markup]]:
    found = timeliness_section(frame, *_asked(contents))
    return [_ranked("timeliness", "When poses came", WORDS, found)] if found else []


def _leaderboard_words(contents: ReportContents) -> str:
    counted = "tracked runs" if contents.outcomes is Outcomes.TRACKED else "all evaluated runs"
    return (
        f"By {parse_metric(contents.metric).title}. Figures are over {counted}; all others are ranked last, "
        "never left out. Competitors are ranked on each dataset; score is the mean rank (0 best, 1 last), "
        f"“{RATIOS[measure_of(contents.metric).better]}” the geometric mean of the ratio to the first. The "
        "interval of a rank is a bootstrap over datasets and repetitions."
    )


def _ranked(
    name: str, title: str, words: str, found: tuple[Markup, Sequence[str]]
) -> tuple[str, str, Markup]:
    content, notes = found
    return name, title, joined([element("p", words, class_="quiet"), content, notes_html(notes)])


def _fronts(frame: Frame, contents: ReportContents) -> list[tuple[str, str, Markup]]:
    costs = list(contents.costs)
    if not costs:
        costs = [name for name in CPU if not frame.column(name).is_empty][:1]
        costs += [MEMORY] if not frame.column(MEMORY).is_empty else []
    words = (
        "Medians of the runs that count, lines their ranges. Full marks on the line are those that nobody "
        "beats in both."
    )
    sections = []
    for number, cost in enumerate(costs):
        title = f"Accuracy against {parse_metric(cost).title}"
        content, notes = fronts_section(frame, (cost, contents.metric), contents.by, contents.outcomes)
        notes = [*meanings(frame, [cost, contents.metric, "coverage"]), *notes]
        sections.append(_ranked(f"pareto-{number + 1}", title, words, (content, notes)))
    return sections


def _studies(questions: Sequence[Question]) -> list[tuple[str, str, Markup]]:
    sections = []
    for number, question in enumerate(questions, 1):
        made = study(question)
        title = question.title or f"{parse_metric(question.y).title} over {column_title(question.x)}"
        sections.append((f"analysis-{number}", clip(title, 200), _study(made, number)))
    return sections


def _study(made: Study, number: int) -> Markup:
    question = made.question
    words = (
        "One mark a run; hollow ones were not tracked, crosses have no figure."
        if question.points
        else "Medians of all runs, failed ones ranked last. Below 10 runs lines are their range and dots the "
        "runs, from 10 on lines are the 95 % interval of the median. Grey bands count failed runs."
    )
    if question.filters:
        words += f" Only {question.filters}."
    names = [keys_text(dict(zip(question.by, values, strict=True))) or "all runs" for values in made.series]
    charts = []
    for panel in made.panels:
        title = keys_text(panel.keys) or "all runs"
        charts.append(figure(title, study_chart(made, panel, title)))
    return joined(
        [
            element("p", words, class_="quiet"),
            legend(names, {names[number] for panel in made.panels for number in made.drawn(panel)}),
            element("div", *charts, class_="grid"),
            _study_sheet(made, number).html(),
            notes_html([*meanings(question.frame, [question.y, "coverage"]), *made.notes]),
        ]
    )


def _study_sheet(made: Study, number: int) -> Sheet:
    metric = parse_metric(made.question.y)
    names = made.found.keys
    headings = [
        *((column_title(name, names), False) for name in names),
        (f"median {metric.title}", True),
        ("mean ± std", True),
    ]
    headings += [("range", True), ("n/runs", True), ("coverage", True), ("failures", False)]
    lines = []
    rows = []
    for cell in made.found.cells:
        summary = cell.figures[metric.column].summary
        lines.append(
            [
                *(shown(cell.keys[name]) for name in names),
                _median_text(cell, metric.column),
                spread_text(metric, summary) + cost_mark(metric.column, reader=cell.reader, late=cell.late),
                range_text(metric, summary),
                f"{n_of_runs(cell)}{marked(cell)}",
                number_text(cell.coverage.mean if cell.coverage else None),
                failures_text(cell.failures, cell.untracked),
            ]
        )
        row = {**cell.keys, "runs": cell.runs, "n": cell.n, "copies": cell.copies, "failures": cell.failures}
        row |= {"median.censored": cell.figures[metric.column].censored_median}
        rows.append(row | flat_summary(metric.column, summary) | flat_summary("coverage", cell.coverage))
    caption = f"{metric.title} by {', '.join(column_title(name, names) for name in names)}"
    return Sheet(f"analysis-{number}", caption, headings, lines, as_columns(rows))


def _median_text(cell: Cell, column: str) -> str:
    figure_, metric = cell.figures[column], parse_metric(column)
    if figure_.censored_median is not None:
        return "failed" if math.isinf(figure_.censored_median) else metric.show(figure_.censored_median)
    return metric.show(figure_.summary.median if figure_.summary else None)
