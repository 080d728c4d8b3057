# SPDX-License-Identifier: Apache-2.0
"""``slamhive run``, ``plan``, ``validate`` and ``demo``."""

from __future__ import annotations

import json
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from slamhive.cli import tables
from slamhive.cli.checked import check_files
from slamhive.cli.cluster import Context, Namespace, cluster_client
from slamhive.cli.console import command_name, complain, err, open_workbench, out, plural, remark
from slamhive.cli.exits import FAILED, INTERRUPTED
from slamhive.cli.progress import Display
from slamhive.cli.results import show_table
from slamhive.engine import PointState, Verdict
from slamhive.local.catalog import bundled, load_workshop
from slamhive.local.engines import ContainerChoice, find_engine
from slamhive.local.evaluations import bring_up_to_date, evaluate_again
from slamhive.local.home import Home
from slamhive.local.programs import unavailable
from slamhive.local.runner import Job, Runner
from slamhive.local.unavailable import Unavailable
from slamhive.model.base import Choice
from slamhive.model.errors import InputError
from slamhive.model.evaluation import Evaluation
from slamhive.model.run import MappingRun
from slamhive.model.sweep import Sweep
from slamhive.monitor.processes import forbid_inspection
from slamhive.plan import local_uid
from slamhive.tables.text import short_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.local.catalog import Workshop
    from slamhive.local.workbench import Workbench
    from slamhive.plan import Plan

Files = Annotated[list[Path], typer.Argument(metavar="FILE…", help="Manifests: sweeps, runs, datasets …")]
_WATCH_SECONDS = 1.0
_REPORTED = 20


class On(Choice):
    """Where runs happen."""

    WORKSTATION = "workstation"
    CLUSTER = "cluster"


def run(
    files: Files,
    *,
    parallelism: Annotated[
        int | None, typer.Option("-j", "--parallelism", min=1, help="Runs at the same time at most.")
    ] = None,
    rerun: Annotated[bool, typer.Option("--rerun", help="Do finished runs again, reuse nothing.")] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Do failed runs again.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Stay, and run what is new whenever a file changes.")
    ] = False,
    container: Annotated[
        ContainerChoice | None,
        typer.Option(
            "--container",
            help="Run all algorithms that have an image in containers of this engine, or none; default: "
            "those that have nothing else, by the engine that answers.",
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
    cluster goes on there after Ctrl-C.

    Example: slamhive run sweep.yaml -j 2
    """
    if on is On.CLUSTER:
        if rerun or retry_failed or watch or container is not None:
            raise InputError(
                "--on cluster: --rerun, --retry-failed, --watch and --container are for this machine alone"
            )
        with cluster_client():
            from slamhive.cli import cluster_run, cluster_work
        place = cluster_work.Place(context, namespace)
        raise typer.Exit(cluster_run.run_on_cluster(files, place, parallelism))
    if namespace is not None or context is not None:
        raise InputError("--namespace and --context say where on a cluster: they need --on cluster")
    if container is not None and container is not ContainerChoice.NONE:
        try:
            find_engine(container)
        except Unavailable as error:
            raise InputError(f"--container {container}: {error}") from None
    forbid_inspection()  # the programs that it runs have its user, and it keeps their figures
    home = Home.from_environment()
    with home.exclusive():
        seen = _state(files)
        code = _run_files(files, home, _How(parallelism, rerun, retry_failed, container))
        while watch and code != INTERRUPTED:
            remark("watching; Ctrl-C ends")
            try:
                seen = _wait_for_change(files, seen)
            except KeyboardInterrupt:
                break
            try:
                code = _run_files(files, home, _How(parallelism, container=container))
            except InputError as error:
                complain(str(error))
    raise typer.Exit(code)


def plan(
    files: Files,
    *,
    count: Annotated[bool, typer.Option("--count", help="Print the number of runs alone.")] = False,
    head: Annotated[int | None, typer.Option("--head", min=1, help="Print the first N runs.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print every run as a line of JSON.")] = False,
) -> None:
    """Show the runs that sweeps expand to, without running them.

    Names that are not in the catalog are allowed here; validate tells of them.

    Example: slamhive plan sweep.yaml --head 10
    """
    checked = check_files(files, load_workshop(Home.from_environment()), strict=False)
    checked.refuse()
    plans = checked.plans
    if not plans:
        raise InputError(f"{files[0]}: no Sweep or MappingRun in it")
    if count:
        out.print(sum(len(points) for _, points in plans))
        return
    for sweep, points in plans:
        shown = len(points) if as_json else min(len(points), head or 10)
        if as_json:
            _print_json(points, min(shown, head or shown))
        else:
            _print_points(sweep, points, shown)


def validate(files: Files) -> None:
    """Check manifests: everything that run would refuse, and what is missing here.

    Example: slamhive validate sweep.yaml
    """
    checked = check_files(files, load_workshop(Home.from_environment()))
    for sweep, points in checked.plans:
        out.print(f"{sweep.kind} {escape(sweep.name)}: {plural(len(points), 'run')}")
        _tell_of_idle(sweep, points)
    for item in checked.objects:
        if not isinstance(item, Sweep | MappingRun):
            out.print(f"{item.kind} {escape(item.name)}: valid")
    checked.refuse()


def demo(
    *,
    parallelism: Annotated[
        int | None, typer.Option("-j", "--parallelism", min=1, help="Runs at the same time at most.")
    ] = None,
) -> None:
    """Compare real algorithms on a generated recording, and show the table.

    Example: slamhive demo
    """
    home = Home.from_environment()
    sweep = bundled("examples") / "demo.yaml"
    with home.exclusive():
        code = _run_files([sweep], home, _How(parallelism))
    if code != INTERRUPTED:
        name = command_name()
        lines = (
            f"The sweep:  {sweep}",
            f"Next:       {name} results export --sweep demo --format csv",
            f"            {name} results table --sweep demo -m usage.cpu.seconds -m ate.max:cm:.1f",
            f"            {name} algorithm list",
            f"            {name} run your-sweep.yaml      (copy the sweep above and change it)",
        )
        out.print()
        for line in lines:
            out.print(line, soft_wrap=True, markup=False)
    raise typer.Exit(code)


@dataclass(frozen=True)
class _How:
    """Options of a command that runs sweeps.

    Attributes:
        parallelism: runs at the same time at most.
        rerun: whether finished runs are done again.
        retry_failed: whether failed ones are.
        container: what runs images.
    """

    parallelism: int | None
    rerun: bool = False
    retry_failed: bool = False
    container: ContainerChoice | None = None


def _run_files(files: Sequence[Path], home: Home, how: _How) -> int:
    workshop = load_workshop(home)
    checked = check_files(files, workshop)
    checked.refuse()
    evaluations = [item for item in checked.objects if isinstance(item, Evaluation)]
    if not checked.plans and not evaluations:
        raise InputError(f"{files[0]}: no Sweep, MappingRun or Evaluation in it")
    for sweep, points in checked.plans:
        _tell_of(sweep, points, workshop, how.container)
    plans = [points for _, points in checked.plans]
    jobs = [Job(sweep, local_uid(sweep), points) for sweep, points in checked.plans]
    bench = open_workbench(home, workshop, how.container)
    with bench.archive:
        interrupted, faults = False, False
        if jobs:
            # Before the display, as engines draw their own progress.
            names = sorted({name for points in plans for name in points.algorithm_names()})
            bench.programs.fetch([workshop.algorithm(name) for name in names])
            interrupted = _drive(jobs, bench, how)
        for job in [] if interrupted else jobs:
            for problem in bring_up_to_date(bench, job.uid, job.sweep.spec.evaluation):
                remark(problem.sentence)
                faults |= problem.is_fault
        for evaluation in [] if interrupted else evaluations:
            done, problems = evaluate_again(bench, evaluation)
            out.print(f"Evaluation {escape(evaluation.name)}: {plural(done, 'run')} evaluated")
            for problem in problems:
                complain(problem.sentence)
                faults |= problem.is_fault
        for job in jobs:
            _report(job, bench)
    if interrupted:
        remark("interrupted; the same command goes on from here")
        return INTERRUPTED
    failed = any(job.count(PointState.FAILED) or job.verdict is not Verdict.COMPLETE for job in jobs)
    return FAILED if failed or faults else 0


def _drive(jobs: Sequence[Job], bench: Workbench, how: _How) -> bool:
    with Display() as display:
        runner = Runner(
            bench, display, parallelism=how.parallelism, rerun=how.rerun, retry_failed=how.retry_failed
        )
        before: dict[int, Any] = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}

        def interrupt(_number: int, _frame: Any) -> None:
            runner.interrupt()
            signal.signal(signal.SIGINT, signal.default_int_handler)
            # Once the runs have ended the command does too: a late Ctrl-C has nothing left to end.
            before[signal.SIGINT] = signal.SIG_IGN

        for number in before:
            signal.signal(number, interrupt)
        try:
            return runner.run(jobs)
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def _tell_of(sweep: Sweep, points: Plan, workshop: Workshop, container: ContainerChoice | None) -> None:
    """Say which algorithms can't run here, and which settings have no effect."""
    for name in points.algorithm_names():
        reason = unavailable(workshop.algorithm(name), container)
        if reason:
            err.print(f"[yellow]{escape(name)} can't run here: {escape(reason)}[/]")
    _tell_of_idle(sweep, points)


def _tell_of_idle(sweep: Sweep, points: Plan) -> None:
    """Say which settings have no effect on some of the recordings."""
    for sentence in points.remarks():
        remark(f"{sweep.name}: {sentence}")


def _report(job: Job, bench: Workbench) -> None:
    succeeded, failed = job.count(PointState.SUCCEEDED), job.count(PointState.FAILED)
    parts = [f"{succeeded} succeeded", f"{failed} failed"]
    waiting = len(job.points) - succeeded - failed
    parts += [f"{waiting} not run"] if waiting else []
    parts += [f"{job.kept} done before"] if job.kept else []
    parts += [f"{job.reused} reused"] if job.reused else []
    if succeeded or failed:
        out.print()
        show_table(sweep=job.sweep.name)
    reason = f" ({job.verdict}: {job.message})" if job.message and waiting else ""
    out.print(
        f"{escape(job.sweep.name)}: {plural(len(job.points), 'run')}: {', '.join(parts)}{escape(reason)}"
    )
    out.print(f"Files:      {bench.home.path / 'runs' / job.sweep.name}", soft_wrap=True)
    more = f"{command_name()} results table --sweep {job.sweep.name}   (list, show, export)"
    out.print(f"More:       {more}", soft_wrap=True)


def _wait_for_change(files: Sequence[Path], seen: list[int]) -> list[int]:
    """Wait until files are other than they were seen, and return what is seen of them now."""
    while (now := _state(files)) == seen:
        time.sleep(_WATCH_SECONDS)
    return now


def _state(files: Sequence[Path]) -> list[int]:
    return [path.stat().st_mtime_ns if path.exists() else 0 for path in files]


def _print_json(points: Plan, count: int) -> None:
    for index in range(count):
        point = points.point(index)
        line = {"index": index, "name": point.name, "specHash": point.spec_hash, "spec": point.spec}
        if point.asked:
            line["asked"] = point.asked
        typer.echo(json.dumps(line, separators=(",", ":")))


def _print_points(sweep: Sweep, points: Plan, count: int) -> None:
    first = [points.point(index) for index in range(count)]
    labels = list(dict.fromkeys(label for point in first for label in point.coordinates))
    out.print(f"{sweep.name}: {plural(len(points), 'run')}", markup=False)
    headings = ["index", "name", *(short_name(label, labels) for label in labels), "repetition", "seed"]
    lines = [
        [
            *(str(point.index), point.name),
            *(str(point.coordinates.get(label, "")) for label in labels),
            *(str(point.repetition), str(point.seed)),
        ]
        for point in first
    ]
    tables.show(out, headings, lines)
    _tell_of_idle(sweep, points)
    if count < len(points):
        out.print(f"… and {plural(len(points) - count, 'more run')} (--head N, --json)")
