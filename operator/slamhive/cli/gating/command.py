# SPDX-License-Identifier: Apache-2.0
"""The command ``slamhive gate``: options, recording, and what is told in the end.

It ends with 0 where all figures are better or no worse; with 4 where one is worse; with 3 where nobody can
tell; with 1 where the machine was in the way; with 2 on wrong input; with 130 when it was interrupted.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from slamhive import __version__
from slamhive.analysis.gating.deciding import GateAnswer
from slamhive.analysis.gating.figures import (
    MARGINS,
    USUAL_MARGIN,
    GateFigure,
    parse_figure,
)
from slamhive.cli.gating.course import Comparing, compare
from slamhive.cli.gating.repeating import begun
from slamhive.cli.gating.runs import (
    GateSweep,
    GateWish,
    collect,
    do_round,
    few_repetitions,
    number_or_none,
    recorded_columns,
    sweeps_under_test,
    tell_disturbed,
)
from slamhive.cli.parts import tables
from slamhive.cli.parts.console import emit, open_workbench, out, remark, speak_json, speaks_json
from slamhive.cli.parts.exits import FAILED, INTERRUPTED, UNKNOWN, WORSE
from slamhive.cli.plans import Files
from slamhive.cli.running import (
    LogFormat,
    Parallelism,
    ProgressFormat,
    Rerun,
    algorithms_of,
    tell_of,
)
from slamhive.engine import LoadConditions
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.home.sweeping import require_own_name
from slamhive.local.programs.engines import ContainerChoice
from slamhive.model.base import plural, seconds
from slamhive.model.errors import InputError
from slamhive.model.sweep import Budget
from slamhive.monitor.measuring.processes import forbid_inspection
from slamhive.monitor.programs.orphans import write_atomically
from slamhive.reporting.gate.baseline import Baseline, read_baseline
from slamhive.reporting.gate.summaries import HEADINGS, GateReport, junit, markdown, recorded_markdown

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from slamhive.local.running.workbench import Workbench

_ENDS = {GateAnswer.WORSE: WORSE, GateAnswer.UNKNOWN: UNKNOWN, GateAnswer.NO_WORSE: 0, GateAnswer.BETTER: 0}


def gate(
    files: Files,
    *,
    baseline: Annotated[
        Path | None, typer.Option("--baseline", metavar="FILE", help="Compare with what is recorded there.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help="Run all and record it there.")
    ] = None,
    or_record: Annotated[
        bool, typer.Option("--or-record", help="Record the baseline where it isn't there yet.")
    ] = False,
    tier: Annotated[
        str | None, typer.Option("--tier", metavar="TIER", help="Only sweeps with this label tier.")
    ] = None,
    figure: Annotated[
        list[str] | None,
        typer.Option("--figure", metavar="NAME[=MARGIN]", help="Only these figures; may be repeated."),
    ] = None,
    margin: Annotated[
        list[str] | None,
        typer.Option("--margin", metavar="NAME=MARGIN", help="By how much one may be worse: cpu=20%."),
    ] = None,
    repetitions: Annotated[
        int | None,
        typer.Option(
            "--repetitions", min=1, max=1000, help="Of a setting at most; default: the sweep's, or 10."
        ),
    ] = None,
    budget: Annotated[
        str | None, typer.Option("--budget", metavar="DURATION", help="Start no run after so long: 20m.")
    ] = None,
    rerun: Rerun = False,
    summary: Annotated[
        Path | None, typer.Option("--summary", metavar="FILE", help="Write it as Markdown.")
    ] = None,
    junit_file: Annotated[
        Path | None, typer.Option("--junit", metavar="FILE", help="Write it as JUnit XML.")
    ] = None,
    parallelism: Parallelism = None,
    log_format: LogFormat = ProgressFormat.TEXT,
    container: Annotated[
        ContainerChoice | None, typer.Option("--container", help="As of slamhive run.")
    ] = None,
) -> None:
    """Tell whether an algorithm has become worse than what was recorded, by as few runs as make it sure.

    Ends with 0: better or no worse within the margins; 4: worse; 3: can't tell; 1 if the machine was in the
    way, 2 on wrong input, 130 when interrupted; the same command then goes on.

    Example: slamhive gate algorithm.yaml sweep.yaml --baseline baseline.json --budget 20m
    """
    speak_json(wanted=log_format is ProgressFormat.JSON)
    if (baseline is None) == (record is None):
        raise InputError("give one of --baseline FILE, to compare, and --record FILE, to make one")
    if or_record and baseline is not None and not baseline.exists():
        remark(f"{baseline}: not there yet: it is recorded now, and compared with from the next time on")
        baseline, record = None, baseline
    limit = _seconds(budget)
    wish = GateWish(repetitions, limit, parallelism, None, _figures(figure, margin), bool(figure))
    known = read_baseline(baseline) if baseline is not None else None
    for path in (record, summary, junit_file):
        if path is not None and not path.absolute().parent.is_dir():
            raise InputError(f"{path}: its folder isn't there")
    forbid_inspection()
    home = Home.from_environment()
    with home.sharing("slamhive gate"):
        workshop = load_workshop(home)
        tests = sweeps_under_test(files, workshop, tier, wish)
        for test in tests:
            tell_of(test.sweep, test.points, workshop, container)
        bench = open_workbench(home, workshop, container)
        with bench.archive:
            require_own_name(bench.archive, [test.sweep for test in tests])
            plans = [test.points for test in tests]
            bench.programs.fetch([workshop.algorithm(name) for name in algorithms_of(plans)])

            def decided(wish: GateWish) -> int:
                if known is None or baseline is None:
                    return _record(tests, bench, wish, cast("Path", record), summary)
                comparing = Comparing(known, baseline, summary, junit_file)
                report, faults = compare(tests, bench, wish, comparing)
                return _told(report, comparing, faults=faults)

            code = _repeated(tests, bench, wish, record or baseline, decided) if rerun else decided(wish)
    if speaks_json():
        emit("exit", code=code)
    raise typer.Exit(code)


def _repeated(
    tests: Sequence[GateSweep],
    bench: Workbench,
    wish: GateWish,
    file: Path | None,
    decided: Callable[[GateWish], int],
) -> int:
    """Do a gate whose finished runs are done again, or go on with one that was interrupted."""
    command = [str(file and file.absolute()), *(test.uid for test in tests)]
    with begun(bench.home, command) as (since, keep):
        done = sum(len(test.begun_since(bench, since)) for test in tests)
        if done:
            told = f"{since.astimezone():%Y-%m-%d %H:%M}"
            remark(f"goes on with what was interrupted: {plural(done, 'run')} since {told} stand")
        code = decided(replace(wish, since=since))
        if code == INTERRUPTED:
            keep()
    return code


def _seconds(text: str | None) -> float | None:
    if text is None:
        return None
    from pydantic import ValidationError

    try:
        found = Budget(wall_time=text).wall_time
    except ValidationError:
        found = None
    if not found or seconds(found) < 1:
        raise InputError(f"--budget {text}: expected a duration of at least 1s, such as 90s or 20m")
    return seconds(found)


def _figures(chosen: Sequence[str] | None, margins: Sequence[str] | None) -> list[GateFigure]:
    """Return the figures to look at, as far as there are any.

    Raises:
        InputError: one can't be understood, or a margin is of none of them.
    """
    found = dict(MARGINS)
    if chosen:
        parsed = [parse_figure(text, "--figure") for text in chosen]
        found = {name: share or MARGINS.get(name, USUAL_MARGIN) for name, share in parsed}
    for text in margins or ():
        name, share = parse_figure(text, "--margin")
        if share is None:
            raise InputError(f"--margin {text}: expected NAME=MARGIN, such as {text}=10%")
        if name not in found:
            raise InputError(f"--margin {text}: not among the figures: {', '.join(found)}; --figure adds it")
        found[name] = share
    return [GateFigure(name, share) for name, share in found.items()]


def _record(
    tests: Sequence[GateSweep], bench: Workbench, wish: GateWish, path: Path, summary: Path | None
) -> int:
    """Do all runs and write what they came to."""
    for test in tests:
        for row in test.rows:
            test.ask(row, test.points.repetitions)
    code, fault = do_round(tests, bench, wish, wish.budget)
    if code == INTERRUPTED:
        remark("interrupted; the same command goes on from here")
        return code
    rows = [collect(test, bench, recorded_columns(wish)) for test in tests]
    cells = [cell for one in rows for cell in one.cells.values()]
    for sentence in (sentence for one in rows for sentence in one.faults):
        remark(sentence)
    shared = LoadConditions.common(set().union(*(one.conditions for one in rows))) or LoadConditions(None)
    if not cells:
        remark("no run has finished: nothing is recorded")
        return FAILED
    made = Baseline(
        processor=shared.processor,
        machine=shared.machine,
        recorded=f"{datetime.now(UTC):%Y-%m-%d}",
        version=__version__,
        cells=cells,
    )
    made.write(path)
    count = [len(cell.tracked) for cell in cells]
    failed = sum(len(cell.tracked) - sum(cell.tracked) for cell in cells)
    each = f"{min(count)}" if min(count) == max(count) else f"{min(count)} to {max(count)}"
    size = f"{path.stat().st_size:,} bytes"
    words = f"{plural(len(cells), 'setting')}, {each} runs each, {failed} not tracked, {size}"
    if speaks_json():
        emit("baseline", path=str(path), settings=len(cells), runs=sum(count), notTracked=failed)
    else:
        out.print(f"Baseline:   {path}: {words}", markup=False, soft_wrap=True)
    notes = few_repetitions(cells)
    for one in rows:
        tell_disturbed(one, notes.append)
    for sentence in notes:
        remark(sentence)
    if summary is not None:
        title = ", ".join(test.named for test in tests)
        _write(summary, recorded_markdown(title, path.name, words, notes))
    missing = len(cells) < sum(len(test.rows) for test in tests) or any(one.faults for one in rows)
    return FAILED if fault or missing else 0


def _told(report: GateReport | None, comparing: Comparing, *, faults: bool) -> int:
    """Print a report, write the files that were asked for, and return the exit code."""
    if report is None:
        remark("interrupted; the same command goes on from here")
        return INTERRUPTED
    _tell(report, comparing)
    return FAILED if faults and report.answer is not GateAnswer.WORSE else _ENDS[report.answer]


def _tell(report: GateReport, comparing: Comparing) -> None:
    if speaks_json():
        for one in report.findings:
            emit(
                "gate",
                figure=one.figure.name,
                answer=str(one.answer),
                margin=one.figure.margin,
                change=number_or_none(one.figure.change(one.shift)),
                runsBefore=one.counts[0],
                runsNow=one.counts[1],
                why=one.why or None,
                settings=[report.cells[number].name for number in one.cells],
            )
        emit("answer", answer=str(report.answer), sentence=report.sentence)
    else:
        tables.show(out, HEADINGS, report.rows())
        out.print()
        out.print(report.sentence, markup=False, soft_wrap=True)
    for note in report.notes:
        remark(note)
    for path, text in ((comparing.summary, markdown), (comparing.junit, junit)):
        if path is not None:
            _write(path, text(report))


def _write(path: Path, text: str) -> None:
    try:
        write_atomically(str(path), text)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
