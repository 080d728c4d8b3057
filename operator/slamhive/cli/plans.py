# SPDX-License-Identifier: Apache-2.0
"""``slamhive plan`` and ``validate``: what sweeps expand to, and what is wrong with manifests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from slamhive.archive import Archive
from slamhive.cli.parts import searches, tables
from slamhive.cli.parts.checked import check_files
from slamhive.cli.parts.choosing import Also
from slamhive.cli.parts.console import bytes_text, out, remark, warn
from slamhive.cli.parts.sizes import apply_refused, size_refused
from slamhive.local.home.catalog import load_workshop
from slamhive.local.home.extent import DiskTally
from slamhive.local.home.folder import Home
from slamhive.local.running.impossible import impossible_runs
from slamhive.local.running.outlook import Looking, sentences
from slamhive.local.running.runner import Job
from slamhive.local.running.workbench import Workbench
from slamhive.model.base import plural
from slamhive.model.errors import InputError, SlamHiveError, sentence
from slamhive.model.run import MappingRun
from slamhive.model.sweep import Sweep
from slamhive.plan import SearchPlan, local_uid, probed
from slamhive.plan.paths import bounded
from slamhive.sampling import require_sampler
from slamhive.tables.text import short_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from slamhive.cli.parts.checked import Checked
    from slamhive.local.home.catalog import Workshop
    from slamhive.plan import Plan

_MISFITS = 5
"""Settings that don't fit, told one by one; validate tells of all."""

Files = Annotated[list[Path], typer.Argument(metavar="FILE…", help="Manifests: sweeps, runs, datasets …")]


def plan(
    files: Files,
    *,
    count: Annotated[bool, typer.Option("--count", help="Print the number of runs alone.")] = False,
    head: Annotated[int | None, typer.Option("--head", min=1, help="Print the first N runs.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print every run as a line of JSON, or the estimate as JSON.")
    ] = False,
    estimate: Annotated[
        bool, typer.Option("--estimate", help="Print what they will cost: CPU and wall time, memory, disk.")
    ] = False,
    parallelism: Annotated[
        int | None,
        typer.Option(
            "-j", "--parallelism", min=1, help="With --estimate: runs at the same time, here or elsewhere."
        ),
    ] = None,
    also: Also = None,
) -> None:
    """Show the runs that sweeps expand to, without running them, or what they will cost.

    Of a search it says how much that may try, and shows the runs of what was tried so far.
    Names that are not in the catalog are allowed here; validate tells of them. Settings that an algorithm
    or recording of the catalog doesn't take are told, and planned all the same. An estimate comes from
    finished runs of the same algorithms, of this home and of those that --also names.

    Example: slamhive plan sweep.yaml --estimate
    """
    if estimate and (count or head is not None):
        raise InputError("--estimate: without --count and --head, which say something else")
    if not estimate and (parallelism is not None or also is not None):
        raise InputError("--parallelism and --also: of a plan they say something with --estimate alone")
    workshop = load_workshop(Home.from_environment())
    checked = check_files(files, workshop, strict=False, misfits=not (count or as_json))
    checked.refuse()
    plans = checked.plans
    if not plans:
        raise InputError(f"{files[0]}: no Sweep or MappingRun in it")
    if count:
        out.print(sum(points.most_runs for _, points in plans))
        return
    if not as_json:
        _tell_doubts(checked, workshop)
    home = Home.from_environment()
    searches.recall(plans, home)
    if estimate:
        from slamhive.cli import forecasting  # numbers, which nothing else of a plan needs

        forecasting.estimate(plans, workshop, home, parallelism=parallelism, also=also, as_json=as_json)
        return
    for sweep, points in plans:
        shown = len(points) if as_json else min(len(points), head or 10)
        if as_json:
            _print_json(points, min(shown, head or shown))
        else:
            _print_points(sweep, points, shown)
    if not as_json:
        _print_outlooks(plans, workshop)


def validate(files: Files) -> None:
    """Check manifests: everything that run would refuse, and what is missing here.

    Example: slamhive validate sweep.yaml
    """
    workshop = load_workshop(Home.from_environment())
    checked = check_files(files, workshop)
    for sweep, points in checked.plans:
        out.print(f"{sweep.kind} {escape(sweep.name)}: {searches.extent_text(points)}")
        if isinstance(points, SearchPlan):
            try:
                require_sampler(sweep.spec.search.method)
            except InputError as error:
                warn(f"{sweep.name} can't run here: {error}")
        warn_impossible([(sweep, points)], workshop)
        remark_without_effect(sweep, points)
    for item in checked.objects:
        if not isinstance(item, Sweep | MappingRun):
            out.print(f"{item.kind} {escape(item.name)}: valid")
        if told := size_refused(item) or apply_refused(item):
            remark(f"on a cluster: {told}")
    checked.refuse()


def remark_without_effect(sweep: Sweep, points: Plan) -> None:
    """Say which settings have no effect on some of the recordings."""
    for told in probed(points).remarks():
        remark(f"{sweep.name}: {told}")


def _tell_doubts(checked: Checked, workshop: Workshop) -> None:
    """Say what a run of the plans would meet: settings that don't fit, faulty and repaired recordings."""
    for told in bounded(checked.misfits, _MISFITS):
        warn(f"run refuses it: {told}")
    warn_impossible(checked.plans, workshop)
    _remark_repaired(checked.plans, workshop)


def warn_impossible(plans: Sequence[tuple[Sweep, Plan]], workshop: Workshop) -> None:
    """Say which runs won't be started, by what is known of their recordings."""
    for sweep, told in impossible_runs(plans, workshop, Home.from_environment()):
        warn(f"{sweep.name}: {told}")


def _print_outlooks(plans: Sequence[tuple[Sweep, Plan]], workshop: Workshop) -> None:
    """Print what an edit made stale and why, and what is new, where there are results."""
    home = Home.from_environment()
    if home.missing_archive:
        return
    try:
        with Archive.open(home.archive_url, read_only=True) as archive:
            looking = Looking(Workbench(home, workshop, archive), making=False)
            for sweep, points in plans:
                job = Job(sweep, local_uid(sweep), points)
                found = looking.look(sweep.name, job.uid, points, job.run_uid)
                told = sentences(found, points, tells_new=job.search is None)
                told = told or ["nothing of it was tried yet"]
                out.print(f"{sweep.name}: {'; '.join(told)}", markup=False)
    except SlamHiveError as error:
        remark(f"what is stale can't be told: {sentence(error)}")


def _remark_repaired(plans: Sequence[tuple[Sweep, Plan]], workshop: Workshop) -> None:
    """Say which datasets are under repair: of these no prepared recording is the file itself."""
    for name in sorted({name for _, points in plans for name in points.dataset_names()}):
        known = workshop.datasets.get(name)
        if known is None or known.spec.repair is None or not known.spec.repair.sensors:
            continue
        files = [workshop.dataset(name).folder / file.path for file in known.spec.recording.files]
        size = DiskTally().of(*(file.resolve() for file in files)).size
        room = f", up to {bytes_text(size)}" if size else ""
        remark(f"{name} is repaired: each prepared recording of it is written anew{room}")


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
    out.print(f"{sweep.name}: {searches.extent_text(points)}", markup=False)
    headings = ["index", "name", *(short_name(label, labels) for label in labels), "repetition", "seed"]
    lines = [
        [
            *(str(point.index), point.name),
            *(str(point.coordinates.get(label, "")) for label in labels),
            *(str(point.repetition), str(point.seed)),
        ]
        for point in first
    ]
    if lines or not isinstance(points, SearchPlan):
        tables.show(out, headings, lines)
    remark_without_effect(sweep, points)
    if count < len(points):
        out.print(f"… and {plural(len(points) - count, 'more run')} (--head N, --json)")
