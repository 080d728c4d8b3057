# SPDX-License-Identifier: Apache-2.0
"""``slamhive results suspects``: where systems agree with each other and not with the ground truth."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from slamhive.analysis.selection import Selection
from slamhive.cli.parts.choosing import EvaluationName, Where, choose_runs
from slamhive.cli.parts.console import out, remark
from slamhive.cli.parts.tables import write_json
from slamhive.cli.parts.waiting import Work
from slamhive.local.home.folder import Home
from slamhive.model.base import plural

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from slamhive.archive.records import CatalogEntry
    from slamhive.bridges.places import Here
    from slamhive.runfiles.suspecting import DatasetSuspects


def show_suspects(
    *,
    where: Where = None,
    evaluation: EvaluationName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say where runs of three systems or more agree with each other and not with the ground truth.

    Example: slamhive results suspects --where "dataset == 'hall'"
    """
    from slamhive.bridges.places import Here
    from slamhive.runfiles.suspecting import TRACKED_COLUMNS, tracked_systems

    frame, notes = choose_runs(Selection((), evaluation, where), "there is nothing to compare")
    home = Home.from_environment()
    with Work("comparing paths") as work, Here.open(home.archive_url, home.path) as here:
        datasets = tracked_systems(frame.records(list(TRACKED_COLUMNS)))
        algorithms = here.algorithms()
        found = []
        for number, (dataset, systems) in enumerate(sorted(datasets.items())):
            found.append(_suspects(here, dataset, systems, algorithms))
            work.count(number + 1, len(datasets))
    if as_json:
        write_json(sys.stdout, (one.as_json() for one in found))
        return
    for one in found:
        _print(one)
    for note in notes:
        remark(note)


def _suspects(
    here: Here, dataset: str, systems: Mapping[str, Mapping[str, bool]], algorithms: list[CatalogEntry]
) -> DatasetSuspects:
    from slamhive.runfiles.suspecting import LocatedRun, suspects_of

    def located(runs: Mapping[str, bool]) -> Iterator[LocatedRun]:
        for uid, is_scaled in runs.items():
            record = here.record(uid)
            if record is not None:
                yield LocatedRun(record, here.place(record), is_scaled)

    first = next((run.record for runs in systems.values() for run in located(runs)), None)
    truth = here.truth(first) if first is not None else None
    return suspects_of(dataset, truth, {name: located(runs) for name, runs in systems.items()}, algorithms)


def _print(one: DatasetSuspects) -> None:
    if one.found is None:
        out.print(f"[bold]{escape(one.dataset)}[/]: not compared: {escape(one.why or '')}")
        return
    found = one.found
    out.print(
        f"[bold]{escape(one.dataset)}[/]: {plural(len(found.stretches), 'suspect')} in "
        f"{found.seconds:.1f} s, by {plural(one.runs, 'run')} of {len(found.systems)} systems"
    )
    if found.stretches:
        table = Table()
        for heading in ("from", "to", "off by", "systems' spread", "standard errors"):
            table.add_column(heading, justify="right")
        for part in found.stretches:
            table.add_row(
                f"{part.begin:.2f} s",
                f"{part.end:.2f} s",
                f"{part.metres:.3f} m",
                f"{part.spread:.3f} m",
                f"{part.ratio:.1f}",
            )
        out.print(table)
        table = Table()
        for heading in ("system", "RMSE", "without them"):
            table.add_column(heading, justify="left" if heading == "system" else "right")
        for name in found.systems:
            table.add_row(escape(name), f"{found.rmse[name]:.4f} m", f"{found.rmse_without[name]:.4f} m")
        out.print(table)
        remark(
            "the truth is the likelier to be wrong there, or a sensor that all of them use; leave a stretch "
            "out by groundTruth.holes. RMSE: of a system's mean path, aligned to what fits"
        )
    for sentence in one.left_out:
        remark(f"left out: {sentence}")
