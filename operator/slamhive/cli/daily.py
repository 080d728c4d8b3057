# SPDX-License-Identifier: Apache-2.0
"""Comparison of an edit with what was before it, shown at the end of ``slamhive run``, with a test."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from slamhive.analysis.edits import NOT_TRACKED, edits
from slamhive.analysis.expressions import ExpressionError
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.metrics import Metric
from slamhive.analysis.selection import Selection, choose
from slamhive.cli.parts import tables
from slamhive.cli.parts.console import emit, out, plural, remark, speaks_json
from slamhive.cli.results import TABLE_METRICS, usual_columns
from slamhive.local.running.outlook import moment_text
from slamhive.model.errors import InputError
from slamhive.tables.reading import read_archive
from slamhive.tables.text import key_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.edits import Edit, EditLine
    from slamhive.local.home.folder import Home
    from slamhive.local.running.runner import Job

_RAW = (
    "before and after: geometric means over the settings that ran with both, each by the median of its "
    "repetitions; p is of each line by itself"
)

_LOAD = (
    "CPU and memory of before and after were measured at different times: what else the machine did then is "
    "part of them"
)


def errors_before(job: Job, home: Home) -> Mapping[int, float]:
    """Return the median error before an edit of each setting, m, by its number.

    Of settings whose earlier runs stood in the same place of the same sweep, as far as they were tracked.
    """
    outlook = job.outlook
    if outlook is None or not outlook.replaced:
        return {}
    uids = {run.uid: index // job.points.repetitions for index, run in outlook.replaced.items()}
    frame = read_archive(home.archive_url, home.path / "cache")
    frame = frame.select(where_equal(frame, "sweep", job.sweep.name) & frame.column("ate.rmse").present)
    found: dict[int, list[float]] = {}
    names = frame.column("uid").tolist()
    for uid, error in zip(names, frame.column("ate.rmse").floats().tolist(), strict=True):
        if uid in uids:
            found.setdefault(uids[uid], []).append(error)
    return {row: float(np.median(errors)) for row, errors in found.items()}


def show_edits(job: Job, home: Home) -> None:
    """Show what the edits did that made runs of a job stale; nothing where there were none."""
    outlook = job.outlook
    if outlook is None or not outlook.replaced:
        return
    names = _edited(job)
    frame = read_archive(home.archive_url, home.path / "cache")
    chosen = choose(frame, Selection((job.sweep.name,), superseded=True)).frame
    metrics = usual_columns(TABLE_METRICS, chosen, filled=True)
    if not metrics:
        return
    found, notes = edits(chosen, metrics, names)
    for edit in found:
        if speaks_json():
            _emit(job, edit)
        else:
            _print(job, edit)
    if found and not speaks_json():
        remark(_RAW)
        remark(_LOAD)
    for note in notes:
        remark(note)


def to_do_again(jobs: Sequence[Job], home: Home, condition: str) -> None:
    """Have finished runs of jobs done again whose results meet a condition.

    Raises:
        InputError: the condition can't be understood.
    """
    frame = read_archive(home.archive_url, home.path / "cache")
    for job in jobs:
        own = frame.select(where_equal(frame, "sweep.uid", job.uid))
        if not len(own):
            remark(f"--rerun-where: no run of {job.sweep.name} has finished yet")
            continue
        try:
            met = choose(own, Selection(where=condition, superseded=True, each=True)).frame
        except ExpressionError as error:
            raise InputError(f"--rerun-where: {error}") from None
        uids = set(met.column("uid").tolist())
        job.again |= {index for index in range(len(job.points)) if job.run_uid(index) in uids}
        if not job.again:
            remark(f"--rerun-where: no finished run of {job.sweep.name} meets it")


def _edited(job: Job) -> set[str]:
    """Return the names of the algorithms and datasets of the runs that were made otherwise before."""
    found = set()
    for index in job.outlook.replaced if job.outlook is not None else ():
        spec = job.points.point(index).spec
        found |= {spec["algorithmRef"]["name"], spec["datasetRef"]["name"]}
    return found


def _why(job: Job, edit: Edit) -> str:
    """Return the parts that were edited, as far as they are known, as the end of a sentence."""
    if job.outlook is None:
        return ""
    words = dict.fromkeys(
        word
        for index, why in job.outlook.why.items()
        if job.points.point(index).spec[f"{edit.changed}Ref"]["name"] == edit.name
        for word in why
    )
    return f": {', '.join(words)} changed" if words else ""


def _print(job: Job, edit: Edit) -> None:
    since = (
        f" ({moment_text(datetime.fromtimestamp(edit.before.last, UTC))})"
        if edit.before.last is not None
        else ""
    )
    out.print()
    out.print(
        f"Before and after: {edit.name} {edit.before.version}{since} → {edit.after.version}{_why(job, edit)}",
        markup=False,
        style="bold",
    )
    if not edit.settings:
        remark("no setting has run with both versions yet")
        return
    keys = list(dict.fromkeys(key for line in edit.lines for key in line.keys))
    keys = [name for name in keys if name == "dataset" or _varies(edit.lines, name)]
    headings = [*keys, "figure", "before", "after", "change", "better", "worse", "same", "chance"]
    lines, last = [], None
    for line in edit.lines:
        told = [key_text(line.keys.get(name)) for name in keys]
        lines.append([*(told if told != last else [""] * len(told)), *_texts(line)])
        last = told
    tables.show(out, headings, lines)
    if edit.unpaired:
        settings = plural(edit.unpaired, "setting")
        remark(f"{settings} of the sweep ran with one of the two versions alone: not compared")
    if any(edit.disturbed):
        before, after = edit.disturbed
        counts = f"{before} of {edit.before.runs} runs before and {after} of {edit.after.runs} after"
        remark(f"{counts} shared their cores with other work or were throttled: mind that in CPU and memory")


def _varies(lines: Sequence[EditLine], name: str) -> bool:
    return len({str(line.keys.get(name)) for line in lines}) > 1


def _texts(line: EditLine) -> list[str]:
    if line.of is not None:
        sides = [
            f"{value:.0f} of {count}" for value, count in zip((line.before, line.after), line.of, strict=True)
        ]
        title, change = NOT_TRACKED, _difference(line.after - line.before)
    else:
        metric = Metric.parse(line.metric)
        sides = ["failed" if math.isinf(value) else metric.show(value) for value in (line.before, line.after)]
        title, change = metric.title, _percent(line.ratio)
    verdict = line.verdict or ("deterministic" if line.deterministic else "the same")
    return [title, *sides, change, *(str(count) for count in line.wins), verdict]


def _difference(number: float) -> str:
    return f"{number:+.0f}" if number else "0"


def _percent(ratio: float) -> str:
    """Return a ratio as the change that people speak of."""
    if math.isnan(ratio):
        return "–"
    if ratio >= 10:
        return f"× {ratio:.3g}"
    return f"{(ratio - 1) * 100:+.1f} %" if ratio != 1 else "0 %"


def _emit(job: Job, edit: Edit) -> None:
    for line in edit.lines:
        emit(
            "compared",
            sweep=job.sweep.name,
            changed=edit.changed,
            name=edit.name,
            versionBefore=edit.before.version,
            versionAfter=edit.after.version,
            keys=line.keys,
            figure=line.metric,
            before=_finite(line.before),
            after=_finite(line.after),
            runsBefore=line.of[0] if line.of else None,
            runsAfter=line.of[1] if line.of else None,
            ratio=_finite(line.ratio),
            better=line.wins[0],
            worse=line.wins[1],
            same=line.wins[2],
            deterministic=line.deterministic,
            p=line.p,
            verdict=line.verdict,
        )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
