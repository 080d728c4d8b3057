# SPDX-License-Identifier: Apache-2.0
"""``slamhive algorithm check``: what an algorithm does in each of its modes, in each executor there is."""

from __future__ import annotations

import signal
import sys
from contextlib import ExitStack
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from slamhive.cli.cluster.commands import Context, Namespace
from slamhive.cli.parts import tables
from slamhive.cli.parts.console import out, remark
from slamhive.cli.parts.exits import FAILED, INTERRUPTED
from slamhive.cli.parts.tables import PrintFormat
from slamhive.cli.parts.waiting import Work
from slamhive.local.home.catalog import AlgorithmEntry, load_workshop
from slamhive.local.home.folder import Home
from slamhive.model.base import Choice, seconds
from slamhive.model.errors import InputError, SlamHiveError
from slamhive_eval.formats.csv_writing import write_csv

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.conformance.cluster import OnCluster
    from slamhive.conformance.executors import CheckExecutor
    from slamhive.conformance.findings import Finding
    from slamhive.conformance.workstation import CheckBench, OnWorkstation

_COLOURS = {"pass": "green", "warning": "yellow", "fail": "red", "skipped": "dim"}


class CheckPlace(Choice):
    """Places where ``slamhive algorithm check`` starts an algorithm: the values of its ``--on``."""

    PROCESS = "process"
    CONTAINER = "container"
    CLUSTER = "cluster"
    ALL = "all"


_TIMEOUT = "5m"
_WIDTH = 160
"""Characters of a line where there is no terminal."""


class _CheckBar:
    """Shows how far a check is, by its starts."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._steps = 0
        self._done = -1

    def begin(self, steps: int) -> None:
        """So many starts are to come."""
        self._steps = steps

    def step(self, what: str) -> None:
        """One of them begins."""
        self._done += 1
        self._work.count(self._done, self._steps, what=what)

    def found(self, finding: Finding) -> None:
        """Something was found: the table says it in the end."""


def check(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name in the catalog.")],
    *,
    image: Annotated[
        str | None, typer.Option("--image", metavar="REF", help="Use this image instead of the Algorithm's.")
    ] = None,
    dataset: Annotated[
        str | None,
        typer.Option("--dataset", metavar="DATASET", help="Default: a short generated one for each mode."),
    ] = None,
    on: Annotated[
        CheckPlace, typer.Option("--on", help="Where to start it; all: everywhere that is possible here.")
    ] = CheckPlace.ALL,
    timeout: Annotated[
        str, typer.Option("--timeout", metavar="DURATION", help="How long one start may take.")
    ] = _TIMEOUT,
    form: Annotated[PrintFormat, typer.Option("--format", help="How to print.")] = PrintFormat.TABLE,
    namespace: Namespace = None,
    context: Context = None,
) -> None:
    """Check what an algorithm does and declares, by starting it on short recordings, sound ones and others.

    Nothing of it goes into the archive. The exit code is 1 where something fails.

    Example: slamhive algorithm check kiss-icp
    """
    limit = _seconds(timeout)
    from slamhive.conformance.checking import CheckRequest, check_algorithm
    from slamhive.conformance.workstation import bench_for_checks

    home = Home.from_environment()
    workshop = load_workshop(home)
    entry = workshop.algorithm(name)
    if dataset is not None:
        workshop.dataset(dataset)
    if image is not None:
        if on is CheckPlace.PROCESS:
            raise InputError("--image: a process has no image; leave it out, or --on process")
        spec = entry.algorithm.spec.replace(image=image)
        workshop.algorithm_entries[name] = AlgorithmEntry(entry.algorithm.replace(spec=spec), entry.folder)
    before = signal.signal(signal.SIGTERM, _interrupt)  # what was started ends, and what was made goes
    try:
        with ExitStack() as stack:
            stack.enter_context(home.exclusive("slamhive algorithm check"))
            work = stack.enter_context(Work(f"checking {name}"))
            bench = stack.enter_context(bench_for_checks(home, workshop, remark))
            work.follow(bench.making)
            executors = _executors(_CheckOptions(bench, name, dataset, on, image, context, namespace), stack)
            findings = check_algorithm(bench, executors, CheckRequest(name, dataset, limit), _CheckBar(work))
    except KeyboardInterrupt:
        remark("interrupted; what was started has ended, and what was made is removed")
        raise typer.Exit(INTERRUPTED) from None
    finally:
        signal.signal(signal.SIGTERM, before)
    show(findings, form)
    if any(finding.answer == "fail" for finding in findings):
        raise typer.Exit(FAILED)


def _interrupt(_number: int, _frame: Any) -> None:
    raise KeyboardInterrupt


def _seconds(text: str) -> float:
    from pydantic import TypeAdapter, ValidationError

    from slamhive.model.base import Duration

    try:
        found = seconds(TypeAdapter(Duration).validate_python(text))
    except ValidationError:
        found = 0.0
    if found < 1:
        raise InputError(f"--timeout {text}: expected a duration of at least 1s, such as 90s or 10m")
    return found


class _CheckOptions(NamedTuple):
    """Request of ``slamhive algorithm check``: the algorithm and the options that executors are chosen by."""

    bench: CheckBench
    name: str
    dataset: str | None
    on: CheckPlace
    image: str | None
    context: str | None
    namespace: str | None


def _executors(wish: _CheckOptions, stack: ExitStack) -> list[CheckExecutor]:
    """Return the executors that can start the algorithm here, of those asked for; the others are told of.

    Raises:
        InputError: nothing can.
    """
    from slamhive.conformance.workstation import OnWorkstation

    found: list[CheckExecutor] = []
    reasons: list[str] = []
    if wish.on in {CheckPlace.PROCESS, CheckPlace.ALL} and wish.image is None:
        process = OnWorkstation(wish.bench, wish.name, wish.dataset)
        reason = process.unavailable()
        if reason is None:
            found.append(process)
        else:
            reasons.append(f"process: {reason}")
    if wish.on in {CheckPlace.CONTAINER, CheckPlace.ALL}:
        contained = _contained(wish)
        if isinstance(contained, str):
            reasons.append(f"container: {contained}")
        else:
            found.append(contained)
    if wish.on in {CheckPlace.CLUSTER, CheckPlace.ALL}:
        there = _on_cluster(wish)
        if isinstance(there, str):
            reasons += [f"cluster: {there}"] if there else []
        else:
            found.append(stack.enter_context(there))
            if wish.on is CheckPlace.ALL:
                remark("also on the cluster of the kubeconfig; --on process leaves it out")
    if not found:
        raise InputError(f"{wish.name} can't be started here: {'; '.join(reasons) or 'see --on'}")
    for reason in reasons:
        remark(reason)
    return found


def _contained(wish: _CheckOptions) -> OnWorkstation | str:
    """Return this machine's containers as an executor, or why they can't be."""
    from slamhive.conformance.workstation import OnWorkstation
    from slamhive.local.programs.unavailable import ImageMissing

    asked = wish.on is CheckPlace.CONTAINER or wish.image is not None
    has_another = wish.bench.workshop.algorithm(wish.name).algorithm.spec.local is not None
    try:
        return OnWorkstation.contained(wish.bench, wish.name, wish.dataset, pull=asked or not has_another)
    except ImageMissing as error:
        return str(error) if asked or not has_another else f"{error}; --on container pulls it"
    except SlamHiveError as error:
        return str(error)


def _on_cluster(wish: _CheckOptions) -> OnCluster | str:
    """Return the cluster as an executor, or why there is none; empty where none was to be expected."""
    from slamhive.cli.cluster.commands import cluster_client

    try:
        with cluster_client():
            from slamhive.cli.cluster.work import ClusterPlace as Namespaced
            from slamhive.conformance.cluster import OnCluster
            from slamhive.kube.user.connecting import find_target
        find_target(wish.context, wish.namespace)
    except SlamHiveError as error:
        asked = wish.on is CheckPlace.CLUSTER or wish.context is not None or wish.namespace is not None
        return str(error) if asked else ""
    place = Namespaced(wish.context, wish.namespace)
    executor = OnCluster(wish.bench, wish.name, wish.dataset, place.connect)
    return executor.unavailable() or executor


def show(findings: Sequence[Finding], form: PrintFormat) -> None:
    """Print findings as a table, and under it what helps."""
    rows = [finding.as_json() for finding in findings]
    headings = ("executor", "mode", "check", "did", "found", "answer", "help")
    if form is PrintFormat.JSON:
        tables.write_json(sys.stdout, rows)
        return
    lines = [[row[key] for key in headings] for row in rows]
    if form is PrintFormat.MARKDOWN:
        tables.write_markdown(sys.stdout, headings, lines)
        return
    if form is PrintFormat.CSV:
        write_csv(sys.stdout, headings, lines)
        return
    width = out.width if out.is_terminal else _WIDTH
    console = Console(file=out.file, force_terminal=out.is_terminal, width=width, highlight=False)
    for (executor, mode), group in groupby(findings, key=lambda one: (one.executor, one.mode)):
        console.print(_table(f"{executor}, {mode}" if executor else "", list(group)))
    for finding in findings:
        if finding.help and finding.answer in {"fail", "warning"}:
            where = ", ".join(filter(None, (finding.executor, finding.mode, finding.check)))
            colour = _COLOURS[finding.answer]
            out.print(f"[{colour}]{finding.answer}[/] {where}: {escape(finding.help)}", soft_wrap=True)
    counts = [(word, sum(one.answer == word for one in findings)) for word in _COLOURS]
    out.print(", ".join(f"{count} {word}" for word, count in counts if count))


def _table(title: str, findings: Sequence[Finding]) -> Table:
    """Return the table of one mode in one executor; what was done is said once."""
    table = Table(title=title, title_justify="left", box=SIMPLE, header_style="bold")
    for heading in ("answer", "check", "what was done", "what was found"):
        table.add_column(heading, overflow="fold", ratio=2 if heading == "what was found" else None)
    before = None
    for finding in findings:
        did = "" if finding.did == before else escape(finding.did)
        before = finding.did
        answer = f"[{_COLOURS[finding.answer]}]{finding.answer}[/]"
        table.add_row(answer, finding.check, did, escape(finding.found))
    return table
