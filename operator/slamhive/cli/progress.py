# SPDX-License-Identifier: Apache-2.0
"""Progress of runs that are at work: a bar on a terminal, one line for each run elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import TimeRemainingColumn as Remaining

from slamhive.cli.console import bytes_text, err
from slamhive.engine import PointState
from slamhive.model.results import Phase

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from slamhive.local.runner import Job
    from slamhive.model.results import RunRecord

_REFRESH_PER_SECOND = 2


class Display:
    """Shows jobs on their way; a context manager."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[notes]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            Remaining(elapsed_when_finished=True),
            console=err,
            refresh_per_second=_REFRESH_PER_SECOND,
            disable=not err.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._active: dict[tuple[str, int], Phase] = {}
        self._failed: dict[str, int] = {}

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def phase(self, job: Job, index: int, phase: Phase) -> None:
        """Note a run's phase."""
        self._active[job.uid, index] = phase

    def finished(self, job: Job, record: RunRecord) -> None:
        """Say in a line what came out of a run."""
        self._active.pop((job.uid, record.index or 0), None)
        done = len(job.points) - job.count(PointState.PENDING) - job.count(PointState.ACTIVE)
        err.print(f"[dim]{done}/{len(job.points)}[/] {run_line(record)}")

    def tick(self, jobs: Sequence[Job]) -> None:
        """Move the bars."""
        for job in jobs:
            failed = job.count(PointState.FAILED)
            done = job.count(PointState.SUCCEEDED) + failed
            preparing = sum(
                phase in {Phase.PENDING, Phase.PREPARING}
                for (uid, _), phase in self._active.items()
                if uid == job.uid
            )
            notes = [f"[red]{failed} failed[/]"] if failed else []
            notes += [f"{preparing} preparing"] if preparing else []
            task = self._tasks.get(job.uid)
            if task is None:
                task = self._progress.add_task(escape(job.sweep.name), total=len(job.points), notes="")
                self._tasks[job.uid] = task
            self._progress.update(task, completed=done, notes=" ".join(notes))


def run_line(record: RunRecord) -> str:
    """Return a line about a finished run, as rich markup."""
    spec = record.spec
    what = f"{spec['algorithmRef']['name']} on {spec['datasetRef']['name']}"
    if record.phase is not Phase.SUCCEEDED:
        return f"[red]{record.reason}[/] {escape(record.name)} {escape(what)}: {escape(record.message or '')}"
    parts = [escape(record.name), escape(what), f"repetition {spec.get('repetition', 0)}"]
    for result in record.results:
        ate = result.values.get("ate")
        figure = f"ATE {ate['rmse']:.4g} m" if ate else ""
        parts.append(f"{result.outcome} {figure}".strip())
    usage = record.usage
    if record.provenance.reused_from:
        parts.append("reused")
    elif usage is not None and usage.cpu.seconds is not None:
        parts.append(f"{usage.cpu.seconds:.1f} CPU s, {bytes_text(usage.memory.peak_bytes)}")
    if record.message:
        parts.append(f"[yellow]{escape(record.message)}[/]")
    return ", ".join(parts)
