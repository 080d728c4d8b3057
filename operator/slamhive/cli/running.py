# SPDX-License-Identifier: Apache-2.0
"""``slamhive run`` and ``demo``.

``run`` ends with 0 where all went well; with 1 where a run failed, could not be measured, or the sweep
stopped before its end; with 2 on wrong input; with 130 when it was interrupted.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from slamhive.analysis.grouping import aggregate
from slamhive.analysis.metrics import declared_units
from slamhive.analysis.selection import Selection, choose
from slamhive.cli.cluster.commands import Context, Namespace, cluster_client
from slamhive.cli.daily import errors_before, show_edits, to_do_again
from slamhive.cli.parts import searches
from slamhive.cli.parts.checked import check_files
from slamhive.cli.parts.console import (
    command_name,
    complain,
    emit,
    err,
    open_workbench,
    out,
    remark,
    speak_json,
    speaks_json,
    warn,
)
from slamhive.cli.parts.exits import FAILED, INTERRUPTED, WRONG_INPUT
from slamhive.cli.parts.progress import Display
from slamhive.cli.parts.watching import Watched, half_saved
from slamhive.cli.plans import Files, remark_without_effect, warn_impossible
from slamhive.cli.results import show_table
from slamhive.engine import PointState, Verdict
from slamhive.local.home.catalog import bundled, load_workshop
from slamhive.local.home.folder import Home
from slamhive.local.home.sweeping import require_own_name
from slamhive.local.programs.engines import ContainerChoice, find_engine
from slamhive.local.programs.executors import unavailable
from slamhive.local.programs.unavailable import Unavailable
from slamhive.local.running.choosing import RunChoice, ask
from slamhive.local.running.evaluations import bring_up_to_date, evaluate_again
from slamhive.local.running.runner import Job, Runner
from slamhive.local.running.workbench import Workbench
from slamhive.model.base import Choice, plural
from slamhive.model.errors import InputError
from slamhive.model.evaluation import Evaluation
from slamhive.model.sweep import Sweep
from slamhive.monitor.measuring.processes import forbid_inspection
from slamhive.plan import local_uid
from slamhive.reporting.conclusions import conclusion
from slamhive.sampling import require_sampler
from slamhive.tables.reading import read_archive

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.local.home.catalog import Workshop
    from slamhive.plan import Plan

_SAVED = -1
"""Exit code of a round that a save ended; never a command's."""


class On(Choice):
    """Places where ``slamhive run`` executes runs: the values of its ``--on``."""

    WORKSTATION = "workstation"
    CLUSTER = "cluster"


class ProgressFormat(Choice):
    """Formats of the progress messages of ``slamhive run``."""

    TEXT = "text"
    JSON = "json"


Parallelism = Annotated[
    int | None, typer.Option("-j", "--parallelism", min=1, help="Runs at the same time at most.")
]
Rerun = Annotated[bool, typer.Option("--rerun", help="Do finished runs again, reuse nothing.")]
LogFormat = Annotated[
    ProgressFormat, typer.Option("--log-format", help="Lines of text, or of JSON on standard output.")
]
"""Options of the commands that do runs on this machine."""


def run(
    files: Files,
    *,
    parallelism: Parallelism = None,
    only: Annotated[
        str | None,
        typer.Option("--only", metavar="EXPR", help='Only runs that meet it: "parameters.maxRange < 50".'),
    ] = None,
    dataset: Annotated[
        list[str] | None,
        typer.Option("--dataset", metavar="NAME", help="Only runs on this dataset; may be repeated."),
    ] = None,
    first: Annotated[
        int | None,
        typer.Option("--first", min=1, metavar="N", help="Do only N runs: one of each setting first."),
    ] = None,
    rerun: Rerun = False,
    rerun_where: Annotated[
        str | None,
        typer.Option(
            "--rerun-where",
            metavar="EXPR",
            help="Do finished runs again whose results meet it, as in \"outcome != 'Tracked'\".",
        ),
    ] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Do failed runs again.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Stay, and do what is stale or new whenever a file is saved.")
    ] = False,
    bell: Annotated[bool, typer.Option("--bell", help="Ring the terminal's bell at the end.")] = False,
    log_format: LogFormat = ProgressFormat.TEXT,
    container: Annotated[
        ContainerChoice | None,
        typer.Option(
            "--container",
            help="Engine in whose containers all algorithms with an image run; none: no containers. "
            "Default: only algorithms that have nothing but an image, by the engine that is found.",
        ),
    ] = None,
    on: Annotated[
        On, typer.Option("--on", help="This machine, or the cluster of a kubeconfig.")
    ] = On.WORKSTATION,
    namespace: Namespace = None,
    context: Context = None,
) -> None:
    """Run sweeps on this machine, or on a cluster as if it were this machine.

    Finished runs are kept: after Ctrl-C or a crash the same command goes on from here. What runs on a
    cluster goes on there after Ctrl-C. After an edit of an algorithm or a dataset the runs that it made stale
    are done again, one of each setting first, and compared with those before. Ends with 0, or 1 if a run
    failed or the sweep stopped early, 2 on wrong input, 130 when interrupted.

    Example: slamhive run sweep.yaml -j 2
    """
    speak_json(wanted=log_format is ProgressFormat.JSON)
    if on is On.CLUSTER:
        given = {
            "--only": only,
            "--dataset": dataset,
            "--first": first,
            "--rerun": rerun,
            "--rerun-where": rerun_where,
            "--retry-failed": retry_failed,
            "--watch": watch,
            "--container": container,
        }
        if any(given.values()):
            raise InputError(_not_on_cluster([name for name, value in given.items() if value]))
        with cluster_client():
            from slamhive.cli.cluster import run as cluster_run
            from slamhive.cli.cluster import work as cluster_work
        place = cluster_work.ClusterPlace(context, namespace)
        _end(cluster_run.run_on_cluster(files, place, parallelism), bell=bell)
    if namespace is not None or context is not None:
        raise InputError("--namespace and --context say where on a cluster: they need --on cluster")
    if container is not None and container is not ContainerChoice.NONE:
        try:
            find_engine(container)
        except Unavailable as error:
            raise InputError(f"--container {container}: {error}") from None
    forbid_inspection()  # the programs that it runs have its user, and it keeps their figures
    home = Home.from_environment()
    wish = RunChoice(first, rerun=rerun, retry_failed=retry_failed)
    how = _How(parallelism, wish, container, rerun_where, only, tuple(dataset or ()))
    with home.sharing():
        code = _watch(files, home, how, bell=bell) if watch else _run_files(files, home, how)
    _end(code, bell=bell and not watch)


def _not_on_cluster(given: Sequence[str]) -> str:
    names = f"{', '.join(given[:-1])} and {given[-1]} are" if len(given) > 1 else f"{given[0]} is"
    return f"--on cluster: {names} for this machine alone: on a cluster the operator does all runs of a Sweep"


def _end(code: int, *, bell: bool) -> None:
    if bell:
        _ring()
    if speaks_json():
        emit("exit", code=code)
    raise typer.Exit(code)


def _ring() -> None:
    if err.is_terminal:
        err.bell()


def _watch(files: Sequence[Path], home: Home, how: _How, *, bell: bool) -> int:
    """Run what files ask for, again at each save, until Ctrl-C; returns the exit code of the last round."""
    watched = Watched(files)
    while True:
        watched.changed()
        try:
            code = _run_files(files, home, replace(how, watched=watched))
        except InputError as error:
            if any(not path.exists() for path in files) and not how.watched:
                raise  # nobody is saving that: it is called otherwise
            complain(str(error))
            code = WRONG_INPUT
        # What was asked to be done again was, once.
        wish = replace(how.wish, rerun=False, retry_failed=False)
        how = replace(how, wish=wish, rerun_where=None, watched=watched)
        if code == INTERRUPTED:
            return code
        if code == _SAVED:
            remark("saved while it ran: it begins again with what is there now")
            continue
        if bell:
            _ring()
        remark("watching; Ctrl-C ends")
        try:
            watched.wait()
        except KeyboardInterrupt:
            return code


def demo(*, parallelism: Parallelism = None) -> None:
    """Compare real algorithms on a generated recording: a table, what won, at what cost, what next.

    Example: slamhive demo
    """
    home = Home.from_environment()
    sweep = bundled("examples") / "demo.yaml"
    with home.sharing("slamhive demo"):
        code = _run_files([sweep], home, _How(parallelism))
    if code != INTERRUPTED:
        name = command_name()
        lines = (
            "",
            *_conclusion(home, "demo"),
            "",
            f"Next:  {name} dashboard                   the runs in a browser: paths, errors, load",
            f"       {name} run my-sweep.yaml           your own sweep: copy {sweep} and change it",
            f"       {name} dataset add RECORDING       your own recording: a bag, or a folder as published",
        )
        for line in lines:
            out.print(line, soft_wrap=True, markup=False)
    raise typer.Exit(code)


def _conclusion(home: Home, sweep: str) -> list[str]:
    """Return sentences on what won in a sweep, at what cost."""
    frame = choose(read_archive(home.archive_url, home.path / "cache"), Selection((sweep,))).frame
    error, cost = "ate.rmse", "usage.cpu.secondsPerDataSecond"
    with declared_units(frame.units):
        return conclusion(aggregate(frame, [error, cost]), error, cost)


@dataclass(frozen=True)
class _How:
    """Options of a command that runs sweeps.

    Attributes:
        parallelism: runs at the same time at most.
        wish: how much of what is asked for is done.
        container: what runs images.
        rerun_where: a condition on results; runs that meet it are done again.
        only: a condition on settings; None for all runs.
        datasets: names; none for all.
        watched: files whose change ends the runs; None for none.
    """

    parallelism: int | None
    wish: RunChoice = field(default_factory=RunChoice)
    container: ContainerChoice | None = None
    rerun_where: str | None = None
    only: str | None = None
    datasets: tuple[str, ...] = ()
    watched: Watched | None = None


def _run_files(files: Sequence[Path], home: Home, how: _How) -> int:
    workshop = load_workshop(home)
    checked = check_files(files, workshop)
    checked.refuse()
    evaluations = [item for item in checked.objects if isinstance(item, Evaluation)]
    if not checked.plans and not evaluations:
        raise InputError(f"{files[0]}: no Sweep, MappingRun or Evaluation in it")
    for sweep, points in checked.plans:
        tell_of(sweep, points, workshop, how.container)
    sweeps, plans = [sweep for sweep, _ in checked.plans], [points for _, points in checked.plans]
    if how.watched is not None:
        _follow(how.watched, workshop, plans)
    jobs = _jobs(checked.plans, workshop, how)
    bench = open_workbench(home, workshop, how.container)
    with bench.archive:
        require_own_name(bench.archive, sweeps)
        interrupted, faults = False, False
        if jobs:
            _recall(jobs, bench)
            if how.rerun_where is not None:
                to_do_again(jobs, home, how.rerun_where)
            # Before the display, as engines draw their own progress.
            bench.programs.fetch([workshop.algorithm(name) for name in algorithms_of(plans)])
            code = drive(jobs, bench, how.wish, how.parallelism, how.watched)
            if code == _SAVED:
                return code
            interrupted = code == INTERRUPTED
        if not interrupted:
            faults = measure_all(bench, jobs, evaluations)
        _report(jobs, bench)
    if interrupted:
        remark("interrupted; the same command goes on from here")
        return INTERRUPTED
    failed = any(job.count(PointState.FAILED) or job.verdict is not Verdict.COMPLETE for job in jobs)
    return FAILED if failed or faults else 0


def _jobs(both: Sequence[tuple[Sweep, Plan]], workshop: Workshop, how: _How) -> list[Job]:
    given = {"--only": how.only, "--dataset": how.datasets, "--first": how.wish.first}
    searches.refuse_choice(both, [name for name, value in given.items() if value])
    jobs = [Job(sweep, local_uid(sweep), points) for sweep, points in both]
    for job, asked in zip(jobs, ask(both, workshop, how.only, how.datasets), strict=True):
        job.asked = asked
    return jobs


def _recall(jobs: Sequence[Job], bench: Workbench) -> None:
    """Take in what searches tried before.

    Raises:
        InputError: who proposes settings isn't installed.
    """
    for job in jobs:
        if job.search is not None:
            require_sampler(job.search.search.method)
            job.search.recall(bench.archive)


def measure_all(bench: Workbench, jobs: Sequence[Job], evaluations: Sequence[Evaluation]) -> bool:
    """Measure what was measured otherwise, and tell whether the machine or a file was in the way."""
    faults = False
    for job in jobs:
        for problem in bring_up_to_date(bench, job.uid, job.sweep.spec.evaluation):
            remark(problem.sentence)
            faults |= problem.is_fault
    for evaluation in evaluations:
        faults |= _measure_again(bench, evaluation)
    return faults


def _measure_again(bench: Workbench, evaluation: Evaluation) -> bool:
    """Do what an Evaluation asks for, and tell whether the machine or a file was in the way."""
    done, problems = evaluate_again(bench, evaluation)
    if speaks_json():
        emit("evaluation", name=evaluation.name, evaluated=done)
    else:
        out.print(f"Evaluation {escape(evaluation.name)}: {plural(done, 'run')} evaluated")
    for problem in problems:
        complain(problem.sentence)
    return any(problem.is_fault for problem in problems)


def _follow(watched: Watched, workshop: Workshop, plans: Sequence[Plan]) -> None:
    """Look at what a round is made of from now on.

    Raises:
        InputError: an editor is not done with the Python of an algorithm.
    """
    names = algorithms_of(plans)
    watched.follow(workshop, names, {name for points in plans for name in points.dataset_names()})
    if problems := [problem for name in names for problem in half_saved(workshop.algorithm(name))]:
        raise InputError("\n".join(problems))


def algorithms_of(plans: Sequence[Plan]) -> list[str]:
    """Return the names of the algorithms of plans, sorted."""
    return sorted({name for points in plans for name in points.algorithm_names()})


def drive(
    jobs: Sequence[Job],
    bench: Workbench,
    wish: RunChoice,
    parallelism: int | None = None,
    watched: Watched | None = None,
) -> int:
    """Bring jobs to their end; returns 0, or why they ended before.

    Args:
        jobs: what is to be done.
        bench: what runs share.
        wish: how much of it is done.
        parallelism: runs at the same time at most.
        watched: files whose change ends the runs; None for none.
    """
    saved = asked = False

    def look() -> None:
        nonlocal saved
        if watched is not None and not saved and watched.changed():
            saved = True
            runner.interrupt(making=False)  # the next round wants the same recordings

    with Display(bench, lambda job: errors_before(job, bench.home), look) as display:
        runner = Runner(bench, display, parallelism=parallelism, wish=wish, begun=display.begun)
        before: dict[int, Any] = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}

        def interrupt(_number: int, _frame: Any) -> None:
            nonlocal asked
            asked = True
            runner.interrupt()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            # Once the runs have ended the command does too: a late Ctrl-C has nothing left to end.
            before[signal.SIGINT] = signal.SIG_IGN

        for number in before:
            signal.signal(number, interrupt)
        try:
            interrupted = runner.run(jobs)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    if saved and not asked:
        return _SAVED
    return INTERRUPTED if interrupted else 0


def tell_of(sweep: Sweep, points: Plan, workshop: Workshop, container: ContainerChoice | None) -> None:
    """Say which algorithms can't run here, and which settings have no effect."""
    for name in points.algorithm_names():
        reason = unavailable(workshop.algorithm(name), container)
        if reason:
            warn(f"{name} can't run here: {reason}")
    remark_without_effect(sweep, points)
    warn_impossible([(sweep, points)], workshop)


def _report(jobs: Sequence[Job], bench: Workbench) -> None:
    """Show how jobs ended, and once what edits did."""
    is_one = len(jobs) == 1
    for job in jobs:
        _report_one(job, bench, is_one=is_one)
    if not is_one:
        show_edits(jobs, bench.home)


def _report_one(job: Job, bench: Workbench, *, is_one: bool) -> None:
    succeeded, failed = job.count(PointState.SUCCEEDED), job.count(PointState.FAILED)
    waiting = len(job.points) - succeeded - failed - job.left_out
    search = {"search": searches.search_values(job.search)} if job.search is not None else {}
    if speaks_json():
        if is_one:
            show_edits([job], bench.home)
        emit(
            "end",
            sweep=job.sweep.name,
            runs=len(job.points),
            succeeded=succeeded,
            failed=failed,
            notRun=waiting,
            leftOut=job.left_out,
            doneBefore=job.kept,
            doneElsewhere=job.done_elsewhere,
            reused=job.reused,
            verdict=str(job.verdict),
            message=job.message,
            folder=str(bench.home.path / "runs" / job.sweep.name),
            **search,
        )
        return
    parts = [f"{succeeded} succeeded", f"{failed} failed"]
    parts += [f"{waiting} not run"] if waiting else []
    parts += [f"{job.left_out} left out"] if job.left_out and job.search is None else []
    parts += [f"{job.kept} done before"] if job.kept else []
    parts += [f"{job.done_elsewhere} done by another runner"] if job.done_elsewhere else []
    parts += [f"{job.reused} reused"] if job.reused else []
    if succeeded or failed:
        out.print()
        if job.search is None:
            show_table(sweep=job.sweep.name, also=[])
        else:
            for line in searches.end_lines(job.search):
                out.print(line, markup=False, soft_wrap=True)
    if is_one:
        show_edits([job], bench.home)
    is_short = waiting or (job.search is not None and job.verdict is not Verdict.COMPLETE)
    reason = f" ({job.verdict}: {job.message})" if job.message and is_short else ""
    runs = succeeded + failed + waiting if job.search is not None else len(job.points)
    out.print(f"{escape(job.sweep.name)}: {plural(runs, 'run')}: {', '.join(parts)}{escape(reason)}")
    out.print(f"Files:      {bench.home.path / 'runs' / job.sweep.name}", soft_wrap=True)
    if succeeded or failed:  # else nobody knows the sweep yet
        more = f"{command_name()} results table --sweep {job.sweep.name}   (list, show, export)"
        out.print(f"More:       {more}", soft_wrap=True)
