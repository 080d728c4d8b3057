# SPDX-License-Identifier: Apache-2.0
"""``slamhive gate``: runs of now against recorded ones, with an answer that a pull request can be refused by.

It ends with 0 where all figures are better or no worse; with 4 where one is worse; with 3 where nobody can
tell; with 1 where the machine was in the way; with 2 on wrong input; with 130 when it was interrupted.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slamhive import __version__
from slamhive.analysis.gating.cells import GateCell, GateRuns
from slamhive.analysis.gating.deciding import Answer, Gate
from slamhive.analysis.gating.figures import (
    COVERAGE,
    FAILURES,
    LATENCY,
    MARGINS,
    MEMORY,
    TIME,
    USUAL_MARGIN,
    GateFigure,
    parse_figure,
)
from slamhive.analysis.gating.ordering import next_runs
from slamhive.analysis.grouping import where_equal
from slamhive.analysis.measures import measure_of
from slamhive.analysis.measuring import settings_hash
from slamhive.cli.parts import tables
from slamhive.cli.parts.checked import check_files
from slamhive.cli.parts.console import (
    emit,
    listing,
    open_workbench,
    out,
    plural,
    remark,
    speak_json,
    speaks_json,
)
from slamhive.cli.parts.exits import FAILED, INTERRUPTED, UNKNOWN, WORSE
from slamhive.cli.parts.planning import planned
from slamhive.cli.parts.progress import Naming
from slamhive.cli.plans import Files
from slamhive.cli.running import ProgressFormat, algorithms_of, drive, measure_all, tell_of
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.home.sweeping import require_own_name
from slamhive.local.programs.engines import ContainerChoice
from slamhive.local.running.choosing import RunChoice
from slamhive.local.running.runner import Job
from slamhive.model.base import NAME_LIMIT, seconds
from slamhive.model.canonical import digest, normalize
from slamhive.model.errors import InputError
from slamhive.model.results import Phase, Reason
from slamhive.model.sweep import Budget, Sweep
from slamhive.monitor.measuring.processes import forbid_inspection
from slamhive.monitor.programs.orphans import write_atomically
from slamhive.plan import local_uid
from slamhive.reporting.gate.baseline import Baseline, BaselineCell, columns_of, read_baseline
from slamhive.reporting.gate.summaries import HEADINGS, GateReport, junit, markdown
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from slamhive.local.home.catalog import Workshop
    from slamhive.local.running.workbench import Workbench
    from slamhive.plan import Plan

USUAL_REPETITIONS = 10
"""Repetitions of a setting, recorded and at most tried, of a sweep that has none of its own."""

TIER = "tier"
"""Label of sweeps by which ``--tier`` chooses."""

_SUFFIX = "-gate"
_ENDS = {Answer.WORSE: WORSE, Answer.UNKNOWN: UNKNOWN, Answer.NO_WORSE: 0, Answer.BETTER: 0}


def gate(
    files: Files,
    *,
    baseline: Annotated[
        Path | None, typer.Option("--baseline", metavar="FILE", help="Compare with what is recorded there.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help="Run all and record it there.")
    ] = None,
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
    rerun: Annotated[bool, typer.Option("--rerun", help="Do finished runs again, reuse nothing.")] = False,
    summary: Annotated[
        Path | None, typer.Option("--summary", metavar="FILE", help="Write it as Markdown.")
    ] = None,
    junit_file: Annotated[
        Path | None, typer.Option("--junit", metavar="FILE", help="Write it as JUnit XML.")
    ] = None,
    parallelism: Annotated[
        int | None, typer.Option("-j", "--parallelism", min=1, help="Runs at the same time at most.")
    ] = None,
    log_format: Annotated[
        ProgressFormat, typer.Option("--log-format", help="Lines of text, or of JSON on standard output.")
    ] = ProgressFormat.TEXT,
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
    limit = _seconds(budget)
    wish = GateWish(repetitions, limit, parallelism, rerun, _figures(figure, margin), bool(figure))
    known = read_baseline(baseline) if baseline is not None else None
    for path in (record, summary, junit_file):
        if path is not None and not path.absolute().parent.is_dir():
            raise InputError(f"{path}: its folder isn't there")
    forbid_inspection()
    home = Home.from_environment()
    with home.sharing("slamhive gate"):
        workshop = load_workshop(home)
        tests = _tests(files, workshop, tier, wish)
        for test in tests:
            tell_of(test.sweep, test.points, workshop, container)
        bench = open_workbench(home, workshop, container)
        with bench.archive:
            require_own_name(bench.archive, [test.sweep for test in tests])
            plans = [test.points for test in tests]
            bench.programs.fetch([workshop.algorithm(name) for name in algorithms_of(plans)])
            if record is not None:
                code = _record(tests, bench, wish, record)
            else:
                assert known is not None and baseline is not None
                code = _compare(tests, bench, wish, Comparing(known, baseline, summary, junit_file))
    if speaks_json():
        emit("exit", code=code)
    raise typer.Exit(code)


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


@dataclass(frozen=True)
class GateWish:
    """Options of a gate's runs.

    Attributes:
        repetitions: of a setting at most; None for the sweep's own.
        budget: seconds after which none is started.
        parallelism: runs at the same time at most.
        rerun: whether finished runs are done again.
        figures: what is looked at.
        chosen: whether the figures were named.
    """

    repetitions: int | None
    budget: float | None
    parallelism: int | None
    rerun: bool
    figures: Sequence[GateFigure]
    chosen: bool


@dataclass(frozen=True)
class Comparing:
    """What is compared with, and where it is told.

    Attributes:
        known, path: the baseline and its file.
        summary, junit: files to write.
    """

    known: Baseline
    path: Path
    summary: Path | None
    junit: Path | None


@dataclass
class GateSweep:
    """A sweep under test.

    Attributes:
        named: its own name; that of its runs is another, as they are no version of it.
        sweep, points: with as many repetitions as may be done.
        asked: repetitions of each row of the plan that were asked for so far.
        batch: numbers of the runs that are asked for now.
    """

    named: str
    sweep: Sweep
    points: Plan
    asked: dict[int, int] = field(default_factory=dict)
    batch: set[int] = field(default_factory=set)

    def ask(self, row: int, count: int) -> None:
        """Ask for more repetitions of a setting."""
        known = self.asked.get(row, 0)
        self.asked[row] = known + count
        self.batch |= {self.index(row, known + k) for k in range(count)}

    @property
    def uid(self) -> str:
        """Identity of the sweep of its runs."""
        return local_uid(self.sweep)

    @property
    def rows(self) -> range:
        """Numbers of the settings."""
        return range(len(self.points) // self.points.repetitions)

    def index(self, row: int, repetition: int = 0) -> int:
        """Return the number of a run."""
        return row * self.points.repetitions + repetition

    def settings(self, row: int) -> tuple[dict[str, Any], str | None]:
        """Return the value on each axis, and the dataset."""
        point = self.points.point(self.index(row))
        found = normalize(dict(point.coordinates))
        assert isinstance(found, dict)
        return found, point.short_spec["dataset"]

    def words(self, row: int) -> str:
        """Return the words that tell a setting from the others."""
        found = Naming(self.points).settings(self.index(row))
        parts = [f"{name.removeprefix('parameters.')} {value}" for name, value in found.items()]
        return ", ".join(parts) or str(self.settings(row)[1])


def _tests(files: Sequence[Path], workshop: Workshop, tier: str | None, wish: GateWish) -> list[GateSweep]:
    """Return the sweeps of manifests, with as many repetitions as may be done.

    Raises:
        InputError: something is wrong in them, there is none, or one is a search.
    """
    checked = check_files(files, workshop)
    checked.refuse()
    sweeps = [sweep for sweep, _ in checked.plans]
    if not sweeps:
        raise InputError(f"{files[0]}: no Sweep or MappingRun in it")
    if tier is not None:
        labels = sorted(
            {str(sweep.metadata.labels[TIER]) for sweep in sweeps if TIER in sweep.metadata.labels}
        )
        sweeps = [sweep for sweep in sweeps if sweep.metadata.labels.get(TIER) == tier]
        if not sweeps:
            known = f"those here have {', '.join(labels)}" if labels else "none here has a label tier"
            raise InputError(f"--tier {tier}: no sweep has it; {known}")
    found = []
    for sweep in sweeps:
        if sweep.spec.search.is_search:
            raise InputError(
                f"Sweep {sweep.name}: a search tries other settings each time: no gate has those"
            )
        own = sweep.spec.repetitions if sweep.spec.repetitions > 1 else USUAL_REPETITIONS
        name = f"{sweep.name[: NAME_LIMIT - len(_SUFFIX)]}{_SUFFIX}"
        longer = sweep.replace(
            metadata=sweep.metadata.replace(name=name),
            spec=sweep.spec.replace(repetitions=wish.repetitions or own),
        )
        found.append(GateSweep(sweep.name, longer, planned(longer, workshop, strict=False)))
    return found


def _round(
    tests: Sequence[GateSweep], bench: Workbench, wish: GateWish, left: float | None
) -> tuple[int, bool]:
    """Do the runs that are asked for now; returns the exit code and whether a file was in the way."""
    jobs = []
    for test in tests:
        if not test.batch:
            continue
        sweep = test.sweep
        if left is not None:
            text = f"{max(1, math.ceil(left))}s"
            sweep = sweep.replace(spec=sweep.spec.replace(budget=sweep.spec.budget.replace(wall_time=text)))
        job = Job(sweep, test.uid, test.points)
        job.asked, test.batch = test.batch, set()
        jobs.append(job)
    code = drive(jobs, bench, RunChoice(rerun=wish.rerun), wish.parallelism)
    return code, code != INTERRUPTED and measure_all(bench, jobs, [])


@dataclass(frozen=True)
class _Rows:
    """Finished runs of a test by row, with what is said of them.

    Attributes:
        cells: by row of the plan.
        faults: sentences on runs in whose way the machine was.
        processors: models.
        reused: number of results that were taken over.
        disturbed: number of runs beside other work.
    """

    cells: dict[int, BaselineCell]
    faults: list[str]
    processors: set[str]
    reused: int
    disturbed: int


def _collect(test: GateSweep, bench: Workbench, columns: Iterable[str]) -> _Rows:
    """Return what the runs came to that were asked for and are finished."""
    frame = read_archive(bench.home.archive_url, bench.home.path / "cache")
    frame = frame.select(where_equal(frame, "sweep.uid", test.uid))
    uids = Job(test.sweep, test.uid, test.points)
    places = {
        uids.run_uid(test.index(row, k)): (row, k) for row, count in test.asked.items() for k in range(count)
    }
    wanted = settings_hash(test.sweep.spec.evaluation)
    names = (
        "uid",
        "status",
        "phase",
        "reason",
        "settings",
        "alignment",
        "dataset",
        "provenance.datasetSha256",
        "provenance.cpuModel",
        "provenance.reusedFrom",
        "usage.memory.kind",
        "disturbed",
    )
    about = {name: frame.column(name).tolist() for name in names}
    numbers = {name: frame.column(name).floats().tolist() for name in columns if name != FAILURES}
    found: dict[int, list[tuple[int, int]]] = defaultdict(list)
    faults, reused, disturbed = [], 0, 0
    for line, uid in enumerate(about["uid"]):
        if uid not in places or about["settings"][line] not in {None, wanted}:
            continue
        row, repetition = places[uid]
        reason = about["reason"][line]
        if reason in set(Reason) and Reason(reason).is_infrastructure:
            faults.append(f"{test.words(row)}, repetition {repetition}: {reason}: not counted")
            continue
        if about["phase"][line] == Phase.SUCCEEDED and about["settings"][line] is None:
            faults.append(f"{test.words(row)}, repetition {repetition}: not measured: not counted")
            continue
        reused += about["provenance.reusedFrom"][line] is not None
        disturbed += about["disturbed"][line] is True
        found[row].append((repetition, line))
    cells = {}
    for row, pairs in sorted(found.items()):
        lines = [line for _, line in sorted(pairs)]
        tracked = [about["status"][line] == "Tracked" for line in lines]
        settings, dataset = test.settings(row)

        def one(name: str, lines: Sequence[int] = lines) -> str | None:
            return next((value for line in lines if (value := about[name][line]) is not None), None)

        cells[row] = BaselineCell(
            sweep=test.named,
            settings=settings,
            dataset=dataset,
            dataset_sha256=one("provenance.datasetSha256"),
            alignment=one("alignment"),
            evaluation=wanted,
            memory=one("usage.memory.kind"),
            tracked=tracked,
            values={
                name: [
                    _number(of[line]) if good or name == COVERAGE else None
                    for line, good in zip(lines, tracked, strict=True)
                ]
                for name, of in numbers.items()
                if not all(math.isnan(of[line]) for line in lines)
            },
        )
    models = {model for model in about["provenance.cpuModel"] if model is not None}
    return _Rows(cells, faults, models, reused, disturbed)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _recorded_columns(wish: GateWish) -> list[str]:
    return list(dict.fromkeys([*MARGINS, *(one.name for one in wish.figures)]))


def _record(tests: Sequence[GateSweep], bench: Workbench, wish: GateWish, path: Path) -> int:
    """Do all runs and write what they came to."""
    for test in tests:
        for row in test.rows:
            test.ask(row, test.points.repetitions)
    code, fault = _round(tests, bench, wish, wish.budget)
    if code == INTERRUPTED:
        remark("interrupted; the same command goes on from here")
        return code
    rows = [_collect(test, bench, _recorded_columns(wish)) for test in tests]
    cells = [cell for one in rows for cell in one.cells.values()]
    for sentence in (sentence for one in rows for sentence in one.faults):
        remark(sentence)
    models = set().union(*(one.processors for one in rows))
    if not cells:
        remark("no run has finished: nothing is recorded")
        return FAILED
    made = Baseline(
        processor=models.pop() if len(models) == 1 else None,
        recorded=f"{datetime.now(UTC):%Y-%m-%d}",
        version=__version__,
        cells=cells,
    )
    made.write(path)
    count = [len(cell.tracked) for cell in cells]
    failed = sum(len(cell.tracked) - sum(cell.tracked) for cell in cells)
    each = f"{min(count)}" if min(count) == max(count) else f"{min(count)} to {max(count)}"
    words = f"{plural(len(cells), 'setting')}, {each} runs each, {failed} not tracked, {path.stat().st_size:,} bytes"
    if speaks_json():
        emit("baseline", path=str(path), settings=len(cells), runs=sum(count), notTracked=failed)
    else:
        out.print(f"Baseline:   {path}: {words}", markup=False, soft_wrap=True)
    for sentence in _few(cells):
        remark(sentence)
    for one in rows:
        _tell_disturbed(one, remark)
    missing = len(cells) < sum(len(test.rows) for test in tests) or any(one.faults for one in rows)
    return FAILED if fault or missing else 0


def _few(cells: Sequence[BaselineCell]) -> list[str]:
    alone = sum(len(cell.tracked) == 1 for cell in cells)
    if not alone:
        return []
    which = "all settings" if alone == len(cells) else plural(alone, "setting")
    return [
        f"{which} of the baseline ran once: how much they vary by themselves can't be told, nor whether a run "
        "that failed now would have failed then; the spread of the new runs is taken for both"
    ]


def _tell_disturbed(rows: _Rows, tell: Any) -> None:
    if rows.disturbed:
        tell(f"{plural(rows.disturbed, 'run')} shared cores with other work: mind that in CPU and time")


@dataclass
class _Pair:
    """A setting that both sides have.

    Attributes:
        test, row: where it is run.
        before: as it was recorded.
    """

    test: GateSweep
    row: int
    before: BaselineCell


def _pairs(tests: Sequence[GateSweep], comparing: Comparing, notes: list[str]) -> list[_Pair]:
    """Return the settings that both sides have; what one of them lacks is noted.

    Raises:
        InputError: they have none in common.
    """
    cells = list(comparing.known.cells)
    rows = [(test, row) for test in tests for row in test.rows]
    if len(cells) == 1 and cells[0].dataset is None:
        if len(rows) != 1:
            raise InputError(
                f"{comparing.path}: of one trajectory of a dataset that it doesn't name, so it stands for one "
                f"setting; the sweep has {len(rows)}"
            )
        return [_Pair(*rows[0], cells[0])]
    with_name = len(tests) > 1 or len({cell.sweep for cell in cells}) > 1

    def key(sweep: str | None, settings: Any, dataset: str | None) -> str:
        return digest(normalize([sweep if with_name else None, settings, dataset]))

    known = {key(cell.sweep, cell.settings, cell.dataset): cell for cell in cells}
    pairs, new = [], []
    for test, row in rows:
        cell = known.pop(key(test.named, *test.settings(row)), None)
        if cell is None:
            new.append(test.words(row))
        else:
            pairs.append(_Pair(test, row, cell))
    if not pairs:
        before = listing(sorted({cell.dataset or "?" for cell in cells}))
        now = listing(sorted({str(test.settings(row)[1]) for test, row in rows}))
        axes = listing(sorted({name for cell in cells for name in cell.settings})) or "none"
        raise InputError(
            f"{comparing.path}: none of its settings is one of the sweep: it was recorded on {before} with the "
            f"axes {axes}, the sweep has {now}; slamhive gate --record makes a baseline of this one"
        )
    if new:
        notes.append(f"not in the baseline, and neither run nor compared: {listing(new)}")
    if known:
        notes.append(
            f"{plural(len(known), 'setting')} of the baseline {'is' if len(known) == 1 else 'are'} not asked for here"
        )
    return pairs


def _compare(tests: Sequence[GateSweep], bench: Workbench, wish: GateWish, comparing: Comparing) -> int:
    """Run until it is known whether something is worse, and tell it."""
    begun = time.monotonic()
    notes: list[str] = []
    pairs = _pairs(tests, comparing, notes)
    notes += _few([pair.before for pair in pairs])
    course = _Course(pairs, bench, wish, comparing)
    why = ""
    while not why:
        left = None if wish.budget is None else wish.budget - (time.monotonic() - begun)
        if left is not None and left <= 0:
            why = f"the budget of {wish.budget:.0f} s is used up"
            break
        wanted = course.wanted()
        if not wanted:
            why = course.ended
            break
        code, course.fault = course.run(wanted, left)
        if code == INTERRUPTED:
            remark("interrupted; the same command goes on from here")
            return code
        spent = wish.budget is not None and time.monotonic() - begun >= wish.budget
        course.look(last=spent or not course.has_more)
        if spent and not course.gate.is_sure:
            why = f"the budget of {wish.budget:.0f} s is used up"
    report = GateReport(
        ", ".join(test.named for test in tests),
        comparing.path.name,
        course.gate.answer,
        course.gate.findings,
        course.cells,
        time.monotonic() - begun,
        why,
        [*notes, *course.notes()],
    )
    _tell(report, comparing)
    faults = course.fault or course.faults
    return FAILED if faults and report.answer is not Answer.WORSE else _ENDS[report.answer]


class _Course:
    """A comparison under way: pairs of settings, the gate, and what was done so far."""

    def __init__(
        self, pairs: Sequence[_Pair], bench: Workbench, wish: GateWish, comparing: Comparing
    ) -> None:
        self._pairs, self._bench, self._wish, self._comparing = pairs, bench, wish, comparing
        self._tests = list({id(pair.test): pair.test for pair in pairs}.values())
        self._most = min(test.points.repetitions for test in self._tests)
        self._columns = columns_of([pair.before for pair in pairs])
        self._rows: list[_Rows] = []
        self._left_out: list[str] = []
        self.cells = [GateCell(self._name(pair), pair.before.runs, GateRuns()) for pair in pairs]
        self.gate = Gate(self._figures())
        self.fault = False

    def _name(self, pair: _Pair) -> str:
        words = pair.test.words(pair.row)
        return f"{pair.test.named}: {words}" if len(self._tests) > 1 else words

    def _figures(self) -> list[GateFigure]:
        """Return the figures that can be looked at: of those not asked for by name only what was recorded."""
        found = list(self._wish.figures)
        if not self._wish.chosen:
            here = self._columns | {FAILURES}
            found = [one for one in found if one.name in here]
            if LATENCY in self._columns:
                found = [one for one in found if one.name != TIME]
        if not any(measure_of(one.name).is_error for one in found) and not self._wish.chosen:
            self._left_out.append("the baseline has no error")
        return found

    @property
    def faults(self) -> list[str]:
        """Sentences on runs in whose way the machine was."""
        return [sentence for one in self._rows for sentence in one.faults]

    @property
    def has_more(self) -> bool:
        """Tell whether a setting may be repeated once more."""
        return any(pair.test.asked.get(pair.row, 0) < self._most for pair in self._pairs)

    @property
    def ended(self) -> str:
        """Sentence on why no run is wanted."""
        if self.gate.is_sure:
            return f"sure after {plural(self.gate.looks, 'look')}"
        return f"{plural(self._most, 'repetition')} of each setting at most"

    def wanted(self) -> dict[int, int]:
        """Return how many more runs of which pairs are to be done."""
        done = [pair.test.asked.get(pair.row, 0) for pair in self._pairs]
        if self.gate.is_sure:
            return {}
        return next_runs(self.cells, self.gate.findings, self._most, done)

    def run(self, wanted: dict[int, int], left: float | None) -> tuple[int, bool]:
        """Do runs; returns the exit code and whether a file was in the way."""
        wish = self._wish
        for number, count in wanted.items():
            self._pairs[number].test.ask(self._pairs[number].row, count)
        found = _round(self._tests, self._bench, wish, left)
        self._rows = [_collect(test, self._bench, _recorded_columns(wish)) for test in self._tests]
        self._check_same()
        return found

    def _check_same(self) -> None:
        """Compare recordings and evaluations with those of the baseline.

        Raises:
            InputError: one is another.
        """
        rows = dict(zip(map(id, self._tests), self._rows, strict=True))
        for number, pair in enumerate(self._pairs):
            now = rows[id(pair.test)].cells.get(pair.row)
            if now is None:
                continue
            for what, before, here in (
                (f"dataset {now.dataset}", pair.before.dataset_sha256, now.dataset_sha256),
                ("evaluation settings", pair.before.evaluation, now.evaluation),
                ("alignment", pair.before.alignment, now.alignment),
            ):
                if before is not None and here is not None and before != here:
                    raise InputError(
                        f"{self._comparing.path}: {self.cells[number].name}: {what}: recorded with {before[:16]}, "
                        f"here {here[:16]}: figures of two of them can't be compared; --record makes a new baseline"
                    )
            self.cells[number] = GateCell(self.cells[number].name, pair.before.runs, now.runs)

    def look(self, *, last: bool) -> None:
        """Decide by what there is."""
        models = set().union(*(one.processors for one in self._rows))
        known = self._comparing.known.processor
        if models and models != {known}:
            here = ", ".join(sorted(models))
            self._leave_out(
                [one for one in self.gate.figures if one.is_load],
                f"recorded on {known or 'an unknown processor'}, this is {here}",
            )
        kinds = {pair.before.memory for pair in self._pairs}
        kinds |= {cell.memory for one in self._rows for cell in one.cells.values()}
        if len(kinds - {None}) > 1:
            two = " and ".join(sorted(str(kind) for kind in kinds if kind))
            self._leave_out([one for one in self.gate.figures if one.name == MEMORY], f"measured as {two}")
        self.gate.look(self.cells, last=last)

    def _leave_out(self, figures: Sequence[GateFigure], why: str) -> None:
        """Compare figures no more; what was asked for by name is told as what nobody can tell."""
        if not figures:
            return
        if self._wish.chosen:
            self.gate.refused |= dict.fromkeys((one.name for one in figures), why)
            return
        self._left_out.append(f"not compared: {', '.join(one.title for one in figures)}: {why}")
        self.gate.figures = [one for one in self.gate.figures if one not in figures]

    def notes(self) -> list[str]:
        """Return what else is to be said."""
        found = [*self._left_out, *self.faults]
        reused = sum(one.reused for one in self._rows)
        if reused:
            found.append(f"{plural(reused, 'result')} of equal runs were taken over; --rerun does them again")
        for one in self._rows:
            _tell_disturbed(one, found.append)
        return found


def _tell(report: GateReport, comparing: Comparing) -> None:
    """Print a report, and write the files that were asked for."""
    if speaks_json():
        for one in report.findings:
            emit(
                "gate",
                figure=one.figure.name,
                answer=str(one.answer),
                margin=one.figure.margin,
                change=_number(one.figure.change(one.shift)),
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
            try:
                write_atomically(str(path), text(report))
            except OSError as error:
                raise InputError(f"{path}: {error.strerror}") from None
