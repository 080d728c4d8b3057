# SPDX-License-Identifier: Apache-2.0
"""The sections of a report that say what there is: what was compared, every run, where it comes from."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from slamhive.analysis.derived import PACE
from slamhive.analysis.grouping import Groups, late_notes, varies, varying
from slamhive.analysis.measures import CAUSAL, LATE_SECONDS
from slamhive.analysis.repeating import suspects
from slamhive.model.base import plural
from slamhive.model.results import Outcome
from slamhive.reporting.markup import Markup, clip, element, joined, parse_metric, shown
from slamhive.reporting.tables import Sheet, bold, notes_html
from slamhive.reporting.titles import column_title, keys_text
from slamhive.tables.timeliness import DROPPED, FACTOR, LATENCIES, any_dropped
from slamhive.tables.words import disproportion_notes, meanings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.frame import Frame

MOST_RUNS = 100
"""Runs that are listed; the CSV has more."""

MOST_SAVED = 5000
"""Runs that the page carries along as CSV."""

_MOST_NAMES = 12
_RUN_COLUMNS = (
    *("run", "sweep", "algorithm", "sensors", "dataset", "repetition", "evaluation", "status", "coverage"),
)
_USUAL = (
    *("ate.rmse", f"{CAUSAL}ate.rmse", "rpe[0].rmse", "usage.cpu.secondsPerDataSecond"),
    *("usage.cpu.meanCores", "usage.memory.peakBytes", LATE_SECONDS, *LATENCIES, FACTOR),
)
_PROVENANCE = (
    ("provenance.slamhiveVersion", "measured with slamhive"),
    ("provenance.cpuModel", "processors"),
    ("provenance.machine.governor", "governors of their clocks"),
    ("evaluation", "evaluations"),
    ("alignment", "alignments"),
    ("input.pace", "paces"),
)


def runs_of(frame: Frame) -> int:
    """Return the number of runs in rows of which several may belong to one."""
    return len(np.unique(frame.column("id").floats()))


def overview_section(frame: Frame, notes: Sequence[str] = ()) -> Markup:
    """Return the section on all that was compared: sweeps, algorithms, datasets, settings, ends of runs.

    Args:
        frame: the rows.
        notes: sentences on what is left out of them.
    """
    facts = [("runs", f"{runs_of(frame):,}")]
    for name, title in (
        ("sweep", "sweeps"),
        ("algorithm", "algorithms"),
        ("sensors", "sensor modes"),
        ("dataset", "datasets"),
    ):
        values = _values(frame, name)
        if values:
            facts.append((f"{len(values)} {title}" if len(values) > 1 else title, _listed(values)))
    settings = varying(frame)
    if settings:
        facts.append(("settings that vary", _listed(settings)))
    parts = [_facts(facts), _outcomes_sheet(frame).html()]
    warnings = [f"{keys_text(one.keys)}: {one.sentence}" for one in suspects(frame)]
    return joined([*parts, notes_html([*notes, *warnings, *disproportion_notes(frame)])])


def _outcomes_sheet(frame: Frame) -> Sheet:
    """Count what became of the runs of each algorithm."""
    words = _values(frame, "status")
    words = sorted(words, key=lambda word: (word != Outcome.TRACKED.value, word))
    names = ["algorithm", *(name for name in ("sensors", "evaluation") if varies(frame, name))]
    groups = Groups(frame, names)
    lines, rows = [], []
    for members, keys in zip(groups.members(), groups.keys, strict=True):
        part = frame.select(members)
        found = part.column("status").tolist()
        counts = {word: found.count(word) for word in words}
        total = len(found)
        tracked = counts.get(Outcome.TRACKED.value, 0)
        lines.append(
            [
                *(shown(value) for value in keys.values()),
                str(total),
                f"{tracked / total:.0%}",
                *(str(count) if count else "" for count in counts.values()),
            ]
        )
        rows.append({**keys, "runs": total, **counts})
    headings = [*((name, False) for name in names), ("runs", True), ("tracked share", True)]
    headings += [(clip(word, 40), True) for word in words]
    columns = {name: [row.get(name) for row in rows] for name in rows[0]} if rows else None
    return Sheet("outcomes", "What became of the runs", headings, lines, columns)


def runs_section(frame: Frame, metric: str) -> Markup:
    """Return every run with its figures."""
    metrics = list(dict.fromkeys([metric, *_USUAL, *([DROPPED] if any_dropped(frame) else [])]))
    metrics = [name for name in metrics if not frame.column(name).is_empty]
    paces = [PACE] if varies(frame, PACE) else []
    settings = [name for name in [*paces, *varying(frame)] if name != "repetition"][:_MOST_NAMES]
    names = [name for name in _RUN_COLUMNS if not frame.column(name).is_empty]
    order = np.lexsort(
        [frame.column(name).ranks() for name in ("repetition", "dataset", "sensors", "algorithm")]
    )
    ordered = frame.select(order)
    # What was varied stands where it is seen without moving the table.
    behind = names.index("algorithm") + 1 if "algorithm" in names else 0
    names[behind:behind] = told = [name for name in settings[:4] if name not in names]
    units = [parse_metric(name) for name in metrics]
    first = ordered.select(np.arange(min(len(ordered), MOST_RUNS)))
    lines = [
        [*(_cell(name, row[name]) for name in names), *(unit.show(row[unit.column]) for unit in units)]
        for row in first.records(list(dict.fromkeys([*names, *metrics, *settings])))
    ]
    headings = [
        (column_title(name, names) if name in told else name, name in {"repetition", "coverage", *told})
        for name in names
    ]
    headings += [(unit.title_among(metrics), True) for unit in units]
    saved = ordered.select(np.arange(min(len(ordered), MOST_SAVED)))
    wanted = list(dict.fromkeys(["uid", *_RUN_COLUMNS, "reason", "outcome", *metrics, *settings]))
    columns = {name: saved.column(name).tolist() for name in wanted}
    caption = f"{plural(len(ordered), 'row')}, one a run and evaluation"
    if len(ordered) > len(lines):
        caption += f"; the first {len(lines):,} are shown"
    if len(ordered) > MOST_SAVED:
        caption += f", the first {MOST_SAVED:,} are in the CSV (slamhive results export writes all)"
    shown_names = [*names, *metrics]
    sheet = Sheet("runs", caption, headings, lines, columns)
    return joined(
        [sheet.html(), notes_html([*meanings(frame, shown_names), *late_notes(frame, shown_names)])]
    )


def _cell(name: str, value: Any) -> Any:
    if name == "coverage" and isinstance(value, float):
        return f"{value:.3f}"
    if name == "status" and value != Outcome.TRACKED.value:
        return bold(shown(value))
    return shown(value)


def provenance_section(frame: Frame, made: Mapping[str, str], filters: Sequence[str]) -> Markup:
    """Return the section on the origin of the figures.

    Args:
        frame: the runs.
        made: what is to know of the report itself.
        filters: what was chosen, in words.
    """
    facts = [(title, text) for title, text in made.items()]
    facts.append(("chosen", "; ".join(filters) or "every run of the archive"))
    facts += [(title, _listed(_values(frame, name))) for name, title in _PROVENANCE if _values(frame, name)]
    finished = frame.column("finished")
    if not finished.is_empty:
        times = finished.numbers[finished.present]
        first, last = (str(finished.plain(float(end)))[:10] for end in (times.min(), times.max()))
        facts.append(("runs ended", first if first == last else f"{first} to {last}"))
    return joined([_facts(facts), *_versions(frame)])


def _versions(frame: Frame) -> list[Markup]:
    """Return tables of the software and data that each algorithm and dataset stands for."""
    sheets = []
    for name, columns in (
        ("algorithm", ("provenance.version", "provenance.imageID", "provenance.environment")),
        ("dataset", ("provenance.datasetSha256",)),
    ):
        held = [column for column in columns if not frame.column(column).is_empty]
        if not held:
            continue
        keys = Groups(frame, (name, *held)).keys
        lines = [[shown(value) for value in key.values()] for key in keys]
        headings = [(title.removeprefix("provenance."), False) for title in (name, *held)]
        columns_of = {title: [key[title] for key in keys] for title in (name, *held)}
        sheets.append(
            Sheet(f"{name}-versions", f"Versions of each {name}", headings, lines, columns_of).html()
        )
    return sheets


def _facts(facts: Sequence[tuple[str, str]]) -> Markup:
    return element(
        "dl",
        *(part for title, text in facts for part in (element("dt", title), element("dd", clip(text, 1200)))),
    )


def _values(frame: Frame, name: str) -> list[Any]:
    return [value for value in frame.column(name).unique() if value is not None]


def _listed(values: Sequence[Any]) -> str:
    named = ", ".join(clip(value, 80) for value in values[:_MOST_NAMES])
    left = len(values) - _MOST_NAMES
    return f"{named} and {left} more" if left > 0 else named
