# SPDX-License-Identifier: Apache-2.0
"""Progress of runs that are at work: bars on a terminal, one line for each run elsewhere, or JSON lines."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

from rich.console import Group
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn
from rich.text import Text

from slamhive.cli.parts.console import bytes_text, emit, err, speaks_json
from slamhive.cli.parts.searches import extent_text, progress_text, search_values
from slamhive.engine import PointState
from slamhive.local.running.estimating import Estimate
from slamhive.local.running.execution import RunStep
from slamhive.local.running.outlook import RunStanding, sentences
from slamhive.model.base import plural
from slamhive.model.results import Phase
from slamhive.tables.text import short_name
from slamhive.tables.words import disproportion

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rich.console import RenderableType

    from slamhive.local.running.outlook import Points
    from slamhive.local.running.runner import Job
    from slamhive.local.running.workbench import Workbench
    from slamhive.model.results import Result, RunRecord

_REFRESH_PER_SECOND = 2
_MOST_SHOWN = 8
"""Runs at work that have a line of their own."""

_ESTIMATED_SECONDS = 1.0
"""For so long an estimate is shown."""

_AWAITED = (RunStep.CORES, RunStep.DATASET, RunStep.PROGRAM)
"""Steps that a run waits for before anything is done for it alone: datasets and programs are made once."""

_LONGEST_NUMBER = 8
_MADE_AFTER_SECONDS = 15.0
_MADE_APART = 0.25
"""Off a terminal it is said after so long, and after so much of the time passed again, what is being made."""


class Naming:
    """Words for the runs of a plan: what varies between them, and nothing that is the same in all.

    Args:
        points: the runs.
    """

    def __init__(self, points: Points) -> None:
        self._points = points
        grid = getattr(points, "grid", None)
        axes = {axis.label: len(axis.values) for axis in grid.dimensions} if grid is not None else {}
        self._constant = {label for label, count in axes.items() if count == 1}

    def settings(self, index: int) -> dict[str, Any]:
        """Return the settings of a run that vary, by path or name of an axis."""
        found = self._points.point(index).coordinates
        return {label: value for label, value in found.items() if label not in self._constant}

    def words(self, index: int) -> str:
        """Return the words that tell a run from the others; empty where it is the only one."""
        settings = self.settings(index)
        parts = [f"{short_name(label, list(settings))} {_word(value)}" for label, value in settings.items()]
        if self._points.repetitions > 1:
            parts.append(f"repetition {self._points.point(index).repetition}")
        return ", ".join(parts)


def _word(value: Any) -> str:
    """Return a value in few letters: one that a search drew from a range has very many digits."""
    text = str(value)
    return f"{value:.4g}" if isinstance(value, float) and len(text) > _LONGEST_NUMBER else text


@dataclass
class _Followed:
    """A job, with what is known of its progress.

    Attributes:
        naming: words for its runs.
        estimate: how long they take.
        began: since when something is done for each of those at work alone, s.
        steps: what each of them is at, and since when.
        before: errors before an edit by setting, m.
    """

    naming: Naming
    estimate: Estimate
    began: dict[int, float] = field(default_factory=dict)
    steps: dict[int, tuple[RunStep, float]] = field(default_factory=dict)
    before: Mapping[int, float] = field(default_factory=dict)


class Display:
    """Shows jobs on their way; a context manager, and a watcher of the runner.

    Args:
        bench: what runs share.
        before: returns the errors before an edit of a job's settings, by the number of each.
        look: called now and then.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        bench: Workbench,
        before: Callable[[Job], Mapping[int, float]] = lambda _: {},
        look: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bench = bench
        self._before = before
        self._look = look
        self._clock = clock
        self._began = clock()
        self._jobs: dict[str, Job] = {}
        self._followed: dict[str, _Followed] = {}
        self._left: tuple[float, float | None] | None = None
        self._made: dict[str, tuple[float, float]] = {}
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[notes]}"),
            console=err,
            auto_refresh=False,
        )
        self._tasks: dict[str, TaskID] = {}
        self._elsewhere = ""
        self._told_elsewhere = False
        self._best: dict[str, list[Any]] = {}
        self._live = Live(
            console=err, refresh_per_second=_REFRESH_PER_SECOND, get_renderable=self._rendered, transient=True
        )
        self._shows = err.is_terminal and not speaks_json()

    def __enter__(self) -> Self:
        if self._shows:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._shows:
            self._live.stop()

    def begun(self, job: Job) -> None:
        """Say how a job's runs stand, and follow it from now on."""
        outlook = job.outlook
        if outlook is None:
            return
        self._jobs[job.uid] = job
        estimate = Estimate.of(job.points, self._bench.archive)
        self._followed[job.uid] = _Followed(Naming(job.points), estimate, before=self._before(job))
        total = job.search.plan.most_trials if job.search is not None else self._total(job)
        self._tasks[job.uid] = self._bars.add_task(escape(job.sweep.name), total=total, notes="")
        self._left = None
        is_grid = job.search is None
        told = sentences(outlook, job.points, again=job.again, left_out=job.left_out, tells_new=is_grid)
        told = told if job.search is None else [extent_text(job.search.plan), *told]
        if speaks_json():
            counts = {kind.name.lower(): outlook.count(kind) for kind in RunStanding}
            emit(
                "begin",
                **self._names(job),
                runs=len(job.points),
                **counts,
                again=len(job.again),
                leftOut=job.left_out,
                leftSeconds=self._seconds_left(),
                sentences=told,
            )
            return
        left = self._left_text()
        takes = f"; about {left}" if left and self._waiting(job) else ""
        err.print(f"{escape(job.sweep.name)}: {escape('; '.join(told))}{takes}")

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        """Note a run's phase."""
        if speaks_json():
            emit("phase", **self._names(job, index), phase=str(phase))

    def step(self, job: Job, index: int, step: RunStep) -> None:
        """Note what a run is at, or waits for."""
        followed = self._followed.get(job.uid)
        if followed is None:
            return
        now = self._clock()
        if step not in _AWAITED:
            followed.began.setdefault(index, now)
        followed.steps[index] = (step, now)

    def finished(self, job: Job, record: RunRecord) -> None:
        """Say in a line what came out of a run."""
        index = record.index or 0
        followed = self._followed.get(job.uid)
        words, before = None, None
        if followed is not None:
            now = self._clock()
            took = now - followed.began.pop(index, now)
            followed.steps.pop(index, None)
            if record.usage and record.usage.wall_seconds and not record.provenance.reused_from:
                followed.estimate.note(index, record.usage.wall_seconds, took)
            words = followed.naming.words(index) or None
            before = followed.before.get(index // job.points.repetitions)
        self._left = None
        done = self._done(job)
        total = self._total(job)
        of = f"{done}" if job.search is not None else f"{done}/{total}"
        if speaks_json():
            emit(
                "run",
                **self._names(job, index),
                done=done,
                runs=total,
                leftSeconds=self._seconds_left(),
                **run_values(record),
                ateBefore=before,
            )
            return
        left = "" if self._shows else self._left_text()
        ending = f" [dim]· {left}[/]" if left else ""
        err.print(f"[dim]{of}[/] {run_line(record, words, before)}{ending}")

    def tick(self, jobs: Sequence[Job]) -> None:
        """Move the bars; off a terminal, say now and then what runs wait for."""
        self._look()
        if not self._shows and not speaks_json():
            self._say_what_is_made()
        for job in jobs:
            task = self._tasks.get(job.uid)
            if task is None:
                continue
            failed = job.count(PointState.FAILED)
            notes = [f"[red]{failed} failed[/]"] if failed else []
            done = self._done(job)
            if job.search is not None:
                done = sum(one.is_decided for one in job.search.decision.standings)
                notes.append(escape(progress_text(job.search)))
                self._tell_search(job)
            self._bars.update(task, completed=done, notes=" ".join(notes))
        self._tell_elsewhere(jobs)

    def _tell_search(self, job: Job) -> None:
        """Say how far a search is whenever it has found something better."""
        search = job.search
        best = (
            [(one.number, one.score, one.is_complete) for one in search.best[:1]]
            if search is not None
            else []
        )
        if search is None or not best or self._best.get(job.uid) == best:
            return
        self._best[job.uid] = best
        if speaks_json():
            emit("search", sweep=job.sweep.name, **search_values(search))
        elif not self._shows:
            err.print(f"[dim]{escape(job.sweep.name)}: {escape(progress_text(search))}[/]")

    def _tell_elsewhere(self, jobs: Sequence[Job]) -> None:
        """Say what is waited for as other runners have it: below the bars, and once in lines."""
        cores = max((job.cores_elsewhere for job in jobs), default=0)
        runs = sum(len(job.elsewhere) for job in jobs)
        self._elsewhere = elsewhere_text(cores, runs)
        if self._elsewhere and not self._told_elsewhere and not self._shows:
            self._told_elsewhere = True
            if speaks_json():
                emit("waits", cores=cores, runs=runs)
            else:
                err.print(f"[dim]{self._elsewhere}[/]")

    def _say_what_is_made(self) -> None:
        now, making = self._clock(), dict(self._bench.making)
        self._made = {what: self._made.get(what, (now, now)) for what in making}
        for what, (since, said) in self._made.items():
            if now - said >= max(_MADE_AFTER_SECONDS, _MADE_APART * (now - since)):
                self._made[what] = since, now
                err.print(f"[dim]{escape(what)}: {making[what]:.0%}, {clock_text(now - since)} so far[/]")

    def _rendered(self) -> RenderableType:
        """Return the lines below: a bar a sweep, the time, and the step of each run."""
        now = self._clock()
        times = f"{clock_text(now - self._began)} elapsed"
        left = self._left_text()
        lines: list[RenderableType] = [self._bars, Text(f"{times}, {left}" if left else times, style="dim")]
        lines += [Text(f"  {self._elsewhere}", style="dim")] if self._elsewhere else []
        lines += [
            Text(f"  {what}: {share:.0%}", style="dim") for what, share in list(self._bench.making.items())
        ]
        shown = 0
        for uid, followed in self._followed.items():
            for index, (step, since) in sorted(followed.steps.items()):
                shown += 1
                if shown <= _MOST_SHOWN:
                    lines.append(Text(f"  {self._at(uid, followed, index, step, now - since)}", style="dim"))
        if shown > _MOST_SHOWN:
            lines.append(Text(f"  … and {shown - _MOST_SHOWN} more", style="dim"))
        return Group(*lines)

    def _at(self, uid: str, followed: _Followed, index: int, step: RunStep, since: float) -> str:
        words = followed.naming.words(index) or self._jobs[uid].sweep.name
        usual = followed.estimate.seconds(index) if step is RunStep.RUNNING else None
        expected = f" of about {clock_text(usual)}" if usual is not None else ""
        return f"{words}: {step} {clock_text(since)}{expected}"

    def _names(self, job: Job, index: int | None = None) -> dict[str, Any]:
        """Return the fields of a line of JSON that name its sweep or run."""
        named: dict[str, Any] = {"sweep": job.sweep.name}
        if index is not None:
            point = job.points.point(index)
            followed = self._followed.get(job.uid)
            named |= {
                "index": index,
                "run": point.name,
                "settings": followed.naming.settings(index) if followed else {},
                "repetition": point.repetition,
            }
        return named

    @staticmethod
    def _total(job: Job) -> int:
        return len(job.points) - job.left_out

    @staticmethod
    def _done(job: Job) -> int:
        return job.count(PointState.SUCCEEDED) + job.count(PointState.FAILED)

    @staticmethod
    def _waiting(job: Job) -> int:
        return job.count(PointState.PENDING) - job.left_out

    def _seconds_left(self) -> float | None:
        """Return the time that all jobs still take, s; None where nobody knows."""
        now = self._clock()
        if self._left is not None and now - self._left[0] < _ESTIMATED_SECONDS:
            return self._left[1]
        total: float | None = 0.0
        for uid, followed in self._followed.items():
            job = self._jobs[uid]
            waiting = [index for index in job.order if job.states[index] == PointState.PENDING]
            running = {index: now - moment for index, moment in list(followed.began.items())}
            steps = list(followed.steps.items())
            waiting += [index for index, (step, _) in steps if step in _AWAITED and index not in running]
            further = job.search.further_runs if job.search is not None else 0
            left = followed.estimate.left(waiting, running, job.at_a_time, further)
            total = None if left is None or total is None else total + left
        self._left = (now, total)
        return total

    def _left_text(self) -> str:
        left = self._seconds_left()
        return f"{clock_text(left)} left" if left else ""


def elsewhere_text(cores: int, runs: int) -> str:
    """Return a sentence on cores and runs that other runners of the home have; empty without any.

    >>> elsewhere_text(2, 0), elsewhere_text(1, 3)
    ("2 cores are at another runner's work", "1 core and 3 runs are at another runner's work")
    """
    parts = [plural(count, noun) for count, noun in ((cores, "core"), (runs, "run")) if count]
    verb = "is" if cores + runs == 1 else "are"
    return f"{' and '.join(parts)} {verb} at another runner's work" if parts else ""


def clock_text(seconds: float) -> str:
    """Return a time as a clock shows it.

    >>> clock_text(7.6), clock_text(75), clock_text(3725)
    ('0:08', '1:15', '1:02:05')
    """
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def run_line(record: RunRecord, words: str | None = None, before: float | None = None) -> str:
    """Return a line about a finished run, as rich markup.

    Args:
        record: the run.
        words: what tells it from the others; None for its name, algorithm and dataset.
        before: the error that its setting had before an edit, m.
    """
    spec = record.spec
    what = words
    if what is None:
        on = f"{spec['algorithmRef']['name']} on {spec['datasetRef']['name']}"
        what = f"{record.name}, {on}, repetition {spec.get('repetition', 0)}"
    if record.phase is not Phase.SUCCEEDED:
        named = f" ({record.name})" if words is not None else ""
        return f"[red]{record.reason}[/] {escape(what)}{escape(named)}: {escape(record.message or '')}"
    parts = []
    for result in record.results:
        ate = result.values.get("ate")
        figure = f" ATE {ate['rmse']:.4g} m{_against(ate['rmse'], before)}" if ate else ""
        parts.append(f"{result.outcome}{figure}")
        parts += [f"[yellow]{escape(why)}[/]" for why in (_told(result), disproportion(result)) if why]
    usage = record.usage
    if record.provenance.reused_from:
        parts.append("reused")
    elif usage is not None and usage.cpu.seconds is not None:
        parts.append(f"{usage.cpu.seconds:.1f} CPU s, {bytes_text(usage.memory.peak_bytes)}")
    if record.message:
        parts.append(f"[yellow]{escape(record.message)}[/]")
    return f"{escape(what)}: {', '.join(parts)}"


def _told(result: Result) -> str | None:
    """Return the evaluator's message about a run, as of one that is lost."""
    found = result.values.get("message")
    return str(found) if found else None


def _against(error: float, before: float | None) -> str:
    if before is None:
        return ""
    if abs(error - before) <= 0.0005 * before:
        return " (as before)"
    if before <= 0:
        return f" (before {before:.4g})"
    return f" (before {before:.4g}, {(error / before - 1) * 100:+.1f} %)"


def run_values(record: RunRecord) -> dict[str, Any]:
    """Return the outcome of a run, for a line of JSON."""
    usage = record.usage
    found = record.results[0] if record.results else None
    return {
        "uid": record.uid,
        "algorithm": record.spec["algorithmRef"]["name"],
        "dataset": record.spec["datasetRef"]["name"],
        "phase": str(record.phase),
        "reason": str(record.reason) if record.reason else None,
        "message": record.message or ((_told(found) or disproportion(found)) if found else None),
        "outcome": str(found.outcome) if found else None,
        "ate": (found.values.get("ate") or {}).get("rmse") if found else None,
        "cpuSeconds": usage.cpu.seconds if usage else None,
        "peakBytes": usage.memory.peak_bytes if usage else None,
        "wallSeconds": usage.wall_seconds if usage else None,
        "reused": record.provenance.reused_from is not None,
    }
