# SPDX-License-Identifier: Apache-2.0
"""Comparison of an edit with what was before it, shown at the end of ``slamhive run``, with a test."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from slamhive.analysis.edits import NOT_TRACKED, edits
from slamhive.analysis.expressions import ExpressionError
from slamhive.analysis.grouping import LOAD, where_equal
from slamhive.analysis.metrics import Metric
from slamhive.analysis.selection import Selection, choose
from slamhive.cli.parts import tables
from slamhive.cli.parts.console import emit, listing, out, remark, speaks_json
from slamhive.cli.results import TABLE_METRICS, usual_columns
from slamhive.local.running.outlook import moment_text
from slamhive.model.base import plural
from slamhive.model.errors import InputError
from slamhive.tables.reading import read_archive
from slamhive.tables.text import key_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from slamhive.analysis.edits import Edit, EditLine
    from slamhive.analysis.frame import Frame
    from slamhive.archive import EarlierRun
    from slamhive.local.home.folder import Home
    from slamhive.local.running.runner import Job

_PARTS = ("algorithm", "dataset")
_RAW = (
    "before and after: geometric means over the settings that ran with both, each by the median of its "
    "repetitions; p is of each line by itself"
)

_LOAD = (
    "CPU and memory of before and after were measured at different times: what else the machine did then is "
    "part of them; they are of runs that were tracked, and aren't compared where a version has none"
)
_NO_LOAD = "CPU and memory aren't compared: one of the versions has no run that was tracked"


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


def show_edits(jobs: Sequence[Job], home: Home) -> None:
    """Show what the edits did that made runs of jobs stale, one after another; nothing without any.

    Runs of several sweeps are compared together: of each setting it matters what ran, not who asked for it.
    """
    jobs = [job for job in jobs if job.outlook is not None and job.outlook.replaced]
    if not jobs:
        return
    frame = read_archive(home.archive_url, home.path / "cache")
    # Of this workstation: one on a cluster may have the same name.
    chosen = choose(frame, Selection(tuple(f"/{job.sweep.name}" for job in jobs), superseded=True)).frame
    causes = _causes(jobs, chosen)
    metrics = usual_columns(TABLE_METRICS, chosen, filled=True)
    found, notes = edits(chosen, metrics, {key: one.before for key, one in causes.items()})
    sweep = jobs[0].sweep.name if len(jobs) == 1 else None
    for edit in found:
        if speaks_json():
            _emit(sweep, edit)
        else:
            _print(edit, causes[edit.changed, edit.name].words)
    lines = [line for edit in found for line in edit.lines]
    if lines and not speaks_json():
        remark(_RAW)
        remark(_LOAD if any(_is_load(line) for line in lines) else _NO_LOAD)
    compared = {(edit.changed, edit.name) for edit in found if edit.settings}
    untold = {key[1] for key, one in causes.items() if key not in compared and one.together}
    together = {name for key, one in causes.items() if key not in compared for name in one.together}
    if untold and (told := together - untold):
        remark(
            f"{listing(sorted(untold))} was edited together with {listing(sorted(told))}: no run tells what "
            "that edit did, so it is not compared; runs between two edits tell them apart"
        )
    elif together:
        remark(
            f"{listing(sorted(together))} were edited together: no run tells what each edit did, so none is "
            "compared; runs between two edits tell them apart"
        )
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


class _Cause(NamedTuple):
    """An edit of an algorithm or a dataset since its runs were last done.

    Attributes:
        before: the version that they had then; of several that of most of them, the latest of equally many.
        words: the parts that were edited since.
        together: its name and those of what else was edited, where none of these runs was made otherwise by
            it alone.
    """

    before: str
    words: tuple[str, ...]
    together: frozenset[str]


def _causes(jobs: Sequence[Job], frame: Frame) -> dict[tuple[str, str], _Cause]:
    """Return the edits since the runs of jobs were last done, by ``algorithm`` or ``dataset`` and name."""
    versions = dict(
        zip(
            frame.column("provenance.contentHash").tolist(),
            zip(*(frame.column(f"{part}.version").tolist() for part in _PARTS), strict=True),
            strict=True,
        )
    )
    found: dict[tuple[str, str], dict[str, _Runs]] = defaultdict(lambda: defaultdict(_Runs))
    for points, outlook in [(job.points, job.outlook) for job in jobs if job.outlook is not None]:
        for index, run in outlook.replaced.items():
            edited = outlook.edited[index]
            names = {part: str(name) for part, name in points.point(index).short_spec.items()}
            together = {names[part] for part in _PARTS if part in edited}
            for part, version in zip(_PARTS, versions.get(run.content_hash, ()), strict=False):
                if part in edited and version is not None:
                    found[part, names[part]][version].add(run, edited[part], together)
    causes = {}
    for key, sides in found.items():
        before = max(sides, key=lambda version: (sides[version].number, sides[version].last))
        runs = sides[before]
        causes[key] = _Cause(before, tuple(runs.words), frozenset(() if runs.alone else runs.together))
    return causes


@dataclass
class _Runs:
    """Runs of a version before an edit: how many and when, and what was edited since."""

    number: int = 0
    last: float = -math.inf
    words: dict[str, None] = field(default_factory=dict)
    together: set[str] = field(default_factory=set)
    alone: bool = False

    def add(self, run: EarlierRun, words: Sequence[str], together: set[str]) -> None:
        """Add a run, with the parts that were edited, and the names of all that was."""
        self.number += 1
        self.last = max(self.last, run.finished.timestamp() if run.finished is not None else -math.inf)
        self.words |= dict.fromkeys(words)
        self.together |= together
        self.alone |= len(together) == 1


def _print(edit: Edit, words: Sequence[str]) -> None:
    since = (
        f" ({moment_text(datetime.fromtimestamp(edit.before.last, UTC))})"
        if edit.before.last is not None
        else ""
    )
    why = f": {', '.join(words)} changed" if words else ""
    out.print()
    out.print(
        f"Before and after: {edit.name} {edit.before.version}{since} → {edit.after.version}{why}",
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
    if any(edit.disturbed) and any(_is_load(line) for line in edit.lines):
        before, after = (
            f"{count:,} of {plural(runs, 'run')}"
            for count, runs in zip(edit.disturbed, edit.runs, strict=True)
        )
        remark(
            f"{before} before and {after} after shared their cores with other work or were throttled: "
            "mind that in CPU and memory"
        )


def _is_load(line: EditLine) -> bool:
    return line.metric.startswith(LOAD)


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
    # That nothing came of it twice is no equal result.
    nothing = "failed before and after" if line.failed and not any(line.wins) else ""
    verdict = line.verdict or nothing or ("deterministic" if line.deterministic else "the same")
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


def _emit(sweep: str | None, edit: Edit) -> None:
    for line in edit.lines:
        emit(
            "compared",
            sweep=sweep,
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
            failed=line.failed,
            deterministic=line.deterministic,
            p=line.p,
            verdict=line.verdict,
        )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
