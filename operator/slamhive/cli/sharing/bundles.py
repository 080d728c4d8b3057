# SPDX-License-Identifier: Apache-2.0
"""``slamhive bundle`` and ``slamhive verify``: a study in a file, and what comes out of it elsewhere.

``verify`` ends with 0 where everything that can be computed agrees, with 1 where a figure doesn't or could
not be computed, with 2 where the bundle can't be used.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from slamhive.bridges.bundles.contents import MEASURED
from slamhive.bridges.bundles.making import BundleOrder, bundle
from slamhive.bridges.bundles.opening import opened_bundle
from slamhive.bridges.bundles.repeating import (
    RepeatedFigure,
    changed_program,
    compare_repeated,
    draw,
    manifest_of,
)
from slamhive.bridges.bundles.verifying import Mismatch, Verification, verify
from slamhive.cli.parts.console import bytes_text, complain, open_workbench, out, remark, warn
from slamhive.cli.parts.exits import FAILED, INTERRUPTED
from slamhive.cli.parts.planning import planned, sweeps_of
from slamhive.cli.parts.tables import show, write_json
from slamhive.cli.parts.waiting import Work
from slamhive.local.home.catalog import DatasetPlace
from slamhive.local.home.folder import Home
from slamhive.model.base import plural
from slamhive.model.dataset import Dataset
from slamhive.model.errors import InputError, SlamHiveError
from slamhive.model.evaluation import Evaluation, EvaluationSettings
from slamhive.model.loading import load_file

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slamhive.bridges.bundles.contents import BundledRun
    from slamhive.bridges.bundles.opening import OpenedBundle
    from slamhive.local.running.workbench import Workbench

K = TypeVar("K", Evaluation, Dataset)

_SHOWN = 40


def make_bundle(
    sweep: Annotated[str, typer.Argument(metavar="SWEEP", help="Name of a sweep that ran here.")],
    *,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="File to write, .zip.")],
    anonymous: Annotated[
        bool,
        typer.Option("--anonymous", help="Take out names, machines, paths, authors and dates, for review."),
    ] = False,
    title: Annotated[str | None, typer.Option(metavar="TEXT", help="Title for people.")] = None,
    author: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="An author; may be repeated.")
    ] = None,
    license_: Annotated[
        str | None, typer.Option("--license", metavar="TEXT", help="Licence of the study, as in CC-BY-4.0.")
    ] = None,
    evaluation: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Manifest of an Evaluation of these runs; may be repeated."),
    ] = None,
    dataset: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="File with a dataset of these runs that isn't known here by its name, such as the sweep's; "
            "may be repeated.",
        ),
    ] = None,
) -> None:
    """Write a study as one file: manifests, results, trajectories, environments; not the recordings.

    The same study gives the same bytes. Others verify it, repeat it and import it.

    Example: slamhive bundle ranges -o study.zip
    """
    if output.exists():
        raise InputError(f"{output}: exists already", "output")
    if anonymous and author:
        raise InputError("--anonymous takes out authors: leave out --author")
    order = BundleOrder(
        sweep,
        title,
        tuple(author or ()),
        license_,
        anonymous,
        tuple(_settings(evaluation or [])),
        tuple(_datasets(dataset or [])),
    )
    home = Home.from_environment()
    with Work(f"bundling {sweep}") as work:
        bench = open_workbench(home)
        work.follow(bench.making)
        with bench.archive:
            report = bundle(bench, order, output, work.count)
    for note in report.notes:
        warn(note)
    if not order.license:
        remark("no licence is stated, so nobody may pass it on: --license CC-BY-4.0, for one")
    out.print(
        f"{output}: {plural(report.runs, 'run')}, {report.trajectories} with trajectories, "
        f"{bytes_text(report.size)}",
        markup=False,
    )


def _settings(files: list[Path]) -> list[EvaluationSettings]:
    return [
        EvaluationSettings.model_validate(item.spec.model_dump(include=set(EvaluationSettings.model_fields)))
        for _, item in _objects(files, Evaluation)
    ]


def _datasets(files: list[Path]) -> list[DatasetPlace]:
    return [DatasetPlace(item, path.parent.absolute()) for path, item in _objects(files, Dataset)]


def _objects(files: list[Path], kind: type[K]) -> Iterator[tuple[Path, K]]:
    """Go through the objects of a kind in files that an option of its name gave, each with its file."""
    for path in files:
        found = [item for item in load_file(path) if isinstance(item, kind)]
        if not found:
            raise InputError(f"{path}: no {kind.__name__} in it", kind.__name__.lower())
        yield from ((path, item) for item in found)


def verify_bundle(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A file that slamhive bundle wrote.")],
    *,
    repeat: Annotated[
        int, typer.Option("--repeat", min=0, metavar="N", help="Do a sample of N runs again here.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Seed of the sample.")] = 1,
    ground_truth: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder with ground truth, a file a dataset; default: that of the datasets here.",
            exists=True,
            file_okay=False,
        ),
    ] = None,
    parallelism: Annotated[
        int | None, typer.Option("-j", "--parallelism", min=1, help="Processes that compute.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Compute every figure of a bundle again from its trajectories: what agrees to the last digit?

    Example: slamhive verify study.zip --repeat 2
    """
    home = Home.from_environment()
    with opened_bundle(file, later=MEASURED) as opened:
        bench = open_workbench(home)
        with bench.archive:
            with Work(f"verifying {file.name}") as work:
                work.follow(bench.making)
                found = verify(bench, opened, ground_truth, work.count, processes=parallelism)
            repeated, interrupted, left_out = _repeat(home, bench, opened, repeat, seed)
    if as_json:
        write_json(sys.stdout, _lines(opened, found, repeated, left_out))
    else:
        _tell(opened, found)
        _tell_repeated(repeated, left_out)
    if interrupted:
        raise typer.Exit(INTERRUPTED)
    if found.mismatches or found.absent or left_out:
        raise typer.Exit(FAILED)


def _repeat(
    home: Home, bench: Workbench, opened: OpenedBundle, number: int, seed: int
) -> tuple[list[RepeatedFigure], bool, list[str]]:
    """Do runs again; returns how their figures differ, whether it was interrupted, and what could not run."""
    if not number:
        return [], False, []
    from slamhive.cli.running import drive
    from slamhive.local.running.choosing import RunChoice
    from slamhive.local.running.runner import Job
    from slamhive.monitor.measuring.processes import forbid_inspection
    from slamhive.plan import local_uid

    forbid_inspection()
    jobs: list[tuple[BundledRun, Job]] = []
    left_out = []
    for run in draw(opened, number, seed):
        try:
            if changed := changed_program(bench, run):
                warn(f"{run.record.name}: {changed}")
            (sweep,) = sweeps_of([manifest_of(run, opened)])
            settings = EvaluationSettings.model_validate(opened.study.evaluation or {})
            sweep = sweep.replace(spec=sweep.spec.replace(evaluation=settings))
            jobs.append((run, Job(sweep, local_uid(sweep), planned(sweep, bench.workshop, strict=True))))
        except (SlamHiveError, ValueError) as error:
            left_out.append(f"{run.record.name} can't be done again: {error}")
    interrupted = False
    if jobs:
        with home.sharing("slamhive verify"):
            interrupted = drive([job for _, job in jobs], bench, RunChoice(rerun=True)) == INTERRUPTED
    found: list[RepeatedFigure] = []
    for run, job in jobs:
        again = bench.archive.get(job.run_uid(0))
        if again is None or not again.results:
            why = again.message or again.reason if again else "it was not done"
            left_out.append(f"{run.record.name} has no figures here: {why}")
            continue
        found += compare_repeated(opened, run, again)
    return found, interrupted, left_out


def _tell(opened: OpenedBundle, found: Verification) -> None:
    study = opened.study
    out.print(
        f"{study.title}: {plural(len(opened.runs), 'run')}, bundle {opened.sha256[:16]}, made by slamhive "
        f"{study.slamhive}; all files are what their checksums say",
        markup=False,
        soft_wrap=True,
    )
    for name, why in found.absent.items():
        complain(f"dataset {name}: {why}")
    for note in found.notes:
        warn(note)
    if found.mismatches:
        rows = found.mismatches
        show(
            out,
            ["run", "evaluation", "figure", "in the bundle", "computed here", "differs by"],
            [_row(one) for one in rows[:_SHOWN]],
        )
        if len(rows) > _SHOWN:
            remark(f"and {len(rows) - _SHOWN:,} more: --json has all")
    out.print(
        f"{plural(found.figures, 'figure')} of {plural(found.results, 'result')} of "
        f"{plural(found.runs, 'run')} agree to the last digit, {len(found.mismatches):,} do not",
        markup=False,
    )


def _row(one: Mismatch) -> list[str]:
    difference = one.difference
    told = "" if difference is None else f"{difference:.2g}"
    return [one.run, one.evaluation, one.figure, _short(one.bundled), _short(one.recomputed), told]


def _short(value: Any) -> str:
    return "–" if value is None else str(value)[:60]


def _tell_repeated(repeated: list[RepeatedFigure], left_out: list[str]) -> None:
    for sentence in left_out:
        complain(sentence)
    if not repeated:
        return
    out.print()
    show(
        out,
        ["done again", "figure", "in the bundle", "repetitions", "here", "difference"],
        [
            [one.run, one.figure, f"{one.before:.6g}", str(one.count), f"{one.after:.6g}", one.sentence]
            for one in repeated
        ],
    )


def _lines(
    opened: OpenedBundle, found: Verification, repeated: list[RepeatedFigure], left_out: list[str]
) -> list[dict[str, Any]]:
    """Return all that was found: one object a mismatch and repeated figure, the sums last."""
    lines: list[dict[str, Any]] = [
        {"kind": "mismatch", **one._asdict(), "difference": one.difference} for one in found.mismatches
    ]
    for one in repeated:
        deviations = None if math.isnan(one.deviations) else one.deviations
        deviation = None if math.isnan(one.deviation) else one.deviation
        fields = {"run": one.run, "figure": one.figure, "before": one.before, "repetitions": one.count}
        lines.append(
            {
                "kind": "repeated",
                **fields,
                "after": one.after,
                "standardDeviation": deviation,
                "standardDeviations": deviations,
            }
        )
    lines += [{"kind": "notRepeated", "message": sentence} for sentence in left_out]
    lines += [{"kind": "absent", "dataset": name, "message": why} for name, why in found.absent.items()]
    lines += [{"kind": "note", "message": note} for note in found.notes]
    sums = {"runs": found.runs, "results": found.results, "agree": found.figures}
    lines.append({"kind": "sum", "bundle": opened.sha256, **sums, "differ": len(found.mismatches)})
    return lines
